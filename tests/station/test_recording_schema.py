# SPDX-License-Identifier: Apache-2.0
"""Schema texts against the type hashes of ROS and against the types that rosbags knows."""

import json
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory
from microhand_msgs_py.msg import (
    ObjectState,
    Plan,
    RunEvent,
    SequencerState,
    SetpointChunk,
    StageState,
)
from rcl_interfaces.msg import Log
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from microhand_station.recording.ros2msg_schema import ros2msg_schema

TYPES = (Plan, SetpointChunk, StageState, SequencerState, ObjectState, RunEvent, Log)


def full_name(message_type):
    """``package/msg/Type`` of a message class."""
    return f'{message_type.__module__.split(".")[0]}/msg/{message_type.__name__}'


def compiled_hash(name):
    """Type hash that rosidl computed when the package was built."""
    package, _, bare = name.split('/')
    path = Path(get_package_share_directory(package)) / 'msg' / f'{bare}.json'
    hashes = json.loads(path.read_text(encoding='utf-8'))['type_hashes']
    return next(entry['hash_string'] for entry in hashes if entry['type_name'] == name)


@pytest.mark.parametrize('message_type', TYPES, ids=full_name)
def test_schema_describes_the_type_that_ros_compiled(message_type):
    """The hash that rosbags computes from our text alone is the one that rosidl compiled in."""
    name = full_name(message_type)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(ros2msg_schema(name), name))
    assert store.hash_rihs01(name) == compiled_hash(name)


@pytest.mark.parametrize('name', ['rcl_interfaces/msg/Log', 'diagnostic_msgs/msg/DiagnosticArray'])
def test_schema_of_a_common_type_is_the_one_that_rosbags_knows(name):
    """Constants and fields, also of the dependencies, equal those that come with rosbags."""
    known = get_typestore(Stores.ROS2_JAZZY).fielddefs
    ours = get_types_from_msg(ros2msg_schema(name), name)
    assert ours == {name: known[name] for name in ours}
    assert len(ours) > 1


def test_every_way_to_name_a_type_is_followed_once():
    """Arrays, bounds, bare and long names lead to their definitions; constants lead nowhere."""
    files = {
        ('a_msgs', 'Root'): 'uint8 N=3\nstring<=5 s\nItem[] i\nb_msgs/msg/Leaf[<=4] l  # c/No x\n',
        ('a_msgs', 'Item'): 'b_msgs/Leaf[2] leaf\nItem2 z\n',
        ('a_msgs', 'Item2'): 'float64[3] x 1.0\n',
        ('b_msgs', 'Leaf'): 'wstring w\n',
    }
    text = ros2msg_schema('a_msgs/msg/Root', lambda package, name: files[package, name])
    assert [line for line in text.splitlines() if line.startswith('MSG: ')] == [
        'MSG: a_msgs/Item',
        'MSG: b_msgs/Leaf',
        'MSG: a_msgs/Item2',
    ]
    assert text.count('=' * 80 + '\n') == 3


def test_a_type_that_is_not_installed_is_named():
    """The error names the message that is missing."""
    with pytest.raises(LookupError, match='has no message Nothing'):
        ros2msg_schema('std_msgs/msg/Nothing')
