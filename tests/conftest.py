# SPDX-License-Identifier: Apache-2.0
"""What all tests share: a ROS domain of their own, messages that check fields, a place in time.

Tests that run a station in real time spend their time waiting; all others compute. With two
workers (``-n 2``, as `make test` has it) one runs the tests in real time one after the other; the
second computes, and gives way.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

TESTS = Path(__file__).parent.name
REAL_TIME = {
    *('node', 'stage', 'station', 'system', 'view'),
    *('test_twin_node', 'test_planner_node', 'test_replay', 'test_station_commands'),
}
"""Folders and modules whose tests start nodes, and drive them in real time."""
GIVE_WAY = 19  # niceness

# How long an example takes says something about the machine, not about the code.
settings.register_profile('microhand', deadline=None)
settings.load_profile('microhand')

# Generated messages check the types of their fields, in this process and its children. Off by
# default in Jazzy, where an int in a float field reaches the wire as garbage. Classes read it when
# they are imported, and a conftest.py may do that: no fixture and no hook is early enough.
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'


def in_real_time(nodeid: str) -> bool:
    """Return whether a test runs nodes in real time."""
    file = Path(nodeid.partition('::')[0])
    return file.parts[0] == TESTS and not REAL_TIME.isdisjoint(file.with_suffix('').parts)


class RealTimeApart(LoadScopeScheduling):
    """Gives all tests in real time to one worker, the others file by file to whoever is free."""

    def _split_scope(self, nodeid: str) -> str:
        return 'real time' if in_real_time(nodeid) else nodeid.partition('::')[0]


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> RealTimeApart:
    """Share out the tests between two workers; the largest share is the first to be given out."""
    return RealTimeApart(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give tests in real time two more tries.

    A stage that hears nothing for 50 ms holds, and its run ends: that is what it is for. A machine
    that stalls for so long does the same to a test.
    """
    for item in items:
        if in_real_time(item.nodeid):
            item.add_marker(pytest.mark.flaky(reruns=2))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let a worker that computes beside a station give way to it.

    Linux shares the processors out between sessions first, then by niceness within each.
    """
    if (
        'PYTEST_XDIST_WORKER' in os.environ
        and not in_real_time(item.nodeid)
        and os.nice(0) < GIVE_WAY
    ):
        os.nice(GIVE_WAY)
        os.setsid()
        with suppress(OSError):  # a kernel without such groups
            Path('/proc/self/autogroup').write_text(str(GIVE_WAY))


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
