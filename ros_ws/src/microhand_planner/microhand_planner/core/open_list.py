# SPDX-License-Identifier: Apache-2.0
"""What waits in a search: least total first, then least estimate of what is left, then youngest.

Few totals wait at the same time, and few estimates exist, since both are made of whole steps and
whole reconfigurations. So numbers wait in buckets, one for each pair of them: a row of buckets for
a total, the totals in a sorted list. A bucket is a chain through the numbers themselves, which
each of them can leave.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
import numpy.typing as npt

from microhand_planner.core.key_table import NOBODY
from microhand_planner.core.rotation_lattice import IntArray

Int32Array = npt.NDArray[np.int32]

_FIRST, _END, _SPARE = 0, 1, 2  # in `counts`
_BUCKET, _YOUNGER, _OLDER = 0, 1, 2  # in `links`
_WORD = 64


class OpenList(NamedTuple):
    """Rows of buckets.

    Parameters
    ----------
    links : (n, 3) int
        For each number its bucket or `NOBODY`, and its neighbours in the chain.
    total : (r,) int
        Totals in ascending order, from ``counts[0]`` to before ``counts[1]`` [1e-9 deg].
    row : (2, r) int
        The row of buckets of each; below, ``counts[2]`` rows that no total has.
    counts : (3,) int
        See there.
    youngest : (r, k) int
        The number that came last to the bucket of a total and a rank, if that is not empty.
    filled : (r, w) int
        A bit for each bucket of a row, set if it is not empty.
    """

    links: Int32Array
    total: IntArray
    row: Int32Array
    counts: IntArray
    youngest: Int32Array
    filled: IntArray


def open_list(room: int, ranks: int, rows: int) -> OpenList:
    """Return an empty list for so many numbers, ranks of estimates, and totals at a time."""
    row = np.zeros((2, rows), dtype=np.int32)
    row[1] = np.arange(rows)
    return OpenList(
        np.full((room, 3), NOBODY, dtype=np.int32),
        np.zeros(rows, dtype=np.int64),
        row,
        np.array([0, 0, rows], dtype=np.int64),
        np.zeros((rows, ranks), dtype=np.int32),
        np.zeros((rows, -(-ranks // _WORD)), dtype=np.int64),
    )


def with_places(waiting: OpenList, room: int) -> OpenList:
    """Return the same list with room for more numbers."""
    links = np.full((room, 3), NOBODY, dtype=np.int32)
    links[: len(waiting.links)] = waiting.links
    return waiting._replace(links=links)


def with_rows(waiting: OpenList, more: int) -> OpenList:
    """Return the same list with room for so many more totals."""
    first, end, spare = waiting.counts.tolist()
    rows, ranks = waiting.youngest.shape
    grown = open_list(0, ranks, 2 * (rows + more))
    added = len(grown.total) - rows
    grown.total[: end - first] = waiting.total[first:end]
    grown.row[0, : end - first] = waiting.row[0, first:end]
    grown.row[1, :spare] = waiting.row[1, :spare]
    grown.row[1, spare : spare + added] = np.arange(rows, rows + added)
    grown.counts[:] = 0, end - first, spare + added
    grown.youngest[:rows] = waiting.youngest
    grown.filled[:rows] = waiting.filled
    return grown._replace(links=waiting.links)


@nb.njit(cache=True, _nrt=False)
def spare_rows(waiting: OpenList) -> int:  # pragma: no cover - compiled
    """Return for how many more totals there is room."""
    return waiting.counts[_SPARE]


@nb.njit(cache=True, _nrt=False)
def least_total(waiting: OpenList) -> int:  # pragma: no cover - compiled
    """Return the least total that waits, or `NOBODY`."""
    counts = waiting.counts
    while counts[_FIRST] < counts[_END]:
        row = waiting.row[0, counts[_FIRST]]
        for word in range(waiting.filled.shape[1]):
            if waiting.filled[row, word] != 0:
                return waiting.total[counts[_FIRST]]
        waiting.row[1, counts[_SPARE]] = row
        counts[_SPARE] += 1
        counts[_FIRST] += 1
    return NOBODY


@nb.njit(cache=True, _nrt=False)
def take(waiting: OpenList) -> int:  # pragma: no cover - compiled
    """Take out the number whose turn it is; `least_total` has found that there is one."""
    row = waiting.row[0, waiting.counts[_FIRST]]
    word = 0
    while waiting.filled[row, word] == 0:
        word += 1
    number = waiting.youngest[row, word * _WORD + lowest_bit(waiting.filled[row, word])]
    leave(waiting, number)
    return number


@nb.njit(cache=True, _nrt=False)
def wait(
    waiting: OpenList, number: int, total_ndeg: int, rank: int
) -> None:  # pragma: no cover - compiled
    """Let a number that waits nowhere wait at a total, and at the rank of its estimate."""
    row = _row_of(waiting, total_ndeg)
    bit = 1 << (rank % _WORD)
    older = NOBODY
    if waiting.filled[row, rank // _WORD] & bit != 0:
        older = waiting.youngest[row, rank]
    waiting.links[number, _BUCKET] = row * waiting.youngest.shape[1] + rank
    waiting.links[number, _OLDER] = older
    waiting.links[number, _YOUNGER] = NOBODY
    if older != NOBODY:
        waiting.links[older, _YOUNGER] = number
    waiting.youngest[row, rank] = number
    waiting.filled[row, rank // _WORD] |= bit


@nb.njit(cache=True, _nrt=False)
def leave(waiting: OpenList, number: int) -> None:  # pragma: no cover - compiled
    """Let a number wait no longer, if it does."""
    bucket = waiting.links[number, _BUCKET]
    if bucket == NOBODY:
        return
    older = waiting.links[number, _OLDER]
    younger = waiting.links[number, _YOUNGER]
    if older != NOBODY:
        waiting.links[older, _YOUNGER] = younger
    if younger != NOBODY:
        waiting.links[younger, _OLDER] = older
    else:
        ranks = waiting.youngest.shape[1]
        row = bucket // ranks
        rank = bucket % ranks
        if older != NOBODY:
            waiting.youngest[row, rank] = older
        else:
            waiting.filled[row, rank // _WORD] &= ~(1 << (rank % _WORD))
    waiting.links[number, _BUCKET] = NOBODY


@nb.njit(cache=True, _nrt=False)
def lowest_bit(word: int) -> int:  # pragma: no cover - compiled
    """Return the place of the lowest bit that is set in a word of 64."""
    place = 0
    for width in (32, 16, 8, 4, 2, 1):
        if word & ((1 << width) - 1) == 0:
            word >>= width
            place += width
    return place


@nb.njit(cache=True, _nrt=False)
def _row_of(waiting: OpenList, total_ndeg: int) -> int:  # pragma: no cover - compiled
    """Return the row of buckets of a total; a new one, if it has none."""
    total, row, counts = waiting.total, waiting.row, waiting.counts
    low, high = counts[_FIRST], counts[_END]
    if low < high and total[low] == total_ndeg:  # most follow one of their own total
        return row[0, low]
    while low < high:
        middle = (low + high) // 2
        if total[middle] < total_ndeg:
            low = middle + 1
        else:
            high = middle
    if low < counts[_END] and total[low] == total_ndeg:
        return row[0, low]
    if counts[_END] == len(total):  # at the end of the room: move all to its beginning
        first = counts[_FIRST]
        for place in range(first, counts[_END]):
            total[place - first] = total[place]
            row[0, place - first] = row[0, place]
        low -= first
        counts[_FIRST] = 0
        counts[_END] -= first
    for place in range(counts[_END], low, -1):
        total[place] = total[place - 1]
        row[0, place] = row[0, place - 1]
    counts[_END] += 1
    counts[_SPARE] -= 1
    total[low] = total_ndeg
    row[0, low] = row[1, counts[_SPARE]]
    return row[0, low]
