# SPDX-License-Identifier: Apache-2.0
"""When each message of a record is due, at some rate and with pauses."""

from __future__ import annotations

from dataclasses import dataclass

_NS_PER_S = 1_000_000_000


@dataclass
class Pace:
    """Times of a record on a steady clock of now.

    Parameters
    ----------
    rate : float
        So many times as fast as recorded, > 0.
    begin_ns : int
        Time in the record [ns] ...
    begin_s : float
        ... that is due at this time of the steady clock [s].

    Examples
    --------
    >>> pace = Pace(rate=2.0, begin_ns=10**9, begin_s=100.0)
    >>> pace.due_s(3 * 10**9), pace.reached_ns(100.5)
    (101.0, 2000000000)
    >>> pace.pause(100.5); pace.resume(107.5)
    >>> pace.due_s(3 * 10**9)
    108.0
    """

    rate: float
    begin_ns: int
    begin_s: float
    _paused_s: float | None = None

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self._paused_s is not None

    def due_s(self, record_ns: int) -> float:
        """Return when something of the record is due, on the steady clock [s]."""
        return self.begin_s + (record_ns - self.begin_ns) / _NS_PER_S / self.rate

    def reached_ns(self, now_s: float) -> int:
        """Return how far the record has come [ns]."""
        at_s = now_s if self._paused_s is None else self._paused_s
        return self.begin_ns + round((at_s - self.begin_s) * self.rate * _NS_PER_S)

    def pause(self, now_s: float) -> None:
        """Stand still from now on."""
        if self._paused_s is None:
            self._paused_s = now_s

    def resume(self, now_s: float) -> None:
        """Go on: everything is due later by the length of the pause."""
        if self._paused_s is not None:
            self.begin_s += now_s - self._paused_s
            self._paused_s = None

    def skip_to(self, record_ns: int) -> None:
        """While paused: make something of the record due at once."""
        if self._paused_s is not None:
            self.begin_s += self._paused_s - self.due_s(record_ns)
