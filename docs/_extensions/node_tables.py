# SPDX-License-Identifier: Apache-2.0
"""Nodes as they are when they run: started for a moment, and asked what they declare."""

from __future__ import annotations

import math
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from markdown_table import code, markdown_table

FINGER = re.compile(r'finger_[123]')
GRAPH_S = 5.0
"""Longest wait until the graph knows a node's actions [s]."""
EVERY_NODE_HAS = (
    '/parameter_events',
    '/rosout',
    '/describe_parameters',
    '/get_parameter_types',
    '/get_parameters',
    '/list_parameters',
    '/set_parameters',
    '/set_parameters_atomically',
    '/get_type_description',
)
EVERY_PARAMETER = ('use_sim_time', 'start_type_description_service')
LIFECYCLE = (
    '/change_state',
    '/get_state',
    '/get_available_states',
    '/get_available_transitions',
    '/get_transition_graph',
    '/transition_event',
)


def nodes() -> str:
    """Return topics, services, actions and parameters of all nodes."""
    with _made_nodes() as made:
        return '\n'.join(_described(node) for node in made)


@contextmanager
def _made_nodes() -> Iterator[Iterator[Any]]:
    """Start ROS where it sees nobody and nobody sees it, and make one node after the other."""
    with tempfile.TemporaryDirectory() as logs:
        os.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE='OFF', ROS_LOG_DIR=logs)
        import rclpy

        context = rclpy.Context()
        rclpy.init(args=['docs', '--ros-args', '--log-level', 'FATAL'], context=context)
        try:
            yield _one_by_one(context)
        finally:
            rclpy.shutdown(context=context)


def _one_by_one(context: Any) -> Iterator[Any]:
    from rclpy.node import Node

    from microhand_planner.ros.planner_node import PlannerNode
    from microhand_station.config import StationConfig
    from microhand_station.recording.recorder_node import Recorder
    from microhand_station.sequencer.node import SequencerNode
    from microhand_station.view.listener import Listener
    from microhand_station.view.view_node import PARAMETERS
    from microhand_twin.ros.twin_node import TwinNode
    from stage_driver_sim.driver_node import StageDriverNode

    def view(**options: Any) -> Any:
        node = Node('view', **options)
        for name, default, description in PARAMETERS:
            node.declare_parameter(name, default, _descriptor(description))
        Listener(node, StationConfig())
        return node

    makers: tuple[tuple[Callable[..., Any], str], ...] = (
        (PlannerNode, ''),
        (SequencerNode, ''),
        (StageDriverNode, 'finger_1'),
        (TwinNode, ''),
        (Recorder, ''),
        (view, ''),
    )
    for make, namespace in makers:
        node = make(context=context, namespace=namespace)
        yield node
        node.destroy_node()


def _descriptor(description: str) -> Any:
    from rcl_interfaces.msg import ParameterDescriptor

    return ParameterDescriptor(description=description)


def _described(node: Any) -> str:
    """Return the section of one node."""
    parts = [f'## {node.get_name()}\n']
    if node.get_namespace() != '/':
        parts.append('One for each finger, with N = 1, 2, 3.\n')
    topics = [('publishes', p.topic_name, p.msg_type, p.qos_profile) for p in node.publishers]
    topics += [('listens to', s.topic_name, s.msg_type, s.qos_profile) for s in node.subscriptions]
    rows = [
        (does, code(_name(topic)), _type(kind), _quality(quality))
        for does, topic, kind, quality in topics
        if not topic.endswith(EVERY_NODE_HAS + LIFECYCLE)
    ]
    for does, found in (('serves', node.services), ('calls', node.clients)):
        rows += [
            (does, code(_name(one.service_name)), _type(one.srv_type), '')
            for one in found
            if not one.service_name.endswith(EVERY_NODE_HAS + LIFECYCLE)
        ]
    rows += [
        ('serves action', code(_name(name)), _link(kind), '') for name, kind in _actions(node)
    ]
    if any(service.service_name.endswith(LIFECYCLE) for service in node.services):
        parts.append('A managed node: it has the services and states of a ROS lifecycle.\n')
    parts.append(markdown_table(('', 'name', 'type', 'quality of service'), sorted(set(rows))))
    parts.append(_parameters(node))
    return '\n'.join(parts)


def _actions(node: Any) -> Iterator[tuple[str, str]]:
    """Give name and type of each action that a node serves; the graph knows them soon."""
    from rclpy.action import ActionServer, get_action_server_names_and_types_by_node

    due_s = time.monotonic() + GRAPH_S
    expected = sum(isinstance(one, ActionServer) for one in node.waitables)
    found: list[tuple[str, list[str]]] = []
    while len(found) < expected:
        found = get_action_server_names_and_types_by_node(
            node, node.get_name(), node.get_namespace()
        )
        if time.monotonic() > due_s:
            raise RuntimeError(f'{node.get_name()}: actions are {found}, not {expected}')
    for name, (kind,) in found:
        yield name, kind


def _parameters(node: Any) -> str:
    """Return the parameters of a node as a table."""
    shown: dict[str, str] = {}
    for name in sorted(node._parameters):
        if name not in EVERY_PARAMETER:
            shown.setdefault(FINGER.sub('finger_N', name), name)
    rows = []
    for label, name in shown.items():
        about = node.describe_parameter(name)
        value = node.get_parameter(name)
        unit, meaning = _unit(about.description)
        notes = [about.additional_constraints, 'only at start' if about.read_only else '']
        rows.append(
            (
                code(label),
                value.type_.name.lower().replace('_', ' '),
                code(_value(value.value)),
                unit,
                _range(about),
                '; '.join(filter(None, [meaning, *notes])),
            )
        )
    heads = ('parameter', 'type', 'default', 'unit', 'range', 'meaning')
    return markdown_table(heads, rows)


def _name(full: str) -> str:
    """Return a name as it is within the namespace of a station."""
    shared = ('/diagnostics', '/tf', '/clock')
    return full if full in shared else FINGER.sub('finger_N', full.lstrip('/'))


def _type(kind: Any) -> str:
    """Return package and name of a type; ours are on the page of the interfaces."""
    return _link(f'{kind.__module__.partition(".")[0]}/{kind.__name__}')


def _link(kind: str) -> str:
    package, *_, name = kind.split('/')
    return (
        f'[{name}](interfaces.md#{name.lower()})'
        if package == 'microhand_msgs_py'
        else f'{package}/{name}'
    )


def _quality(quality: Any) -> str:
    words = [quality.reliability.name.lower().replace('_', ' ')]
    if quality.durability.name == 'TRANSIENT_LOCAL':
        words.append('latched')
    return f'{", ".join(words)}, depth {quality.depth}'


def _unit(description: str) -> tuple[str, str]:
    """Split `[s] what it is` into unit and meaning."""
    if description.startswith('['):
        unit, _, meaning = description[1:].partition('] ')
        return unit, meaning
    return '', description


def _value(value: Any) -> str:
    if isinstance(value, str):
        return value or "''"
    if isinstance(value, float):
        return f'{value:g}'
    if hasattr(value, '__len__'):
        return '[' + ', '.join(_value(one) for one in value) + ']'
    return str(value)


def _range(about: Any) -> str:
    for limits in (*about.floating_point_range, *about.integer_range):
        if math.isfinite(limits.from_value):
            return f'{limits.from_value:g} to {limits.to_value:g}'
    return ''
