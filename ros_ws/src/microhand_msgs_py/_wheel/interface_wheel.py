# SPDX-License-Identifier: Apache-2.0
"""PEP 517 backend: scikit-build-core, told where the wheels keep their CMake packages.

CMake finds ROS packages by ``AMENT_PREFIX_PATH`` and ``CMAKE_PREFIX_PATH``. A sourced ROS
installation sets both; wheels leave that to whoever builds. Their prefix is the environment that
they are installed in, and with build isolation that is two: pip's overlay and the real one.
"""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path

from scikit_build_core.build import (
    build_sdist,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_wheel,
)
from scikit_build_core.build import build_wheel as _build_wheel

__all__ = [
    'build_sdist',
    'build_wheel',
    'get_requires_for_build_sdist',
    'get_requires_for_build_wheel',
    'prepare_metadata_for_build_wheel',
]

WITNESSES = ('ament_package', 'rosidl_adapter', 'geometry_msgs')
"""One Python package of each group of wheels that the build needs."""


def _prefix_of(package: str) -> Path:
    """Return the prefix that `package` lives in, as ``<prefix>/lib/python3.X/site-packages``."""
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise RuntimeError(f'{package} is not installed; see build-system.requires')
    return Path(spec.origin).resolve().parents[4]


def build_wheel(
    wheel_directory: str,
    config_settings: dict[str, list[str] | str] | None = None,
    metadata_directory: str | None = None,
) -> str:
    """Build the wheel with the prefixes of the ROS wheels in the environment."""
    prefixes = dict.fromkeys(str(_prefix_of(package)) for package in WITNESSES)
    os.environ['AMENT_PREFIX_PATH'] = os.environ['CMAKE_PREFIX_PATH'] = os.pathsep.join(prefixes)
    here = Path(__file__).parent
    os.environ['CMAKE_ARGS'] = ' '.join(
        [
            os.environ.get('CMAKE_ARGS', ''),
            '-DBUILD_TESTING=OFF',
            f'-DCMAKE_PROJECT_INCLUDE={here / "wheel.cmake"}',
            # Two spellings: FindPython3, and older parts of ament and rosidl.
            f'-DPython3_EXECUTABLE={sys.executable}',
            f'-DPYTHON_EXECUTABLE={sys.executable}',
        ]
    )
    return _build_wheel(wheel_directory, config_settings, metadata_directory)
