# SPDX-License-Identifier: Apache-2.0
"""The made run, written once for all tests of a session that only read it."""

import importlib.util
import sys
from pathlib import Path

import pytest


def _made_run():
    """Import the module beside this one: test modules are not in packages."""
    path = Path(__file__).with_name('made_run.py')
    spec = importlib.util.spec_from_file_location('made_run', path)
    module = importlib.util.module_from_spec(spec)
    sys.modules['made_run'] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='session')
def made():
    """Return the module `made_run`: what the record says follows from its formulas."""
    return sys.modules.get('made_run') or _made_run()


@pytest.fixture(scope='session')
def record(made, tmp_path_factory):
    """Return the path of the record of a whole run."""
    return made.write(tmp_path_factory.mktemp('made') / 'made.mcap')
