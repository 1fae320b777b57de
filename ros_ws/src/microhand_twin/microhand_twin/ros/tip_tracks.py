# SPDX-License-Identifier: Apache-2.0
"""Positions of the tips as their stages report them → where all three were at one moment."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import FloatArray

STANDSTILL_S = 1.0
"""A finger that is silent for so much longer than the others is taken to stand still [s].

By then the sequencer has noticed the silence, and named it before its consequences."""


class TipTracks:
    """What was reported, as long as it matters.

    Examples
    --------
    >>> tracks = TipTracks()
    >>> for finger in range(3):
    ...     tracks.add(finger, 0.0, np.zeros(3))
    ...     tracks.add(finger, 0.01 + 0.001 * finger, np.ones(3))
    >>> tracks.until_s, tracks.at(0.005)[:, 0].round(2).tolist()
    (0.01, [0.5, 0.45, 0.42])
    """

    def __init__(self) -> None:
        self._times_s: list[list[float]] = [[] for _ in range(FINGERS)]
        self._tips_um: list[list[FloatArray]] = [[] for _ in range(FINGERS)]

    def add(self, finger: int, time_s: float, tip_um: FloatArray) -> None:
        """Add a report of finger 0, 1 or 2; one that is older than the last is ignored."""
        times = self._times_s[finger]
        if not times or time_s > times[-1]:
            times.append(time_s)
            self._tips_um[finger].append(tip_um)

    @property
    def silent(self) -> list[int]:
        """Fingers, from 1, of which nothing has been heard."""
        return [finger for finger, times in enumerate(self._times_s, start=1) if not times]

    @property
    def until_s(self) -> float | None:
        """Time up to which the way of all tips is known [s]; None: one has not reported yet."""
        if self.silent:
            return None
        latest_s = [times[-1] for times in self._times_s]
        alive = [time_s for time_s in latest_s if time_s > max(latest_s) - STANDSTILL_S]
        return min(alive)

    def at(self, time_s: float) -> FloatArray:
        """Return the tips (3, 3) at a time, interpolated; beyond the reports they stand."""
        tips = np.zeros((FINGERS, 3))
        for finger in range(FINGERS):
            times, known = self._times_s[finger], self._tips_um[finger]
            after = bisect_right(times, time_s)
            if after in (0, len(times)):
                tips[finger] = known[min(after, len(times) - 1)]
            else:
                begin_s, end_s = times[after - 1], times[after]
                share = (time_s - begin_s) / (end_s - begin_s)
                tips[finger] = known[after - 1] + share * (known[after] - known[after - 1])
        return tips

    def forget_before(self, time_s: float) -> None:
        """Drop what no moment from `time_s` on needs."""
        for times, known in zip(self._times_s, self._tips_um, strict=True):
            needless = max(bisect_right(times, time_s) - 1, 0)
            del times[:needless], known[:needless]
