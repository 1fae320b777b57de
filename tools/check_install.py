# SPDX-License-Identifier: Apache-2.0
"""Look at what colcon installed, as a fresh process with its setup script sourced sees it.

Usage: python check_install.py INSTALL_FOLDER     (leaves with status 1 at the first thing missing)
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

from ament_index_python import get_package_prefix
from rclpy.serialization import deserialize_message, serialize_message

SOURCES = Path(__file__).parents[1] / 'ros_ws' / 'src'
EXECUTABLES: dict[str, list[str]] = {
    'microhand_node': [],
    'microhand_planner': ['planner_node'],
    'microhand_twin': ['twin'],
    'stage_driver_sim': ['gcs_server', 'stage_driver'],
    'microhand_station': ['microhand', 'recorder', 'sequencer'],
}


def require(condition: bool, what: str) -> None:
    """Leave with a sentence unless `condition` holds."""
    if not condition:
        sys.exit(f'colcon install: {what}')


def check_package(name: str, install: Path) -> None:
    """Check that the package comes from `install`, for Python and for the ament index."""
    origin = Path(str(importlib.import_module(name).__file__))
    require(install in origin.parents, f'{name} is imported from {origin}')
    require(install in Path(get_package_prefix(name)).parents, f'{name} is not in the index')


def check_files(name: str, source: Path) -> None:
    """Check that all files of a Python package were installed, meshes and tables included."""
    installed = Path(str(importlib.import_module(name).__file__)).parent
    for path in source.rglob('*'):
        relative = path.relative_to(source)
        cache = any(part.startswith(('.', '__pycache__')) for part in relative.parts)
        if path.is_file() and not cache:
            require((installed / relative).is_file(), f'{name}/{relative} was not installed')


def check_messages(install: Path) -> None:
    """Send a plan through the C libraries, and see that they are the installed ones."""
    messages = importlib.import_module('microhand_msgs_py.msg')
    plan = messages.Plan(steps=[messages.PlanStep(angle=0.5)])
    arrived = deserialize_message(serialize_message(plan), messages.Plan)
    require(arrived == plan, 'a plan does not survive serialisation')
    maps = Path('/proc/self/maps').read_text()
    libraries = {line.split()[-1] for line in maps.splitlines() if 'microhand_msgs_py' in line}
    foreign = [library for library in libraries if install not in Path(library).parents]
    require(bool(libraries) and not foreign, f'libraries from elsewhere: {foreign}')


def check_executables(install: Path) -> None:
    """Check that each executable is where `ros2 run` looks, and that the command starts."""
    for package, names in EXECUTABLES.items():
        for name in names:
            path = install / package / 'lib' / package / name
            require(os.access(path, os.X_OK), f'{path} is missing')
    command = install / 'microhand_station' / 'lib' / 'microhand_station' / 'microhand'
    done = subprocess.run([command, '--help'], capture_output=True, text=True, timeout=60)
    require(done.returncode == 0, f'microhand --help ends with {done.returncode}: {done.stderr}')


if __name__ == '__main__':
    folder = Path(sys.argv[1]).resolve()
    for package_name in ('microhand_msgs_py', *EXECUTABLES):
        check_package(package_name, folder)
    for package_name in EXECUTABLES:
        check_files(package_name, SOURCES / package_name / package_name)
    check_messages(folder)
    check_executables(folder)
    print(f'{folder}: six packages, messages and executables are in place')
