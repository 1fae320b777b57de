# SPDX-License-Identifier: Apache-2.0
"""What `make` says on a machine where something is missing: one line, before anything is made."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
TOOLS = ['bash', 'sh', 'cut', 'make', 'mkdir', 'sed', 'sha256sum', 'touch']
"""What the Makefile may assume besides Python, gcc and g++."""

pytestmark = pytest.mark.skipif(shutil.which('make') is None, reason='an image without make')


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """Return a folder with the tree's build files and a `path` folder with the bare tools."""
    shutil.copy(TOP / 'Makefile', tmp_path)
    shutil.copytree(TOP / 'requirements', tmp_path / 'requirements')
    path = tmp_path / 'path'
    path.mkdir()
    for tool in TOOLS:
        (path / tool).symlink_to(str(shutil.which(tool)))
    return tmp_path


def python_that(machine: Path, script: str) -> str:
    """Put an executable named `python-for-test` on the machine; `script` is what it does."""
    program = machine / 'path' / 'python-for-test'
    program.write_text(f'#!/bin/sh\n{script}\n')
    program.chmod(0o755)
    return program.name


def setup(machine: Path, python: str) -> str:
    """Run `make setup`, which must fail, and return the line of microhand on stderr."""
    done = subprocess.run(
        ['make', 'setup', f'PYTHON={python}'],
        cwd=machine,
        env={'PATH': str(machine / 'path'), 'HOME': os.environ.get('HOME', '/')},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    said = done.stderr.splitlines()
    ours = [line for line in said if not line.startswith('make: ***')]
    assert len(ours) == 1, done.stderr
    assert not (machine / '.venv').exists()
    return ours[0]


def test_missing_python_is_named(machine: Path) -> None:
    """A Python that is not there is named, with the versions that would do."""
    line = setup(machine, 'python-from-nowhere')
    assert line.startswith('microhand: python-from-nowhere was not found')
    assert '3.10 to 3.13' in line


@pytest.mark.parametrize('version', ['3.9', '3.14', '2.7'])
def test_wrong_python_is_named(machine: Path, version: str) -> None:
    """A Python outside 3.10 to 3.13 is refused with its own version and the allowed ones."""
    line = setup(machine, python_that(machine, f'echo py{version}'))
    assert f'is Python {version}' in line
    assert '3.10 to 3.13' in line


def test_missing_venv_module_is_named(machine: Path) -> None:
    """A Python without ensurepip, as Debian ships it, leads to the package that has it."""
    line = setup(
        machine, python_that(machine, 'echo py3.11; case "$*" in *ensurepip*) exit 1;; esac')
    )
    assert 'python3-venv' in line


def test_missing_headers_are_named(machine: Path) -> None:
    """A Python without Python.h leads to the package that has it."""
    line = setup(
        machine, python_that(machine, 'echo py3.11; case "$*" in *Python.h*) exit 1;; esac')
    )
    assert 'python3-dev' in line


def test_missing_compiler_is_named(machine: Path) -> None:
    """Without gcc, or with gcc and no g++, the missing one is named."""
    python = python_that(machine, 'echo py3.11')
    assert 'no gcc;' in setup(machine, python)
    (machine / 'path' / 'gcc').symlink_to('/bin/true')
    assert 'no g++;' in setup(machine, python)
