# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling of a process, and one that may not have it, as the kernel sees them."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

PRIORITY = 7
PR_CAPBSET_DROP = 24
CAP_SYS_NICE = 23
CHILD = """
import json, os, sys, threading
from stage_driver_sim.realtime import run_first

go_on = threading.Event()
threads = [threading.Thread(target=go_on.wait) for _ in range(3)]
for thread in threads:
    thread.start()
refused = run_first(threads[1].native_id, int(sys.argv[1]))
later = threading.Thread(target=go_on.wait)
later.start()
ids = [threading.get_native_id(), *(thread.native_id for thread in (*threads, later))]
print(json.dumps([refused, [
    [os.sched_getscheduler(i), os.sched_getparam(i).sched_priority] for i in ids
]]))
go_on.set()
"""


def scheduled(*, allowed: bool) -> tuple[str, list[list[int]]]:
    """Return what a new process is told, and policy and priority of its threads."""

    def forbid() -> None:
        resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0)  # root heeds no limit

    run = subprocess.run(
        [sys.executable, '-c', CHILD, str(PRIORITY)],
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=None if allowed else forbid,
    )
    refused, threads = json.loads(run.stdout)
    return refused, threads


def may_ask() -> bool:
    """Return whether this user is allowed real-time priorities; root in a container may not be."""
    status = Path('/proc/self/status').read_text(encoding='ascii', errors='replace')
    capabilities = int(status.partition('CapEff:')[2].split()[0], 16)
    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return bool(capabilities >> CAP_SYS_NICE & 1) or limit >= PRIORITY


@pytest.mark.skipif(not may_ask(), reason='this user may not have real-time priorities')
def test_one_thread_comes_first_and_all_before_ordinary_ones() -> None:
    """FIFO for all, also for a thread that is started later; only one has the higher priority."""
    refused, threads = scheduled(allowed=True)
    assert refused == ''
    rest = [os.SCHED_FIFO, 1]
    assert threads == [rest, rest, [os.SCHED_FIFO, PRIORITY], rest, rest]


def test_who_may_not_is_told_and_goes_on_as_before() -> None:
    """The reason is the kernel's, and every thread stays ordinary."""
    refused, threads = scheduled(allowed=False)
    assert refused == 'Operation not permitted; see `ulimit -r`'
    assert threads == [[os.SCHED_OTHER, 0]] * 5
