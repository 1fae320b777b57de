# SPDX-License-Identifier: Apache-2.0
"""A driver that was frozen for so long that DDS forgot it: found again, it is of use."""

import os
import signal
import time

import pytest
from microhand_msgs_py.msg import StageState

from microhand_station.recording.parameter_book import ParameterBook

LEASE = """<profiles xmlns="http://www.eprosima.com">
  <participant profile_name="soon_forgotten" is_default_profile="true"><rtps><builtin>
    <discovery_config>
      <leaseDuration><sec>2</sec></leaseDuration>
      <leaseAnnouncement><sec>0</sec><nanosec>500000000</nanosec></leaseAnnouncement>
    </discovery_config>
  </builtin></rtps></participant>
</profiles>
"""
"""Forgotten after 2 s; by default it takes 20 s."""
DRIVER = '/bench/finger_2/stage_driver'
DEADLINE_S = 20.0
FOUND_S = 8.0
"""After so long a driver that has not been found again will not be [s]."""
TRIES = 4


@pytest.fixture
def bench(ros_domain, tmp_path, sphere_mesh):
    """Return a bench whose processes are forgotten soon."""
    from tests.station.bench import Bench

    (tmp_path / 'lease.xml').write_text(LEASE)
    environment = {'FASTRTPS_DEFAULT_PROFILES_FILE': str(tmp_path / 'lease.xml')}
    bench = Bench(tmp_path, sphere_mesh, environment=environment)
    yield bench
    bench.close()


def comes_true(condition, deadline_s=DEADLINE_S):
    """Return as soon as a condition holds, whether it does so before the deadline."""
    give_up_s = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > give_up_s:
            return False
        time.sleep(0.02)
    return True


def counts(bench):
    """Return how many listeners to finger 2 the sequencer and the client see."""
    return [n.count_subscribers('finger_2/setpoints') for n in (bench.node, bench.client.node)]


def freeze(bench, all_there):
    """Freeze the driver of finger 2 until it is forgotten; return whether it is found again."""
    assert comes_true(lambda: 'stage_driver' in bench.node._stages[1].listeners())
    os.kill(bench.drivers[2].pid, signal.SIGSTOP)
    try:
        assert comes_true(lambda: all(map(int.__lt__, counts(bench), all_there)))
    finally:
        os.kill(bench.drivers[2].pid, signal.SIGCONT)
    return comes_true(lambda: counts(bench) == all_there, FOUND_S)


def start_again(bench, all_there):
    """Do what the how-to says about a driver that is not found again."""
    bench.drivers[2].kill()
    assert comes_true(lambda: all(map(int.__lt__, counts(bench), all_there)))
    bench.drivers[2] = bench.drivers[2].again()
    bench.activate(2)
    assert comes_true(lambda: counts(bench) == all_there)


def test_a_driver_that_was_forgotten_is_of_use_again(bench, sphere_plan):
    """Found again, it executes the next run, and the recorder's book has its parameters still.

    Now and then Fast DDS does not find it; then it is started again, and frozen again.
    """
    book = ParameterBook(bench.client.node)
    assert comes_true(lambda: DRIVER in book.text())
    all_there = counts(bench)
    for _ in range(TRIES):
        if freeze(bench, all_there):
            break
        start_again(bench, all_there)
    else:
        pytest.fail(f'never found again after {TRIES} times')
    bench.client.command('reset')
    bench.watcher.wait(lambda: bench.watcher.stages[2].mode == StageState.HOLDING)
    assert bench.execute(sphere_plan(10.0)).held
    assert DRIVER in book.text()
