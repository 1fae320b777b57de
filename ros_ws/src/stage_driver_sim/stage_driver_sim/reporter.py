# SPDX-License-Identifier: Apache-2.0
"""The thread that publishes what the control loop saw, at a steady rate.

Neither the control loop publishes, which DDS could delay, nor a timer of rclpy: for every tick of
a timer the executor goes through all services of the node, which costs as much as the control.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Reporter:
    """Calls a function at absolute deadlines, in a thread of its own.

    Parameters
    ----------
    report : callable
        What to do; must not raise.
    period_s : float
        Time between two calls [s].
    """

    def __init__(self, report: Callable[[], None], *, period_s: float) -> None:
        self._report = report
        self._period_s = period_s
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='reporter')

    def start(self) -> None:
        """Begin to report."""
        self._thread.start()

    def stop(self) -> None:
        """Report once more, end the thread, and return when it is gone."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        deadline_s = time.monotonic()
        while not self._stopping.is_set():
            self._report()
            now_s = time.monotonic()
            # Reports that are late are left out, not made up for.
            deadline_s = max(deadline_s + self._period_s, now_s)
            time.sleep(deadline_s - now_s)
        self._report()
