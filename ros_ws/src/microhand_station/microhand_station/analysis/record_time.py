# SPDX-License-Identifier: Apache-2.0
"""Times of recorded messages: since the start of the run, without those that damage made up."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_NS_PER_S = 1_000_000_000
# Stamps and log times of one topic differ by a nearly constant delay; a damaged one, by years.
_LONGEST_DELAY_NS = 5 * _NS_PER_S
_LONGEST_SILENCE_NS = 60 * _NS_PER_S


@dataclass(frozen=True)
class Stamped:
    """A decoded message, and when it was written into the record.

    Attributes
    ----------
    log_ns : int
        Since 1970 [ns].
    message : object
        With its fields, among them ``header``.
    """

    log_ns: int
    message: Any

    @property
    def stamp_ns(self) -> int:
        """Of the message's header, since 1970 [ns]."""
        stamp = self.message.header.stamp
        return int(stamp.sec) * _NS_PER_S + int(stamp.nanosec)


def in_time(messages: Sequence[Stamped]) -> list[Stamped]:
    """Return the messages whose stamps fit the times at which they were recorded."""
    delay_ns = [message.log_ns - message.stamp_ns for message in messages]
    usual_ns = float(np.median(delay_ns)) if delay_ns else 0.0
    return [
        message
        for message, delay in zip(messages, delay_ns, strict=True)
        if abs(delay - usual_ns) < _LONGEST_DELAY_NS
    ]


def stamps_s(messages: Sequence[Stamped], start_ns: int) -> NDArray[np.float64]:
    """Return the stamps since the start of the run, (n,) [s], to the nanosecond."""
    return 1e-9 * np.array([message.stamp_ns - start_ns for message in messages], dtype=float)


def start_and_end_ns(log_ns: Sequence[int]) -> tuple[int, int]:
    """Return the first and the last log time that damage did not make up [ns]; 0, 0: none.

    Records are written in the order of their log times, so a time that is not in order with most
    others is damaged; so is one at either end that is further off than a run is ever silent.

    Parameters
    ----------
    log_ns : sequence of int
        In the order of the file.
    """
    if not log_ns:
        return 0, 0
    middle, day_ns = sorted(log_ns)[len(log_ns) // 2], 86_400 * _NS_PER_S
    near = [time_ns for time_ns in log_ns if abs(time_ns - middle) < day_ns]
    backwards = [-time_ns for time_ns in reversed(near)]
    return -_last_in_order(backwards), _last_in_order(near)


def _last_in_order(times_ns: Sequence[int]) -> int:
    """Return the last of the longest non-decreasing part of a sequence, isolated ends left out."""
    ends: list[int] = []  # of such parts of 1, 2, ... times, the least last time
    for time_ns in times_ns:
        at = bisect_right(ends, time_ns)
        ends[at : at + 1] = [time_ns]
    while len(ends) > 2 and ends[-1] - ends[-2] > _LONGEST_SILENCE_NS:
        ends.pop()
    return ends[-1]
