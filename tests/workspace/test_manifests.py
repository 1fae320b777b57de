# SPDX-License-Identifier: Apache-2.0
"""The six packages say the same about themselves to pip, to colcon and to ROS."""

import ast
import re
import sys
import xml.etree.ElementTree as ElementTree
from importlib import import_module
from importlib.metadata import entry_points, version
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[2] / 'ros_ws' / 'src'
PACKAGES = [
    'microhand_node',
    'microhand_planner',
    'microhand_station',
    'microhand_twin',
    'stage_driver_sim',
]
ROSDEP_KEYS = {'python3-trimesh-pip': 'trimesh'}
"""Where the rosdep key is not python3-<module>."""
FOR_TRIMESH = {'lxml', 'networkx'}
"""What trimesh imports to read 3MF and GLB files."""
STARTED = {'microhand_station': {'stage_driver_sim'}}
"""Packages whose nodes a package starts, without importing them."""
NOT_IN_ROSDEP = {
    'imageio_ffmpeg',
    'mcap',
    'mcap_ros2',
    'mujoco',
    'ruckig',
    'viser',
    'websockets',
}
"""docker/Dockerfile installs these by pip, from requirements/noble.txt."""


def manifest(package: str) -> ElementTree.Element:
    """Return the root of package.xml."""
    return ElementTree.parse(SOURCES / package / 'package.xml').getroot()


def declared(package: str) -> set[str]:
    """Return the modules that package.xml says are needed at run time."""
    names = {
        str(entry.text)
        for tag in ('depend', 'exec_depend')
        for entry in manifest(package).iter(tag)
    }
    return {ROSDEP_KEYS.get(name, name.removeprefix('python3-')) for name in names}


def imported(package: str) -> set[str]:
    """Return the top-level modules from elsewhere that the package's files import."""
    files = [
        *(SOURCES / package / package).rglob('*.py'),
        *(SOURCES / package).glob('launch/*.py'),
    ]
    nodes = [
        node for file in files for node in ast.walk(ast.parse(file.read_text(encoding='utf-8')))
    ]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    return {name.partition('.')[0] for name in names} - set(sys.stdlib_module_names) - {package}


@pytest.mark.parametrize('package', PACKAGES)
def test_manifest_declares_what_is_imported(package: str) -> None:
    """The manifest names each package and library that the code imports or starts, no other."""
    needed = (imported(package) - NOT_IN_ROSDEP) | STARTED.get(package, set())
    assert declared(package) == needed | (FOR_TRIMESH if 'trimesh' in needed else set())


@pytest.mark.parametrize('package', [*PACKAGES, 'microhand_msgs_py'])
def test_version_and_licence_agree(package: str) -> None:
    """Both pip and ROS see the same version, and the licence of the tree."""
    assert manifest(package).findtext('version') == version(package)
    assert manifest(package).findtext('license') == 'Apache-2.0'


@pytest.mark.parametrize('package', PACKAGES[1:])
def test_executables_are_where_ros_looks(package: str) -> None:
    """Each console script has a function behind it, and a file in lib/<package> for `ros2 run`."""
    scripts = [
        script
        for script in entry_points(group='console_scripts')
        if script.dist is not None and re.sub('-', '_', script.dist.name) == package
    ]
    assert scripts
    for script in scripts:
        assert callable(getattr(import_module(script.module), script.attr))
        if sys.prefix != sys.base_prefix:  # by apt, colcon puts them there
            assert (Path(sys.prefix) / 'lib' / package / script.name).exists()
