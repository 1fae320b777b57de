# SPDX-License-Identifier: Apache-2.0
"""Every interface survives the wire: serialised to CDR and back, with a value in every field."""

import importlib
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import (
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
    UnboundedSequence,
    UnboundedString,
)

PACKAGE = Path(__file__).parents[2] / 'ros_ws' / 'src' / 'microhand_msgs_py'
NAMES = sorted(
    f'{kind}/{path.stem}'
    for kind in ('msg', 'srv', 'action')
    for path in PACKAGE.glob(f'{kind}/*')
)


def load(name: str) -> Any:
    """Import the generated class of ``msg/Plan`` and the like."""
    kind, _, stem = name.partition('/')
    return getattr(importlib.import_module(f'microhand_msgs_py.{kind}'), stem)


def parts_of(name: str) -> list[Any]:
    """Return the classes that travel: the message, both sides of a service, three of an action."""
    interface = load(name)
    sides = {'msg': [], 'srv': ['Request', 'Response'], 'action': ['Goal', 'Result', 'Feedback']}
    return [getattr(interface, side) for side in sides[name.partition('/')[0]]] or [interface]


def filled(message_class: Any, seed: np.random.Generator) -> Any:
    """Return a message with a value other than the default in each field."""
    message = message_class()
    for field, kind in zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True):
        setattr(message, field, value_of(kind, seed))
    return message


def value_of(kind: Any, seed: np.random.Generator) -> Any:
    """Return a value of a rosidl type that is not its default."""
    if isinstance(kind, Array):
        return [value_of(kind.value_type, seed) for _ in range(kind.size)]
    if isinstance(kind, UnboundedSequence | BoundedSequence):
        return [value_of(kind.value_type, seed) for _ in range(3)]
    if isinstance(kind, NamespacedType):
        package = importlib.import_module('.'.join(kind.namespaces))
        return filled(getattr(package, kind.name), seed)
    if isinstance(kind, UnboundedString):
        return f'µm {seed.integers(1000)}'
    assert isinstance(kind, BasicType)
    if kind.typename == 'boolean':
        return True
    if kind.typename in {'float', 'double'}:
        return float(seed.normal())
    bits = int(''.join(filter(str.isdigit, kind.typename)))
    return int(seed.integers(1, 2 ** (bits - 1)))


@pytest.mark.parametrize('name', NAMES)
def test_every_field_survives_the_wire(name: str) -> None:
    """CDR gives back each field of each part, bit for bit (seed 1)."""
    seed = np.random.default_rng(1)
    for part in parts_of(name):
        sent = filled(part, seed)
        assert part.get_fields_and_field_types() == {} or sent != part()
        assert deserialize_message(serialize_message(sent), part) == sent


@pytest.mark.parametrize('name', NAMES)
def test_defaults_survive_the_wire(name: str) -> None:
    """The default of each part, which requests rely on, comes back as it is."""
    for part in parts_of(name):
        assert deserialize_message(serialize_message(part()), part) == part()


def test_nan_survives_the_wire() -> None:
    """NaN says 'not in contact', so it must arrive as NaN, and infinity as infinity."""
    step = load('msg/PlanStep')(contact_normals=[math.nan, math.inf, -0.0])
    arrived = deserialize_message(serialize_message(step), type(step)).contact_normals
    assert math.isnan(arrived[0])
    assert arrived[1] == math.inf
    assert math.copysign(1.0, arrived[2]) == -1.0


def test_wrong_types_are_refused() -> None:
    """With rosidl's checks on, what C would read as garbage is refused where it is set."""
    with pytest.raises(AssertionError):
        load('msg/PlanStep')(in_contact=[True] * 4)
    with pytest.raises(AssertionError):
        load('msg/SetpointChunk')(period=1)


@pytest.mark.skipif(sys.prefix == sys.base_prefix, reason='by apt, the setup script does it')
def test_any_process_of_the_environment_finds_the_types(tmp_path: Path) -> None:
    """A bare process, without a setup script, finds definitions by the ament index."""
    script = """
import importlib
from ament_index_python import get_package_share_directory, get_resource
share = get_package_share_directory('microhand_msgs_py')
for line in get_resource('rosidl_interfaces', 'microhand_msgs_py')[0].split():
    open(f'{share}/{line}').close()
    folder, _, file = line.partition('/')
    if not file.endswith(('.json', '.idl')):
        module = importlib.import_module(f'microhand_msgs_py.{folder}')
        module = getattr(module, file.partition('.')[0])
        print(folder + '/' + module.__name__)
"""
    done = subprocess.run(
        [sys.executable, '-c', script],
        cwd=tmp_path,
        env={'HOME': str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert sorted(done.stdout.split()) == NAMES
