# SPDX-License-Identifier: Apache-2.0
"""Complete editable installs: link what ROS looks for in the prefix.

pip installs console scripts into ``<prefix>/bin`` and ignores the ``install_scripts`` of setup.cfg
that colcon obeys; ``ros2 run`` and launch files look in ``<prefix>/lib/<package>``. An editable
install leaves out ``data_files``, and with them the package's mark in the ament index, its launch
files and its configuration. Links serve both, and edits take effect at once.

Usage: python link_into_prefix.py SOURCE_FOLDER...     (folders with a setup.py)
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from setuptools import Distribution

# Not before setuptools: it brings the distutils that Python 3.12 no longer has.
from distutils.core import run_setup  # isort: skip


def link(target: Path, link_name: Path) -> None:
    """Make `link_name` a link to `target`, in place of whatever was there."""
    link_name.parent.mkdir(parents=True, exist_ok=True)
    link_name.unlink(missing_ok=True)
    link_name.symlink_to(os.path.relpath(target, link_name.parent))


def link_into_prefix(source: Path, prefix: Path) -> None:
    """Link executables and data files of the package in `source` into `prefix`."""
    os.chdir(source)  # setup.py names its files as seen from there
    package: Distribution = run_setup('setup.py', stop_after='init')
    name = package.get_name()
    for entry in (package.entry_points or {}).get('console_scripts', []):
        script = entry.split('=')[0].strip()
        link(prefix / 'bin' / script, prefix / 'lib' / name / script)
    for destination, files in package.data_files:
        for file in files:
            link(source / file, prefix / destination / Path(file).name)


if __name__ == '__main__':
    for folder in [Path(argument).resolve() for argument in sys.argv[1:]]:
        link_into_prefix(folder, Path(sys.prefix))
