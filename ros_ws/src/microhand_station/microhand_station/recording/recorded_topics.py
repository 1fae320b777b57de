# SPDX-License-Identifier: Apache-2.0
"""The station's fingers → the topics that belong into the record of a run."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from microhand_msgs_py.msg import (
    ObjectDeviation,
    ObjectState,
    Plan,
    RunEvent,
    SequencerState,
    SetpointChunk,
    StageState,
    TipContact,
)
from rcl_interfaces.msg import Log, ParameterEvent
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_parameter_events,
)

from microhand_node.qos import CONTACT, DIAGNOSTICS, EVENTS, LATCHED, SETPOINTS, STATE

_ROSOUT = QoSProfile(
    depth=1000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    lifespan=Duration(seconds=10),
)
_TF = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
# What rmw means by "no limit", as rosbag2 writes it.
_FOREVER_NS = 9223372036854775807


@dataclass(frozen=True)
class RecordedTopic:
    """A topic that the recorder subscribes to.

    Attributes
    ----------
    name : str
        As in the code of the station: relative to its namespace, or absolute.
    message_type : type
        Class of its messages.
    qos : QoSProfile
        What its publishers offer and the recorder asks for.
    finger : int
        1, 2 or 3 if these are the setpoints of that finger, else 0.
    """

    name: str
    message_type: Any
    qos: QoSProfile
    finger: int = 0

    @property
    def is_busy(self) -> bool:
        """Whether it carries many messages a second, and keeps enough of them."""
        return self.qos in (CONTACT, SETPOINTS, STATE, _TF)

    @property
    def type_name(self) -> str:
        """``package/msg/Type``."""
        return f'{self.message_type.__module__.split(".")[0]}/msg/{self.message_type.__name__}'


PLAN_TOPIC = RecordedTopic('plan', Plan, LATCHED)


def recorded_topics(fingers: Sequence[int]) -> tuple[RecordedTopic, ...]:
    """All topics of a station with these fingers.

    ``/tf`` is left out where ``tf2_msgs`` is not installed: then nobody publishes it either.
    """
    topics = [
        RecordedTopic('sequencer/state', SequencerState, LATCHED),
        RecordedTopic('events', RunEvent, EVENTS),
        RecordedTopic('object_state', ObjectState, STATE),
        RecordedTopic('sequencer/object_deviation', ObjectDeviation, STATE),
        RecordedTopic('/rosout', Log, _ROSOUT),
        RecordedTopic('/diagnostics', DiagnosticArray, DIAGNOSTICS),
        RecordedTopic('/parameter_events', ParameterEvent, qos_profile_parameter_events),
    ]
    for finger in fingers:
        topics.append(
            RecordedTopic(f'finger_{finger}/setpoints', SetpointChunk, SETPOINTS, finger)
        )
        topics.append(RecordedTopic(f'finger_{finger}/state', StageState, STATE))
        topics.append(RecordedTopic(f'finger_{finger}/contact', TipContact, CONTACT))
    if importlib.util.find_spec('tf2_msgs') is not None:
        tf_message = importlib.import_module('tf2_msgs.msg').TFMessage
        topics.append(RecordedTopic('/tf', tf_message, _TF))
    return tuple(topics)


def offered_qos_yaml(profile: QoSProfile) -> str:
    """QoS of a publisher in the YAML that rosbag2 keeps in the channel metadata."""

    def period(name: str, duration: Duration) -> str:
        sec, nsec = divmod(duration.nanoseconds or _FOREVER_NS, 1_000_000_000)
        return f'  {name}:\n    sec: {sec}\n    nsec: {nsec}\n'

    return (
        f'- history: {profile.history.name.lower()}\n'
        f'  depth: {profile.depth}\n'
        f'  reliability: {profile.reliability.name.lower()}\n'
        f'  durability: {profile.durability.name.lower()}\n'
        + period('deadline', profile.deadline)
        + period('lifespan', profile.lifespan)
        + f'  liveliness: {profile.liveliness.name.lower()}\n'
        + period('liveliness_lease_duration', profile.liveliness_lease_duration)
        + '  avoid_ros_namespace_conventions: '
        + str(profile.avoid_ros_namespace_conventions).lower()
    )
