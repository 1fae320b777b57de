# SPDX-License-Identifier: Apache-2.0
"""The cheapest way to turn the object in the plane, under adhesion: an exact search over swaps.

With adhesion a grasp of three is stable exactly when its pairs are, so 'place k, roll on three,
remove i' is never better than 'roll on two, place k, remove i'. What is left of the graph of
[Kumar2021] §3.3 are grasps of two fingers, rolls, and *swaps* (place the free finger, remove one
of the others; cost 360 deg). On them runs A* with the heuristic of [Kumar2021] Eq. 13, in integer
costs; ties are broken by the smaller heuristic ([Kumar2021] §4), then by the younger state.

A state has some hundred swaps, nearly all of them dear. Their estimates exceed the state's own by
0, 360 or 720 deg; so a state is expanded in up to three stages, one for each, and waits in the
queue in between at the estimate of what it has left to offer.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numba as nb
import numpy as np

from microhand_planner.core.parameters import ContactLaw, Finger, GripRules
from microhand_planner.core.rotation_lattice import IntArray, RotationLattice
from microhand_planner.core.search_field import SearchField, clear_of, lets_go, rolls, search_field
from microhand_planner.core.search_result import NO_BOUND, Outcome, SearchResult
from microhand_planner.core.search_state import (
    ABSENT,
    RECONFIGURATION_NDEG,
    Grasp,
    goal_tracks,
    is_any,
    named_fingers,
    pack,
    paper_estimate_ndeg,
    sorted_grasp,
    trace_back,
    unpack,
    unpack_all,
    with_finger,
)

_SWAP_NDEG = 2 * RECONFIGURATION_NDEG
_LAST_STAGE = 2


def swap_search(
    lattice: RotationLattice,
    finger: Finger,
    law: ContactLaw,
    starts: Sequence[Grasp] | IntArray,
    goal: Grasp,
    *,
    interchangeable: bool = True,
    reverse: bool = False,
    bound_ndeg: int = NO_BOUND,
    interrupt: IntArray | None = None,
    rules: GripRules | None = None,
) -> SearchResult:
    """Find the cheapest sequence of rolls and swaps from one grasp to another.

    Parameters
    ----------
    lattice : RotationLattice
        The planar problem.
    finger, law : Finger, ContactLaw
        Tips, and contacts with adhesion.
    starts : (k, 3) int
        Grasps to start from, of two fingers each; where several are as good, an earlier one is
        preferred. More than one only with the goal `ANY_GRASP`.
    goal : tuple of 3 int
        Grasp of two fingers, or `ANY_GRASP`. The orientations are those of the lattice.
    interchangeable : bool
        True: any finger may end on any track of the goal, and the path is that of the cheapest of
        its six permutations; fingers are then named along the path. False: as given.
    reverse : bool
        True: search backward in time, from the lattice's goal orientation and the grasps `starts`
        to its start orientation and the grasp `goal`. The path is returned in forward order.
    bound_ndeg : int
        Stop as soon as no path costs less than this [1e-9 deg].
    interrupt : (1,) int64, optional
        Looked at before every expansion; another thread ends the search by writing an `Outcome`.
    rules : GripRules, optional
        Margins that removals and rolls keep; by default [Kumar2021] Eq. 4 alone.

    Returns
    -------
    SearchResult
    """
    begin, end = (lattice.goal, lattice.start) if reverse else (lattice.start, lattice.goal)
    outcome, cost, keys, expanded = _search(
        search_field(lattice, finger, law, rules),
        np.asarray(starts, dtype=np.int64).reshape(-1, 3),
        begin,
        sorted_grasp(goal) if interchangeable else goal,
        end,
        interchangeable,
        reverse,
        bound_ndeg,
        np.zeros(1, dtype=np.int64) if interrupt is None else interrupt,
    )
    states = unpack_all(keys, len(lattice.track_unit), len(lattice.theta_rad))
    if reverse:
        states = states[::-1]
    if interchangeable and len(states) > 0:
        states = named_fingers(states)
    return SearchResult(Outcome(outcome), cost, states, expanded)


@nb.njit(cache=True, inline='always')
def _free_finger(grasp: Grasp) -> int:  # pragma: no cover - compiled
    if grasp[0] < 0:
        return 0
    return 1 if grasp[1] < 0 else 2


@nb.njit(cache=True)
def _holds(
    field: SearchField, grasp: Grasp, orientation: int
) -> bool:  # pragma: no cover - compiled
    """Return whether two fingers may stand so at an orientation."""
    free = _free_finger(grasp)
    one = field.sample_of[grasp[(free + 1) % 3], orientation]
    two = field.sample_of[grasp[(free + 2) % 3], orientation]
    return field.usable[one] and field.usable[two] and clear_of(field, one, two)


@nb.njit(cache=True, nogil=True)
def _search(
    field: SearchField,
    starts: IntArray,
    begin: int,
    goal: Grasp,
    end: int,
    interchangeable: bool,
    reverse: bool,
    bound_ndeg: int,
    interrupt: IntArray,
) -> tuple[int, int, IntArray, int]:  # pragma: no cover - compiled
    """Run A*; see `swap_search`. Returns outcome, cost, packed states of the path, expansions."""
    tracks, orientations = field.sample_of.shape
    nothing = np.zeros(0, dtype=np.int64)
    if len(starts) == 0 or not (is_any(goal) or _holds(field, goal, end)):
        return 1, -1, nothing, 0
    first_start = (starts[0, 0], starts[0, 1], starts[0, 2])
    start_total = paper_estimate_ndeg(
        first_start, goal, field.theta_ndeg[begin], field.theta_ndeg[end], interchangeable
    )
    cost_of = {pack(first_start, begin, tracks, orientations): 0}
    parent_of = {pack(first_start, begin, tracks, orientations): 0}
    cost_of.clear()
    parent_of.clear()
    queue = [(0, 0, 0, 0, 0)]
    queue.clear()
    age = 0
    expanded = 0
    next_start = 0
    while True:
        # starts join only when nothing better waits: most searches end in the first of them
        while next_start < len(starts) and (len(queue) == 0 or queue[0][0] > start_total):
            grasp = (starts[next_start, 0], starts[next_start, 1], starts[next_start, 2])
            next_start += 1
            if interchangeable:
                grasp = sorted_grasp(grasp)
            if _holds(field, grasp, begin):
                key = pack(grasp, begin, tracks, orientations)
                cost_of[key] = 0
                parent_of[key] = key
                age -= 1
                heapq.heappush(queue, (start_total, start_total, age, key, 0))
        if len(queue) == 0:
            return 1, -1, nothing, expanded
        if interrupt[0] != 0:
            return interrupt[0], -1, nothing, expanded
        total, estimate, _, key, stage = heapq.heappop(queue)
        if total >= bound_ndeg:
            return 2, -1, nothing, expanded
        cost = cost_of[key]
        if total - estimate != cost + stage * _SWAP_NDEG:
            continue  # a cheaper way to this state has been found since
        grasp, orientation = unpack(key, tracks, orientations)
        if orientation == end and (is_any(goal) or grasp == goal):
            return 0, cost, trace_back(key, parent_of), expanded
        free = _free_finger(grasp)
        first = (free + 1) % 3
        second = (free + 2) % 3

        if stage == 0:
            expanded += 1
            for arrive in (orientation - 1, orientation + 1):
                if arrive < 0 or arrive >= orientations:
                    continue
                lower = min(orientation, arrive)
                if not rolls(field, grasp[first], grasp[second], lower, arrive):
                    continue
                turn = abs(field.theta_ndeg[arrive] - field.theta_ndeg[orientation])
                new_cost = cost + 2 * turn
                new_key = pack(grasp, arrive, tracks, orientations)
                if new_key in cost_of and cost_of[new_key] <= new_cost:
                    continue
                cost_of[new_key] = new_cost
                parent_of[new_key] = key
                left = paper_estimate_ndeg(
                    grasp, goal, field.theta_ndeg[arrive], field.theta_ndeg[end], interchangeable
                )
                age -= 1
                heapq.heappush(queue, (new_cost + left, left, age, new_key, 0))

        for leave in (first, second):
            stay = first + second - leave
            stay_sample = field.sample_of[grasp[stay], orientation]
            leave_sample = field.sample_of[grasp[leave], orientation]
            without = with_finger(grasp, leave, ABSENT)
            # the estimate depends on the new track only through 'is it a goal track', so all
            # others are tried together; `tracks` stands for any of them
            targets = goal_tracks(goal, free, interchangeable)
            for target in (tracks, targets[0], targets[1]):
                if target < 0:
                    continue
                left = paper_estimate_ndeg(
                    with_finger(without, free, target), goal,
                    field.theta_ndeg[orientation], field.theta_ndeg[end], interchangeable,
                )  # fmt: skip
                if left - estimate != (stage - 1) * _SWAP_NDEG:
                    continue
                low, high = (0, tracks) if target == tracks else (target, target + 1)
                for track in range(low, high):
                    if target == tracks and (track == targets[0] or track == targets[1]):
                        continue
                    sample = field.sample_of[track, orientation]
                    if not (
                        field.usable[sample]
                        and clear_of(field, stay_sample, sample)
                        and clear_of(field, leave_sample, sample)
                    ):
                        continue
                    # backward in time, the finger that appears here is the one that was removed
                    keep, go = sample, leave_sample
                    if reverse:
                        keep, go = go, keep
                    if not lets_go(field, stay_sample, keep, go):
                        continue
                    new_grasp = with_finger(without, free, track)
                    if interchangeable:
                        new_grasp = sorted_grasp(new_grasp)
                    new_key = pack(new_grasp, orientation, tracks, orientations)
                    new_cost = cost + _SWAP_NDEG
                    if new_key in cost_of and cost_of[new_key] <= new_cost:
                        continue
                    cost_of[new_key] = new_cost
                    parent_of[new_key] = key
                    age -= 1
                    heapq.heappush(queue, (new_cost + left, left, age, new_key, 0))
        if stage < _LAST_STAGE:
            age -= 1
            heapq.heappush(queue, (total + _SWAP_NDEG, estimate, age, key, stage + 1))
