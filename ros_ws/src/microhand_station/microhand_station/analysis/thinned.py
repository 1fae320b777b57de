# SPDX-License-Identifier: Apache-2.0
"""Many samples → the few that a screen can show, extremes included."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def thinned(values: FloatArray, parts: int) -> NDArray[np.int64]:
    """Return the rows to keep, in order: of each part the first, and where a column is extreme.

    Parameters
    ----------
    values : (n, k) array
        Columns over time; NaN: nothing there, which is kept as well.
    parts : int
        So many parts of equal size, at least 1; up to ``parts * (2 k + 1)`` rows are kept.

    Examples
    --------
    >>> wave = np.array([[0.0], [1.0], [5.0], [2.0], [1.0], [0.0], [-3.0], [0.5]])
    >>> thinned(wave, 2).tolist()
    [0, 2, 4, 6, 7]
    """
    count, columns = values.shape
    if count <= parts * (2 * columns + 1):
        return np.arange(count)
    edges = np.linspace(0, count, parts + 1).astype(int)
    keep = {0, count - 1, *edges[:-1].tolist()}
    for begin, end in itertools.pairwise(edges.tolist()):
        part = values[begin:end]
        low = np.where(np.isnan(part), np.inf, part)
        high = np.where(np.isnan(part), -np.inf, part)
        keep.update((begin + np.argmin(low, axis=0)).tolist())
        keep.update((begin + np.argmax(high, axis=0)).tolist())
    # a gap begins and ends where it did
    gaps = np.flatnonzero(np.any(np.diff(np.isnan(values), axis=0), axis=1))
    keep.update(gaps.tolist())
    keep.update((gaps + 1).tolist())
    return np.array(sorted(keep), dtype=np.int64)
