# SPDX-License-Identifier: Apache-2.0
"""Where the stage was a moment ago: contact is reported late, and asks for the position then."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from stage_driver_sim.protocol import Vector

KEPT_S = 2.0
"""How far back positions are kept [s]."""


class PositionHistory:
    """The measured positions of the last `KEPT_S`.

    Examples
    --------
    >>> import numpy as np
    >>> history = PositionHistory()
    >>> history.add(1.0, np.array([0.0, 0.0, 0.0]))
    >>> history.add(1.5, np.array([2.0, 0.0, 1.0]))
    >>> history.at(1.25).tolist()
    [1.0, 0.0, 0.5]
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[float, Vector]] = deque()

    def add(self, time_s: float, position_um: Vector) -> None:
        """Remember a position [µm]; times [s] never decrease."""
        self._kept.append((time_s, position_um))
        while self._kept[0][0] < time_s - KEPT_S:
            self._kept.popleft()

    def at(self, time_s: float) -> Vector:
        """Return the position [µm] at a time [s], interpolated between those that are kept.

        Before the earliest and after the latest it is that one.
        """
        kept = list(self._kept)
        after = bisect_right(kept, time_s, key=lambda entry: entry[0])
        if after == 0:
            return kept[0][1]
        begin_s, begin_um = kept[after - 1]
        if after == len(kept):
            return begin_um
        end_s, end_um = kept[after]
        share = (time_s - begin_s) / (end_s - begin_s)
        interpolated_um: Vector = begin_um + share * (end_um - begin_um)
        return interpolated_um
