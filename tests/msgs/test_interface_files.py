# SPDX-License-Identifier: Apache-2.0
"""The interface definitions as a reader sees them: documented, with units, complete."""

import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / 'ros_ws' / 'src' / 'microhand_msgs_py'
FILES = sorted(
    path for kind in ('msg', 'srv', 'action') for path in PACKAGE.glob(f'{kind}/*.{kind}')
)

FIELD = re.compile(
    r'^(?P<type>[\w/]+(?:<=\d+)?(?P<array>\[[^]]*\])?)\s+(?P<name>[a-z][a-z0-9_]*)$'
)
CONSTANT = re.compile(r'^(?P<type>\w+)\s+(?P<name>[A-Z][A-Z0-9_]*)\s*=\s*(?P<value>\S+)$')
UNIT = re.compile(r'\[(-|rad|s|m|m/s|m/s2|N|Hz)\]')
NUMBER = re.compile(r'^(float|u?int)\d+')
GEOMETRY = re.compile(r'^geometry_msgs/(Point|Vector3|Pose)$')
ENUMERATIONS = {'mode', 'state', 'kind', 'phase', 'error_code'}
"""Numbers that stand for names: constants of the same file, or of ErrorCode."""


def lines_of(path: Path) -> list[tuple[str, str]]:
    """Return (definition, comment) of each line of an interface file that defines something."""
    parts = [line.partition('#') for line in path.read_text(encoding='utf-8').splitlines()]
    return [
        (code.strip(), note.strip()) for code, _, note in parts if code.strip() not in ('', '---')
    ]


def fields_of(path: Path) -> list[tuple[str, str, str]]:
    """Return (type, name, comment) of each field of an interface file."""
    found = []
    for definition, comment in lines_of(path):
        if field := FIELD.match(definition):
            found.append((field['type'], field['name'], comment))
        else:
            assert CONSTANT.match(definition), f'{path.name}: cannot read "{definition}"'
    return found


def test_all_kinds_of_interfaces_are_found() -> None:
    """The checks below look at messages, services and actions, not at an empty list."""
    assert {path.suffix for path in FILES} == {'.msg', '.srv', '.action'}
    assert sum(len(fields_of(path)) for path in FILES) > 100


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_file_says_what_it_is_for(path: Path) -> None:
    """The first line of each definition is a sentence about the whole."""
    first = path.read_text(encoding='utf-8').splitlines()[0]
    assert re.match(r'# \S.{15,}', first), f'{path.name} begins with "{first}"'


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_each_field_is_explained(path: Path) -> None:
    """No field is left to guessing: each has a comment on its line."""
    assert not [name for _, name, comment in fields_of(path) if len(comment) < 3]


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_vectors_name_their_frame(path: Path) -> None:
    """A point, vector or pose says in which frame it is, on its line or on line 1."""
    first = path.read_text(encoding='utf-8').splitlines()[0].lower()
    assert not [
        f'{name}  # {comment}'
        for kind, name, comment in fields_of(path)
        if GEOMETRY.match(kind) and not re.search('frame|axes|station', f'{comment} {first}')
    ]


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_numbers_carry_a_unit(path: Path) -> None:
    """A number, a point or a vector names its unit, or stands for named constants."""
    without = [
        f'{kind} {name}  # {comment}'
        for kind, name, comment in fields_of(path)
        if (NUMBER.match(kind) or kind in {'geometry_msgs/Point', 'geometry_msgs/Vector3'})
        and name not in ENUMERATIONS
        and not UNIT.match(comment)
        and not (name == 'finger' and '1, 2' in comment)
    ]
    assert not without


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_enumerations_have_their_constants(path: Path) -> None:
    """A field that stands for names has its constants in the file, or is an error code."""
    constants = [CONSTANT.match(definition) for definition, _ in lines_of(path)]
    types = [constant['type'] for constant in constants if constant]
    for kind, name, comment in fields_of(path):
        if name == 'error_code':
            assert kind == 'uint16'
            assert 'ErrorCode' in comment
        elif name in ENUMERATIONS:
            assert types.count(kind) >= 2


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_build_lists_the_file(path: Path) -> None:
    """Each definition is generated: rosidl makes what CMakeLists.txt lists, and nothing else."""
    listed = re.findall(
        r'"((?:msg|srv|action)/\w+\.\w+)"', (PACKAGE / 'CMakeLists.txt').read_text()
    )
    assert path.relative_to(PACKAGE).as_posix() in listed
    assert len(listed) == len(set(listed)) == len(FILES)
