# SPDX-License-Identifier: Apache-2.0
"""Every package that can be installed has one version, wherever it comes from."""

import re
import sys
from importlib.metadata import distributions
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TOP = Path(__file__).parents[2]
REQUIREMENTS = TOP / 'requirements'
LISTS = ['runtime.txt', 'dev.txt', 'docs.txt', 'build.txt', 'noble.txt']


def lines_of(name: str) -> list[str]:
    """Return the lines of a requirements file without comments."""
    text = (REQUIREMENTS / name).read_text(encoding='utf-8')
    return [line for raw in text.splitlines() if (line := raw.partition('#')[0].strip())]


def normal(name: str) -> str:
    """Return a distribution's name as package indices compare it."""
    return re.sub(r'[-_.]+', '-', name).lower()


def pins() -> dict[str, str]:
    """Return the version of each package in constraints.txt."""
    return {
        normal(name): version
        for name, version in (p.split('==') for p in lines_of('constraints.txt'))
    }


def test_constraints_are_exact_and_know_no_index() -> None:
    """Each line is name==version, each name is there once, and no line names an index."""
    lines = lines_of('constraints.txt')
    assert not [
        line for line in lines if not re.fullmatch(r'[A-Za-z0-9._-]+==[A-Za-z0-9.]+', line)
    ]
    assert len(pins()) == len(lines) > 100


@pytest.mark.parametrize('name', LISTS)
def test_each_requirement_is_pinned(name: str) -> None:
    """What a list asks for by name has its version in the constraints, and only there."""
    for line in lines_of(name):
        assert re.fullmatch(r'[A-Za-z0-9._-]+(\[\w+\])?', line), (
            f'{name}: "{line}" is more than a name'
        )
        assert normal(line.partition('[')[0]) in pins(), f'{name}: {line} has no version'


def test_interfaces_build_with_the_same_tools_everywhere() -> None:
    """`pip install` of the interface package alone uses the tools and versions of `make setup`."""
    manifest = TOP / 'ros_ws' / 'src' / 'microhand_msgs_py' / 'pyproject.toml'
    required = tomllib.loads(manifest.read_text(encoding='utf-8'))['build-system']['requires']
    colcon_only = {'setuptools'} | {
        name for name in lines_of('build.txt') if name.startswith('colcon-')
    }
    names = [normal(name) for name in lines_of('build.txt') if name not in colcon_only]
    assert sorted(required) == sorted(f'{name}=={pins()[name]}' for name in names)


@pytest.mark.skipif(
    sys.prefix == sys.base_prefix, reason='constraints are for the environment of make'
)
def test_installed_versions_are_the_pinned_ones() -> None:
    """Nothing in the environment came in unpinned: dependencies of dependencies are pinned too."""
    ours = {
        'microhand-msgs-py',
        'microhand-node',
        'microhand-planner',
        'microhand-station',
        'microhand-twin',
        'stage-driver-sim',
    }
    installed = {normal(found.metadata['Name']): found.version for found in distributions()}
    # Each ROS wheel brings a second entry of the package as its own setup.py calls it.
    from_wheels = {name.removeprefix('ros-') for name in installed if name.startswith('ros-')}
    foreign = {
        name: version for name, version in installed.items() if name not in ours | from_wheels
    }
    assert {name: pins().get(name) for name in foreign} == foreign
