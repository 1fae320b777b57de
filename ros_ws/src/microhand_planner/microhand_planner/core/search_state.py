# SPDX-License-Identifier: Apache-2.0
"""The states of the planar searches, and what they still cost at least.

A state is a grasp and an orientation, the paper's ``[i j k l]`` with tracks for contacts:
``grasp[f]`` is the track of finger f + 1, or `ABSENT`. Costs are integers in nanodegrees.

Fingers are alike. Where it does not matter which of them ends where, grasps that differ only in
the names of their fingers are one state (`sorted_grasp`), and there are six times fewer.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numba as nb
import numpy as np

from microhand_planner.core.rotation_lattice import IntArray

Grasp = tuple[int, int, int]

ABSENT = -1
ANY_GRASP: Grasp = (ABSENT, ABSENT, ABSENT)
NDEG = 1_000_000_000
RECONFIGURATION_NDEG = 180 * NDEG
"""Cost of a placement or a removal, [Kumar2021] Eq. 12."""

# [Kumar2021] Table 1, rebuilt from its §4.3: least number of placements and removals.
# Row: fingers used in one of the two grasps only (ar); column: fingers on their goal track (dp).
_RECONFIGURATIONS_LEFT = np.array([[6, 4, 0], [5, 3, 1], [4, 2, 2]])
# The same when any finger may end on any goal track: the least over the six goals.
# Row: three fingers placed or two; column: fingers on a goal track.
_RECONFIGURATIONS_LEFT_OF_ANY = np.array([[4, 2, 0], [5, 3, 1]])
_MOST_LEFT = 6


class Packing(NamedTuple):
    """Bits of the fields of a packed state: three tracks above an orientation.

    Parameters
    ----------
    track, orientation : int
        Widths.
    """

    track: int
    orientation: int


def packing(tracks: int, orientations: int) -> Packing:
    """Return the packing for so many tracks, and none, and so many orientations."""
    return Packing(tracks.bit_length(), (orientations - 1).bit_length())


@nb.njit(cache=True, _nrt=False)
def pack_grasp(grasp: Grasp, bits: Packing) -> int:  # pragma: no cover - compiled
    """Return a grasp as one integer."""
    code = (grasp[0] + 1) << bits.track | (grasp[1] + 1)
    return code << bits.track | (grasp[2] + 1)


@nb.njit(cache=True, _nrt=False)
def unpack_grasp(code: int, bits: Packing) -> Grasp:  # pragma: no cover - compiled
    """Return a packed grasp."""
    tracks = (1 << bits.track) - 1
    return (code >> 2 * bits.track) - 1, (code >> bits.track & tracks) - 1, (code & tracks) - 1


def unpack_all(keys: IntArray, bits: Packing) -> IntArray:
    """Return packed states as rows of three tracks and an orientation, (k, 4) int, read-only."""
    tracks = (1 << bits.track) - 1
    code = keys >> bits.orientation
    columns = (
        (code >> 2 * bits.track) - 1,
        (code >> bits.track & tracks) - 1,
        (code & tracks) - 1,
        keys & ((1 << bits.orientation) - 1),
    )
    states = np.stack(columns, axis=1)
    states.setflags(write=False)
    return states


def named_fingers(states: IntArray) -> IntArray:
    """Return a path of sorted grasps with a column per finger, each finger keeping its track.

    Parameters
    ----------
    states : (k, 4) int
        Sorted grasps and orientations.

    Returns
    -------
    (k, 4) int
        The same path; fingers 1 and 2 hold the first grasp, and a free finger is placed wherever
        a track is new.
    """
    rows = states.tolist()
    for before, now in itertools.pairwise(rows):
        tracks = set(now[:3]) - {ABSENT}
        held = [track if track in tracks else ABSENT for track in before[:3]]
        new = sorted(tracks.difference(held))
        for finger in range(3):
            if before[finger] == ABSENT and new:
                held[finger] = new.pop(0)
        now[:3] = held
    named = np.array(rows, dtype=np.int64)
    named.setflags(write=False)
    return named


@nb.njit(cache=True, inline='always')
def with_finger(grasp: Grasp, finger: int, track: int) -> Grasp:  # pragma: no cover - compiled
    """Return the grasp with one finger's track replaced."""
    if finger == 0:
        return (track, grasp[1], grasp[2])
    if finger == 1:
        return (grasp[0], track, grasp[2])
    return (grasp[0], grasp[1], track)


@nb.njit(cache=True, inline='always')
def is_any(goal: Grasp) -> bool:  # pragma: no cover - compiled
    """Return whether every grasp is a goal."""
    return goal[0] < 0 and goal[1] < 0 and goal[2] < 0


@nb.njit(cache=True, inline='always')
def sorted_grasp(grasp: Grasp) -> Grasp:  # pragma: no cover - compiled
    """Return the grasp with its tracks in falling order, absent fingers last."""
    a, b, c = grasp
    if a < b:
        a, b = b, a
    if b < c:
        b, c = c, b
    if a < b:
        a, b = b, a
    return (a, b, c)


@nb.njit(cache=True, _nrt=False)
def reconfigurations_left(
    grasp: Grasp, goal: Grasp, interchangeable: bool
) -> int:  # pragma: no cover - compiled
    """Return the least number of placements and removals to the goal ([Kumar2021] Table 1).

    A finger is on its goal's track (dp, Eq. 14-16), on another (ip), used in one of the two
    grasps only (ar), or in neither (nu). To `ANY_GRASP` a third finger must be removed.
    """
    on_goal_track = 0
    in_one_only = 0
    placed = 0
    for finger in range(3):
        track = grasp[finger]
        placed += track >= 0
        if interchangeable:
            on_goal_track += track >= 0 and (track == goal[0] or track == goal[1])
        elif (track < 0) != (goal[finger] < 0):
            in_one_only += 1
        elif track >= 0 and track == goal[finger]:
            on_goal_track += 1
    if is_any(goal):
        return placed - 2
    if interchangeable:
        return _RECONFIGURATIONS_LEFT_OF_ANY[placed - 2, on_goal_track]
    return _RECONFIGURATIONS_LEFT[in_one_only, on_goal_track]


def estimate_ranks(theta_ndeg: IntArray, end: int) -> tuple[IntArray, int]:
    """Give a rank to every value that the heuristic can have, the least first.

    Parameters
    ----------
    theta_ndeg : (m,) int
        Orientations [1e-9 deg].
    end : int
        Index of the goal's.

    Returns
    -------
    ranks : (m, 7) int
        For an orientation, and 0 to 6 placements and removals that are left.
    count : int
        Number of different values.
    """
    rolling = 2 * np.abs(theta_ndeg - theta_ndeg[end])
    estimates = rolling[:, None] + RECONFIGURATION_NDEG * np.arange(_MOST_LEFT + 1)
    order = np.argsort(estimates, axis=None, kind='stable')
    rises = np.diff(estimates.ravel()[order], prepend=-1) > 0
    ranks = np.zeros(estimates.shape, dtype=np.int64)
    ranks.ravel()[order] = np.cumsum(rises) - 1
    return ranks, int(rises.sum())
