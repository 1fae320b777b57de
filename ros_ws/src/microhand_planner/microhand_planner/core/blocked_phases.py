# SPDX-License-Identifier: Apache-2.0
"""Intervals of phase in which a tip must not stand, from a test of single phases."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SAMPLE_RAD = 0.02
"""Distance of the phases looked at: 0.09 µm of path for the paper's tip."""
HALVINGS = 16


def blocked_intervals(
    is_blocked: Callable[[FloatArray], BoolArray], length_rad: float
) -> FloatArray:
    """Find the intervals of phase in which a predicate holds.

    Parameters
    ----------
    is_blocked : callable
        Phases (k,) in [0, length) to verdicts (k,).
    length_rad : float
        One turn in phase [rad].

    Returns
    -------
    (b, 2) array
        Ascending, within [0, length]; an interval over phase 0 is given as two. Ends are found
        to 1 µrad, on the blocked side by at most that much too far. An interval shorter than
        0.02 rad may be missed.
    """
    count = max(8, int(np.ceil(length_rad / SAMPLE_RAD)))
    phase = np.arange(count, dtype=np.float64) * (length_rad / count)
    blocked = is_blocked(phase)
    if not blocked.any():
        return np.zeros((0, 2))
    change = np.flatnonzero(blocked != np.roll(blocked, -1))
    low, high = phase[change], phase[change] + length_rad / count
    low_blocked = blocked[change]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        moves_low = is_blocked(np.mod(middle, length_rad)) == low_blocked
        low, high = np.where(moves_low, middle, low), np.where(moves_low, high, middle)
    ends, starts = high[low_blocked], low[~low_blocked]
    if blocked[0]:  # the interval over phase 0, in two
        starts, ends = np.append(0.0, starts), np.append(ends, length_rad)
    return np.column_stack([starts, ends])
