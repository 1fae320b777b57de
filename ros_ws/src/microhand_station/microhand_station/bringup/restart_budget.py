# SPDX-License-Identifier: Apache-2.0
"""How often a process that died is started again: a few times, not for ever."""

from __future__ import annotations

from collections import defaultdict, deque

MOST = 3
"""Restarts of one process within `WINDOW_S`; one that dies more often has a reason."""
WINDOW_S = 60.0


class RestartBudget:
    """Counts restarts by name.

    Examples
    --------
    >>> budget = RestartBudget()
    >>> [budget.spend('twin', now_s) for now_s in (0.0, 1.0, 2.0, 3.0, 61.0)]
    [True, True, True, False, True]
    """

    def __init__(self) -> None:
        self._spent_s: defaultdict[str, deque[float]] = defaultdict(lambda: deque(maxlen=MOST))

    def spend(self, name: str, now_s: float) -> bool:
        """Return whether a process may be started again now, and count it if so.

        Parameters
        ----------
        name : str
            Of the process.
        now_s : float
            On any clock that does not go back [s].
        """
        spent_s = self._spent_s[name]
        if len(spent_s) == MOST and now_s - spent_s[0] < WINDOW_S:
            return False
        spent_s.append(now_s)
        return True
