# SPDX-License-Identifier: Apache-2.0
"""The reporting thread: on time on average, once more at the end, and then gone."""

from __future__ import annotations

import threading
import time

from microhand_node.steady_thread import SteadyThread

DEADLINE_S = 5.0


def test_it_reports_at_its_rate_and_once_more_at_the_end() -> None:
    """Never more reports than periods have passed; the last one comes from `stop`."""
    times_s: list[float] = []
    enough = threading.Event()

    def report() -> None:
        times_s.append(time.monotonic())
        if len(times_s) == 20:
            enough.set()

    reporter = SteadyThread(report, period_s=0.005, name='reporter')
    reporter.start()
    assert enough.wait(DEADLINE_S)
    assert times_s[19] - times_s[0] > 0.5 * 19 * 0.005  # single reports may be late
    before_stop_s = time.monotonic()
    reporter.stop()
    assert times_s[-1] >= before_stop_s
    assert not reporter._thread.is_alive()


def test_a_slow_report_is_not_made_up_for() -> None:
    """After a report that took ten periods the next ones come one period apart, not in a burst."""
    times_s: list[float] = []
    enough = threading.Event()

    def report() -> None:
        times_s.append(time.monotonic())
        if len(times_s) == 1:
            time.sleep(0.1)
        if len(times_s) == 8:
            enough.set()

    reporter = SteadyThread(report, period_s=0.01, name='reporter')
    reporter.start()
    assert enough.wait(DEADLINE_S)
    reporter.stop()
    assert times_s[7] - times_s[1] > 0.5 * 6 * 0.01
