# SPDX-License-Identifier: Apache-2.0
"""The installation → versions of what a run depends on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

from rclpy.utilities import get_rmw_implementation_identifier

# The wheels and the packages of Ubuntu have different names.
_PACKAGES = (
    *('microhand_station', 'microhand_planner', 'microhand_twin', 'stage_driver_sim'),
    'microhand_node',
    *('microhand_msgs_py', 'ros-rclpy', 'rclpy', 'mcap', 'zstandard'),
    *('numpy', 'scipy', 'numba', 'trimesh', 'mujoco'),
)


def versions() -> dict[str, str]:
    """Return name and version of what is installed, of Python, ROS and the system."""
    found = {name: installed for name in _PACKAGES if (installed := installed_version(name))}
    return {
        **found,
        'python': platform.python_version(),
        'system': platform.platform(),
        'rmw': get_rmw_implementation_identifier(),
        'ros_distro': os.environ.get('ROS_DISTRO', 'jazzy'),
    }


def installed_version(package: str) -> str:
    """Return the version of an installed package; empty: it is not there."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ''
