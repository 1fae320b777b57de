# SPDX-License-Identifier: Apache-2.0
"""Topics of the station → what is known of it now."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from microhand_msgs_py.msg import (
    ContactForce,
    ObjectDeviation,
    ObjectState,
    RunEvent,
    SequencerState,
    StageState,
)
from microhand_msgs_py.msg import Plan as PlanMsg
from rclpy.node import Node

from microhand_node.qos import DISPLAY, EVENTS, LATCHED
from microhand_planner.core.errors import MicrohandError
from microhand_planner.core.plan import FINGERS, Plan
from microhand_planner.ros.conversions import (
    UM_PER_M,
    UN_PER_N,
    plan_from_msg,
    pose_from_msg,
    um_from_point,
)
from microhand_station.config import StationConfig
from microhand_station.sequencer.progress import Progress
from microhand_station.sequencer.stage_watch import Mode
from microhand_station.sequencer.states import State
from microhand_station.view.snapshot import Contact, Note, Snapshot, Stage, Thing

SILENCE_S = 1.0
"""What was said longer ago than this no longer holds [s]."""
LOOK_S = 1.0
"""How often the sequencer is looked for [s]."""
KEPT_NOTES = 50
NS_PER_S = 1_000_000_000


class Listener:
    """Keeps the latest of what the station says; may be asked by any thread.

    Parameters
    ----------
    node : Node
        Spun by another thread.
    config : StationConfig
        Where the stages stand, and how stiff the fingers are.
    now_s : callable
        A steady clock [s].
    """

    def __init__(
        self, node: Node, config: StationConfig, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._node = node
        self._config = config
        self._now_s = now_s
        self._latest: dict[str, tuple[float, Any]] = {}
        self._notes: deque[Note] = deque(maxlen=KEPT_NOTES)
        self._plan: tuple[PlanMsg | None, Plan | None] = (None, None)
        self._looked_s = -math.inf
        self._sequencer_there = False
        for kind, topic, qos in (
            (SequencerState, 'sequencer/state', LATCHED),
            (PlanMsg, 'plan', LATCHED),
            (ObjectState, 'object_state', DISPLAY),
            (ObjectDeviation, 'sequencer/object_deviation', DISPLAY),
            *((StageState, f'finger_{finger}/state', DISPLAY) for finger in _numbers()),
        ):
            node.create_subscription(kind, topic, partial(self._keep, topic), qos)
        node.create_subscription(RunEvent, 'events', self._note, EVENTS)

    def snapshot(self) -> Snapshot:
        """Return the station as it is now."""
        state, progress = self._sequencer()
        return Snapshot(
            state=state,
            progress=progress,
            stages=tuple(self._stage(finger) for finger in _numbers()),
            thing=self._thing(),
            off_plan=self._off_plan(),
            plan=self._read_plan(),
            notes=tuple(self._notes),
            stiffness_uN_per_um=self._config.stiffness_uN_per_um,
        )

    def _keep(self, topic: str, message: Any) -> None:
        self._latest[topic] = (self._now_s(), message)

    def _note(self, event: RunEvent) -> None:
        stamp = event.header.stamp
        time_s = stamp.sec + stamp.nanosec / NS_PER_S
        self._notes.append(Note(time_s, event.source, event.error_code, event.text))

    def _heard(self, topic: str, within_s: float = SILENCE_S) -> Any:
        """Return the latest message of a topic; None: there is none of late."""
        arrived_s, message = self._latest.get(topic, (-math.inf, None))
        return message if self._now_s() - arrived_s <= within_s else None

    def _sequencer(self) -> tuple[State | None, Progress]:
        """Return what the sequencer does; it speaks only when that changes."""
        if self._now_s() - self._looked_s >= LOOK_S:
            self._looked_s = self._now_s()
            self._sequencer_there = self._node.count_publishers('sequencer/state') > 0
        message = self._heard('sequencer/state', math.inf)
        if message is None or not self._sequencer_there:
            return None, Progress()
        return State(message.state), Progress(
            step=message.step,
            steps=message.steps,
            rotation=message.rotation,
            share=message.progress,
            time_left_s=message.time_left,
        )

    def _stage(self, finger: int) -> Stage | None:
        """Return the stage of a finger, from 1."""
        message = self._heard(f'finger_{finger}/state')
        if message is None:
            return None
        position_um = um_from_point(message.position)
        return Stage(
            mode=Mode(message.mode),
            on_target=message.on_target,
            error=message.error_msg,
            tip_um=self._config.fingers[finger - 1].limits.to_station(position_um),
            lag_um=float(np.linalg.norm(um_from_point(message.command) - position_um)),
        )

    def _thing(self) -> Thing | None:
        """Return the object."""
        message = self._heard('object_state')
        if message is None:
            return None
        return Thing(
            pose=pose_from_msg(message.pose),
            held=message.held,
            released=message.released,
            lost_because=message.lost_because,
            contacts=_contacts(message.contacts),
        )

    def _off_plan(self) -> tuple[float, float] | None:
        """Return how far the object is from its plan."""
        message = self._heard('sequencer/object_deviation')
        return None if message is None else (message.angle, message.distance * UM_PER_M)

    def _read_plan(self) -> Plan | None:
        """Return the latest plan; each is converted once. None: it is none that can be shown."""
        message = self._heard('plan', math.inf)
        if message is not self._plan[0]:
            try:
                plan = plan_from_msg(message)
            except MicrohandError:
                plan = None
            self._plan = (message, plan)
        return self._plan[1]


def _contacts(messages: Sequence[ContactForce]) -> tuple[Contact, ...]:
    """Return the contacts of fingers 1, 2, 3; empty: none are known."""
    if not messages:
        return ()
    nothing = ContactForce(position=Point(x=math.nan, y=math.nan, z=math.nan))
    said = {message.finger: message for message in messages}
    return tuple(_contact(said.get(finger, nothing)) for finger in _numbers())


def _contact(message: ContactForce) -> Contact:
    """Return a contact in µm and µN."""
    force = message.force
    return Contact(
        touching=message.in_contact,
        point_um=um_from_point(message.position),
        force_uN=np.array([force.x, force.y, force.z]) * UN_PER_N,
        normal_uN=message.normal_force * UN_PER_N,
        friction_use=message.friction_use,
    )


def _numbers() -> range:
    """Return the numbers of the fingers."""
    return range(1, FINGERS + 1)
