# SPDX-License-Identifier: Apache-2.0
"""How far a grasp must roll before a swap can bring it nearer to its goal.

[Kumar2021] Eq. 13 counts the placements and removals that are left as if each were possible at
once. Often none is: then the grasp must first roll out of its way, to where one is, or a swap must
be made that brings it no nearer. The cheaper of the two is added to the estimate.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
import numpy.typing as npt

from microhand_planner.core.pose import FloatArray
from microhand_planner.core.removal_verdicts import CHUNK, RemovalLaw, chunk_verdicts, gather
from microhand_planner.core.rotation_lattice import BoolArray, IntArray
from microhand_planner.core.search_state import RECONFIGURATION_NDEG

UNSEEN, NOWHERE, SEEN = 0, -1, 1
"""What `States.nearest` holds: nothing as yet, nowhere, or an orientation plus `SEEN`."""
SWAP_NDEG = 2 * RECONFIGURATION_NDEG


class Outlook(NamedTuple):
    """Room for looking at one grasp.

    Parameters
    ----------
    near : (m,) bool
        Whether a swap brings the grasp nearer at an orientation.
    stands : (m,) bool
        Whether both fingers may stand there.
    chunk, may : (18 * 64,) float, (64,) bool
        See `chunk_verdicts`.
    """

    near: BoolArray
    stands: BoolArray
    chunk: FloatArray
    may: BoolArray


def no_outlook(orientations: int) -> Outlook:
    """Return the room for so many orientations."""
    return Outlook(
        np.zeros(orientations, dtype=np.bool_),
        np.zeros(orientations, dtype=np.bool_),
        np.zeros(18 * CHUNK),
        np.zeros(CHUNK, dtype=np.bool_),
    )


@nb.njit(cache=True, error_model='numpy', _nrt=False)
def look(
    room: Outlook,
    columns: FloatArray,
    place_of: IntArray,
    law: RemovalLaw,
    reverse: bool,
    one: int,
    other: int,
    one_may: bool,
    other_may: bool,
    targets: tuple[int, int],
    theta_ndeg: IntArray,
    end: int,
    nearest: npt.NDArray[np.int16],
) -> None:  # pragma: no cover - compiled
    """Find for each orientation the nearest one where a swap brings a grasp nearer to its goal.

    Parameters
    ----------
    room : Outlook
        To work in.
    columns, place_of, law, reverse
        See `swap_verdicts`; `place_of`, (n, m): the place of a track at an orientation.
    one, other : int
        Tracks of the grasp.
    one_may, other_may : bool
        Whether it brings the grasp nearer if this finger leaves for one on a target.
    targets : (int, int)
        Tracks of the goal where the free finger may be placed, or -1.
    theta_ndeg, end : (m,) int, int
        Orientations [1e-9 deg], and which of them is the goal's.
    nearest : (m,) int
        Takes the orientations plus `SEEN`, by way of which the goal's is nearest; or `NOWHERE`.
    """
    orientations = len(theta_ndeg)
    least = law.least_um * law.least_um
    for begin in range(0, orientations, CHUNK):
        count = min(CHUNK, orientations - begin)
        gather(columns, place_of[one, begin : begin + count], 0, room.chunk)
        gather(columns, place_of[other, begin : begin + count], 1, room.chunk)
        for step in range(count):
            x = room.chunk[4 * CHUNK + step] - room.chunk[10 * CHUNK + step]
            y = room.chunk[5 * CHUNK + step] - room.chunk[11 * CHUNK + step]
            room.stands[begin + step] = x * x + y * y >= least
            room.near[begin + step] = False
        for target in targets:
            if target < 0 or target == one or target == other:
                continue
            gather(columns, place_of[target, begin : begin + count], 2, room.chunk)
            for leaves in range(2):
                if one_may if leaves == 0 else other_may:
                    chunk_verdicts(room.chunk, count, 1 - leaves, leaves, reverse, law, room.may)
                    for step in range(count):
                        room.near[begin + step] |= room.may[step]
    # no roll leads over an orientation where the fingers cannot stand
    last = NOWHERE
    for at in range(orientations):
        if not room.stands[at]:
            last = NOWHERE
        elif room.near[at]:
            last = at + SEEN
        nearest[at] = last
    last = NOWHERE
    for at in range(orientations - 1, -1, -1):
        if not room.stands[at]:
            last = NOWHERE
        elif room.near[at]:
            last = at + SEEN
        if last != NOWHERE and (
            nearest[at] == NOWHERE
            or detour_ndeg(theta_ndeg, at, last - SEEN, end)
            < detour_ndeg(theta_ndeg, at, nearest[at] - SEEN, end)
        ):
            nearest[at] = last


@nb.njit(cache=True, _nrt=False)
def detour_ndeg(
    theta_ndeg: IntArray, at: int, by: int, end: int
) -> int:  # pragma: no cover - compiled
    """Return what it costs more to roll to the goal's orientation by way of another one."""
    here, there, goal = theta_ndeg[at], theta_ndeg[by], theta_ndeg[end]
    return 2 * (abs(here - there) + abs(there - goal) - abs(here - goal))
