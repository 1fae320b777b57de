# SPDX-License-Identifier: Apache-2.0
"""The grasps from which a rotation may begin when none is given, the firmest first.

There are too many pairs of tracks to list them all, and nearly always one of the first will do. So
they come in blocks, each chosen in one pass over all pairs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numba as nb
import numpy as np

from microhand_planner.core.rotation_lattice import IntArray
from microhand_planner.core.search_field import SearchField, clear_of
from microhand_planner.core.search_state import ABSENT, Grasp

_FIRST_BLOCK, _LARGEST_BLOCK = 256, 1 << 18
_TRACK_BITS = 17
_SHARES = 1e8  # of firmness that are told apart


def starting_grasps(field: SearchField, orientation: int, interrupt: IntArray) -> Iterator[Grasp]:
    """Yield all grasps of fingers 1 and 2 at an orientation.

    Firm is a grasp whose line of contact lies close to both normals: it needs the least friction.
    Fingers are interchangeable, so finger 1 takes the track with the smaller number. Equally firm
    grasps come by the numbers of their tracks.

    Parameters
    ----------
    field : SearchField
        The planar problem.
    orientation : int
        Index of the orientation.
    interrupt : (2,) int64
        See `interruption`.
    """
    tracks = (1 << _TRACK_BITS) - 1
    block = np.zeros(0, dtype=np.int64)
    while True:
        block = next_block(field, orientation, block, interrupt)
        if len(block) == 0:
            return
        for number in block.tolist():
            yield number >> _TRACK_BITS & tracks, number & tracks, ABSENT


@nb.njit(cache=True, nogil=True)
def next_block(
    field: SearchField, orientation: int, before: IntArray, interrupt: IntArray
) -> IntArray:  # pragma: no cover - compiled
    """Return the numbers of the next grasps in ascending order: looseness, then both tracks."""
    most = _FIRST_BLOCK if len(before) == 0 else min(8 * len(before), _LARGEST_BLOCK)
    above = -1 if len(before) == 0 else before[-1]
    below = np.iinfo(np.int64).max
    samples = field.sample_of[:, orientation]
    block = np.zeros(2 * most, np.int64)
    found = 0
    for first in range(len(samples)):
        one = samples[first]
        if interrupt[0] != 0:
            break
        if not field.usable[one]:
            continue
        for second in range(first + 1, len(samples)):
            other = samples[second]
            if not (field.usable[other] and clear_of(field, one, other)):
                continue
            number = (_looseness(field, one, other) << _TRACK_BITS | first) << _TRACK_BITS | second
            if above < number < below:
                block[found] = number
                found += 1
                if found == 2 * most:  # keep the firmer half
                    block.sort()
                    found = most
                    below = block[most - 1]
    firmest = block[:found]
    firmest.sort()
    return firmest[:most]


@nb.njit(cache=True)
def _looseness(field: SearchField, one: int, other: int) -> int:  # pragma: no cover - compiled
    """Return a whole number, the larger, the more a grasp needs friction."""
    line_x = field.contact_um[other, 0] - field.contact_um[one, 0]
    line_y = field.contact_um[other, 1] - field.contact_um[one, 1]
    length = max(math.sqrt(line_x * line_x + line_y * line_y), 1e-12)
    from_one = -(line_x * field.normal[one, 0] + line_y * field.normal[one, 1])
    from_other = line_x * field.normal[other, 0] + line_y * field.normal[other, 1]
    return round((1.0 - min(from_one, from_other) / length) * _SHARES)
