# SPDX-License-Identifier: Apache-2.0
"""Put the executables of pip-installed packages where `ros2 run` and launch files look.

pip installs console scripts into ``<prefix>/bin`` and ignores the ``install_scripts`` of setup.cfg
that colcon obeys; ROS looks in ``<prefix>/lib/<package>``. A link there serves both.

Usage: python link_executables.py PACKAGE...
"""

from __future__ import annotations

import sys
from importlib.metadata import distribution
from pathlib import Path


def link_executables(package: str, prefix: Path) -> None:
    """Make ``<prefix>/lib/<package>`` hold a link for each console script of `package`, and no other."""
    folder = prefix / 'lib' / package
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    for script in distribution(package).entry_points.select(group='console_scripts'):
        (folder / script.name).symlink_to(Path('..', '..', 'bin', script.name))


if __name__ == '__main__':
    for name in sys.argv[1:]:
        link_executables(name, Path(sys.prefix))
