# SPDX-License-Identifier: Apache-2.0
"""What all tests share: a ROS domain of their own, and messages that check their fields."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

# Generated messages check the types of their fields, in this process and its children. Off by
# default in Jazzy, where an int in a float field reaches the wire as garbage. Classes read it when
# they are imported, and a conftest.py may do that: no fixture and no hook is early enough.
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'


@pytest.fixture(scope='session', autouse=True)
def ros_domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Give this test session, and every process that it starts, a ROS domain of its own.

    Nodes of another session, or of a station that runs on this machine, are never seen. The domain
    follows from the process id, 1 to 100: sessions side by side differ.
    """
    domain = 1 + os.getpid() % 100
    log_dir: Path = tmp_path_factory.mktemp('ros_log')
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv('ROS_DOMAIN_ID', str(domain))
        environment.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        environment.setenv('ROS_LOG_DIR', str(log_dir))
        environment.delenv('ROS_STATIC_PEERS', raising=False)
        yield domain


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    """Give a Chromium without a window, driven by playwright; its pages draw in space by software.

    Where there is none, a test is skipped and the summary says why; `.ci/run`, which installs one,
    sets MICROHAND_REQUIRE_BROWSER, and then its absence is an error. One per module: while it is
    open, nothing else in this thread can run an event loop.
    """
    program = shutil.which('chromium') or shutil.which('google-chrome')
    if program is None:
        reason = 'no chromium here to open pages (Debian, Ubuntu: apt-get install chromium)'
        if os.environ.get('MICROHAND_REQUIRE_BROWSER'):
            pytest.fail(reason)
        pytest.skip(reason)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=program,
            args=['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'],
        )
        yield opened
        opened.close()
