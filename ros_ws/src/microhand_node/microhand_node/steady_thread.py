# SPDX-License-Identifier: Apache-2.0
"""A thread that does something again and again, at a steady rate.

For what must not wait for the executor of a node, nor keep it: for every tick of a timer of rclpy
the executor goes through all services of the node.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class SteadyThread:
    """Calls a function at absolute deadlines, in a thread of its own.

    Parameters
    ----------
    action : callable
        What to do; must not raise.
    period_s : float
        Time between two calls [s].
    name : str
        Of the thread.
    """

    def __init__(self, action: Callable[[], None], *, period_s: float, name: str) -> None:
        self._action = action
        self._period_s = period_s
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """Act once more, end the thread, and return when it is gone."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        deadline_s = time.monotonic()
        while not self._stopping.is_set():
            self._action()
            now_s = time.monotonic()
            # Calls that are late are left out, not made up for.
            deadline_s = max(deadline_s + self._period_s, now_s)
            time.sleep(deadline_s - now_s)
        self._action()
