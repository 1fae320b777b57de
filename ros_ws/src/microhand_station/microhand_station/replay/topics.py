# SPDX-License-Identifier: Apache-2.0
"""Topics of a record → publishers of the same messages, where their types are installed."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node

from microhand_planner.core.errors import BadRequest
from microhand_station.analysis.message_decoder import RecordedTopic
from microhand_station.recording.ros2msg_schema import ros2msg_schema
from microhand_station.replay.offered_qos import offered_qos
from microhand_station.replay.stamps import StampShift

_TYPE_NAME = re.compile(r'[a-z]\w*/msg/[A-Z]\w*', re.ASCII)


@dataclass(frozen=True)
class Replayed:
    """A topic that is published again.

    Attributes
    ----------
    name : str
        On which it is published.
    publisher : rclpy.publisher.Publisher
        With the QoS that was offered.
    shift : StampShift
        For its messages.
    """

    name: str
    publisher: Any
    shift: StampShift


def replayed_topics(
    node: Node, topics: Iterable[RecordedTopic], namespace: str
) -> tuple[dict[str, Replayed], dict[str, str]]:
    """Create the publishers.

    Parameters
    ----------
    node : Node
        That publishes.
    topics : iterable of RecordedTopic
        Of the record.
    namespace : str
        Put before all names; empty: none.

    Returns
    -------
    replayed : dict
        By the names of the record.
    left_out : dict
        Why a topic is not published, by name.
    """
    replayed, left_out = {}, {}
    for topic in topics:
        try:
            message_type = _message_type(topic)
        except LookupError as error:
            left_out[topic.name] = str(error.args[0])
            continue
        name = f'/{namespace.strip("/")}{topic.name}' if namespace else topic.name
        try:
            publisher = node.create_publisher(message_type, name, offered_qos(topic.offered_qos))
        except InvalidTopicNameException:
            left_out[topic.name] = 'no topic of ROS can have this name'
            continue
        replayed[topic.name] = Replayed(name, publisher, StampShift(message_type))
    return replayed, left_out


def check_no_driver_listens(node: Node, replayed: Iterable[Replayed]) -> None:
    """Check that no stage would move.

    Raises
    ------
    BadRequest
        A node listens to setpoints of a finger and publishes the state of that finger's stage.
    """
    for topic in replayed:
        if not topic.name.endswith('/setpoints'):
            continue
        states = topic.name.removesuffix('setpoints') + 'state'
        ours = (node.get_name(), node.get_namespace())
        listeners, movers = (
            {(one.node_name, one.node_namespace) for one in found} - {ours}
            for found in (
                node.get_subscriptions_info_by_topic(topic.name),
                node.get_publishers_info_by_topic(states),
            )
        )
        if listeners & movers:
            raise BadRequest(
                'record',
                f'to be replayed on {topic.name}, and a stage driver listens there: it would move',
                'another --namespace, or --topic without setpoints',
            )


def _message_type(topic: RecordedTopic) -> Any:
    """Return the class of a topic's messages.

    Raises
    ------
    LookupError
        It is not installed, or another version of it is.
    """
    package, _, name = topic.type_name.partition('/msg/')
    try:
        if not _TYPE_NAME.fullmatch(topic.type_name):
            raise LookupError('a damaged name')
        message_type = getattr(importlib.import_module(f'{package}.msg'), name)
        installed = ros2msg_schema(topic.type_name)
    except (ImportError, AttributeError, LookupError, ValueError) as error:
        shown = topic.type_name or 'its type, whose definition is missing,'
        raise LookupError(f'{shown} is not installed') from error
    if _fields(installed) != _fields(topic.schema):
        raise LookupError(f'{topic.type_name} was recorded with another definition')
    return message_type


def _fields(schema: str) -> list[str]:
    """Return a definition without comments, spaces and empty lines."""
    lines = (' '.join(line.partition('#')[0].split()) for line in schema.splitlines())
    return [line for line in lines if line]
