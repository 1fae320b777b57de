# SPDX-License-Identifier: Apache-2.0
"""Ending a search from outside, by a time limit or a caller, and seeing how far it is."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from microhand_planner.core.rotation_lattice import IntArray
from microhand_planner.core.search_result import Outcome

_POLL_S = 0.01


def uninterrupted() -> IntArray:
    """Return the flag of searches that nobody watches."""
    return np.zeros(2, dtype=np.int64)


@contextmanager
def interruption(
    time_limit_s: float | None,
    cancelled: Callable[[], bool] | None,
    clock: Callable[[], float],
    progress: Callable[[int], None] | None = None,
) -> Iterator[IntArray]:
    """Provide the flag that searches look at, raised by a watching thread.

    The compiled searches release the interpreter and read the flag before every expansion,
    so they end within the polling period of 10 ms.

    Parameters
    ----------
    time_limit_s : float or None
        Time from now [s]; None: no limit.
    cancelled : callable or None
        Asked again and again; True ends the search. None: nobody cancels.
    clock : callable
        Current time [s].
    progress : callable, optional
        Told again and again how many states were expanded.

    Yields
    ------
    (2,) int64
        Zero, or the `Outcome` with which the search shall end; states that all searches with this
        flag have expanded so far.
    """
    flag = uninterrupted()
    if time_limit_s is None and cancelled is None and progress is None:
        yield flag
        return
    started = clock()
    done = threading.Event()

    def watch() -> None:
        while not done.wait(_POLL_S):
            if progress is not None:
                progress(int(flag[1]))
            if cancelled is not None and cancelled():
                flag[0] = Outcome.CANCELLED
            elif time_limit_s is not None and clock() - started > time_limit_s:
                flag[0] = Outcome.TIME_LIMIT

    watcher = threading.Thread(target=watch, name='search-watch', daemon=True)
    watcher.start()
    try:
        yield flag
    finally:
        done.set()
        watcher.join()
