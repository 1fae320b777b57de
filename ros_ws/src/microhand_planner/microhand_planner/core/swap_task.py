# SPDX-License-Identifier: Apache-2.0
"""What a search over swaps is asked, and how far a grasp is from it ([Kumar2021] Eq. 13)."""

from __future__ import annotations

from typing import NamedTuple

import numba as nb

from microhand_planner.core.pose import FloatArray
from microhand_planner.core.removal_verdicts import RemovalLaw
from microhand_planner.core.rotation_lattice import IntArray
from microhand_planner.core.search_field import SearchField
from microhand_planner.core.search_state import ABSENT, Grasp, Packing


class Task(NamedTuple):
    """What is asked, in the search's direction."""

    field: SearchField
    columns: FloatArray
    place_of: IntArray
    law: RemovalLaw
    contacts: int
    bits: Packing
    goal: Grasp
    end: int
    interchangeable: bool
    reverse: bool
    bound_ndeg: int
    start_ndeg: int
    left_of: IntArray
    ranks: IntArray


@nb.njit(cache=True, inline='always')
def free_finger(grasp: Grasp) -> int:  # pragma: no cover - compiled
    """Return the finger that is not placed."""
    if grasp[0] < 0:
        return 0
    return 1 if grasp[1] < 0 else 2


@nb.njit(cache=True, inline='always')
def goal_tracks(task: Task, finger: int) -> Grasp:  # pragma: no cover - compiled
    """Return the tracks on which a finger is at the goal, or `ABSENT`."""
    if task.interchangeable:
        return task.goal[0], task.goal[1], ABSENT
    return task.goal[finger], ABSENT, ABSENT


@nb.njit(cache=True, inline='always')
def on_goal_track(task: Task, grasp: Grasp, finger: int) -> int:  # pragma: no cover - compiled
    """Return 1 if a finger is on a track of the goal, else 0."""
    track = grasp[finger]
    if task.interchangeable:
        return int(track == task.goal[0] or track == task.goal[1])
    return int(track == task.goal[finger])


@nb.njit(cache=True, inline='always')
def left_of(task: Task, grasp: Grasp) -> int:  # pragma: no cover - compiled
    """Return the placements and removals that are left ([Kumar2021] Table 1)."""
    free = free_finger(grasp)
    first = on_goal_track(task, grasp, (free + 1) % 3)
    second = on_goal_track(task, grasp, (free + 2) % 3)
    return task.left_of[free, first, second]


@nb.njit(cache=True, inline='always')
def left_after(
    task: Task, free: int, leaves: int, stays_on: int, placed_on: int
) -> int:  # pragma: no cover - compiled
    """Return what is left after a swap."""
    if task.interchangeable:  # grasps are sorted, the third finger is free
        return task.left_of[2, stays_on, placed_on]
    if leaves == (free + 1) % 3:
        return task.left_of[leaves, stays_on, placed_on]
    return task.left_of[leaves, placed_on, stays_on]
