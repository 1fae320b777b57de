# SPDX-License-Identifier: Apache-2.0
"""Setpoint chunks of one finger → how many there were, and whether in order and without a gap."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class SetpointTally:
    """Count of the setpoints of one finger, and of what is wrong with their numbers.

    A stream numbers its setpoints from 0; a new stream number starts again from 0.

    Attributes
    ----------
    count : int
        Setpoints seen, repeated ones included.
    missing : int
        Setpoints that were skipped by a jump ahead in the numbers.
    out_of_order : int
        Setpoints whose number had already passed: repeated or late ones.

    Examples
    --------
    >>> tally = SetpointTally()
    >>> for first in (0, 10, 30):
    ...     tally.add(stream=1, first=first, size=10)
    >>> tally.count, tally.missing, tally.complete
    (30, 10, False)
    """

    count: int = 0
    missing: int = 0
    out_of_order: int = 0
    _stream: int | None = None
    _next: int = 0

    def add(self, stream: int, first: int, size: int) -> None:
        """Take a chunk of `size` setpoints into account, the first of which has number `first`."""
        if stream != self._stream:
            self._stream = stream
            self._next = 0
        self.count += size
        self.missing += max(0, first - self._next)
        self.out_of_order += min(size, max(0, self._next - first))
        self._next = max(self._next, first + size)

    @property
    def complete(self) -> bool:
        """Whether every setpoint came once and in order."""
        return self.missing == 0 and self.out_of_order == 0
