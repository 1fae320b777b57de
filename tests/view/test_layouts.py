# SPDX-License-Identifier: Apache-2.0
"""The layouts for RViz and Foxglove show what a station publishes, under its names."""

import json
import re
from functools import reduce
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.parameter import Parameter

from microhand_station.recording.recorded_topics import recorded_topics
from microhand_twin.ros.twin_node import TwinNode

SHARE = Path(__file__).parents[2] / 'ros_ws' / 'src' / 'microhand_station'
ARRAY_OR_TYPE = re.compile(r'^sequence<(.*)>$')


@pytest.fixture(scope='module')
def topics(ros_domain):
    """Return the class of each topic that a station publishes or records."""
    context = rclpy.Context()
    rclpy.init(context=context)
    rate = Parameter('display_rate', value=1.0)
    twin = TwinNode(context=context, parameter_overrides=[rate])
    kinds = {publisher.topic_name: publisher.msg_type for publisher in twin.publishers}
    twin.destroy_node()
    rclpy.shutdown(context=context)
    recorded = {f'/{t.name.lstrip("/")}': t.message_type for t in recorded_topics((1, 2, 3))}
    return {**kinds, **recorded}


def test_rviz_shows_the_markers_of_the_twin(topics):
    """Each topic is one of the twin's, and each fixed mesh is asked for as it is latched."""
    config = yaml.safe_load((SHARE / 'rviz' / 'station.rviz').read_text(encoding='utf-8'))
    shown = {
        display['Topic']['Value']: display['Topic']
        for display in config['Visualization Manager']['Displays']
        if 'Topic' in display
    }
    assert set(shown) == {'/twin/markers', '/twin/object_marker'}
    assert {topics[name].__name__ for name in shown} == {'MarkerArray'}
    assert shown['/twin/object_marker']['Durability Policy'] == 'Transient Local'


def test_foxglove_shows_fields_that_there_are(topics):
    """Every topic and every path of a plot leads to a field; every panel has its place."""
    layout = json.loads((SHARE / 'foxglove' / 'station.json').read_text(encoding='utf-8'))
    panels = layout['configById']
    assert sorted(leaves(layout['layout'])) == sorted(panels)
    for panel in panels.values():
        for path in panel.get('paths', []):
            assert field_type(topics, path['value']) in ('double', 'uint8')
        assert set(panel.get('topics', {})) <= set(topics)
        for key in ('topicPath', 'topicToRender'):
            assert panel.get(key, '/events') in topics


def leaves(layout):
    """Return the panels of a layout."""
    if isinstance(layout, str):
        return [layout]
    return [*leaves(layout['first']), *leaves(layout['second'])]


def field_type(topics, path):
    """Return the type of a field by its Foxglove path, ``/topic.field.field[0].field``."""
    topic, *fields = path.split('.')

    def step(kind, field):
        name = field.partition('[')[0]
        found = kind.get_fields_and_field_types()[name]
        inside = ARRAY_OR_TYPE.match(found)
        assert bool(inside) == ('[' in field)
        found = inside[1] if inside else found
        if '/' not in found:
            return found
        package, message = found.split('/')
        module = __import__(f'{package}.msg', fromlist=[message])
        return getattr(module, message)

    return reduce(step, fields, topics[topic])
