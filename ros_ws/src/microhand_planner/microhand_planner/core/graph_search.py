# SPDX-License-Identifier: Apache-2.0
"""The cheapest way to turn the object in the plane without adhesion: A* on the paper's graph.

Without adhesion three fingers can hold what two cannot, so grasps of two *and* three fingers are
states ([Kumar2021] §3.3): roll with all placed fingers, place the free one, remove one of three.
A finger that leaves does not pull, so a removal asks only that the grasp that stays is stable;
every edge can be walked both ways. Costs, heuristic, ties and stages as in `swap_search`.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numba as nb
import numpy as np

from microhand_planner.core.grasp import pair_presses, triple_presses
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules
from microhand_planner.core.rotation_lattice import IntArray, RotationLattice
from microhand_planner.core.search_field import SearchField, clear_of, search_field
from microhand_planner.core.search_result import NO_BOUND, Outcome, SearchResult
from microhand_planner.core.search_state import (
    ABSENT,
    RECONFIGURATION_NDEG,
    Grasp,
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

_LAST_STAGE = 2


def graph_search(
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
    """Find the cheapest sequence of rolls, placements and removals; see `swap_search`.

    Parameters
    ----------
    lattice : RotationLattice
        The planar problem.
    finger, law : Finger, ContactLaw
        Tips, and the friction of contacts that do not stick.
    starts : (k, 3) int
        Grasps to start from, of two fingers each.
    goal : tuple of 3 int
        Grasp of two fingers, or `ANY_GRASP`.
    interchangeable, reverse : bool
        As in `swap_search`.
    bound_ndeg : int
        Stop as soon as no path costs less than this [1e-9 deg].
    interrupt : (1,) int64, optional
        Another thread ends the search by writing an `Outcome`.

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
        bound_ndeg,
        np.zeros(1, dtype=np.int64) if interrupt is None else interrupt,
    )
    states = unpack_all(keys, len(lattice.track_unit), len(lattice.theta_rad))
    if reverse:
        states = states[::-1]
    if interchangeable and len(states) > 0:
        states = named_fingers(states)
    return SearchResult(Outcome(outcome), cost, states, expanded)


@nb.njit(cache=True)
def _stable(
    field: SearchField, samples: tuple[int, int, int]
) -> bool:  # pragma: no cover - compiled
    """Return whether the placed fingers hold by pressing; a sample below zero: not placed."""
    at_um = np.zeros((3, 2))
    at_normal = np.zeros((3, 2))
    placed = 0
    for one in range(3):
        if samples[one] < 0:
            continue
        if not field.usable[samples[one]]:
            return False
        for other in range(one):
            if samples[other] >= 0 and not clear_of(field, samples[one], samples[other]):
                return False
        at_um[placed] = field.contact_um[samples[one]]
        at_normal[placed] = field.normal[samples[one]]
        placed += 1
    if placed == 2:
        return pair_presses(at_um, at_normal, field.friction)
    return triple_presses(at_um, at_normal, field.friction)


@nb.njit(cache=True, inline='always')
def _samples_at(
    field: SearchField, grasp: Grasp, orientation: int, back: int
) -> tuple[int, int, int]:  # pragma: no cover - compiled
    """Return the samples of a grasp, rolled on by `back` samples from an orientation."""
    samples = (-1, -1, -1)
    for finger in range(3):
        if grasp[finger] >= 0:
            here = field.sample_of[grasp[finger], orientation]
            base = here - here % field.block
            samples = with_finger(samples, finger, base + (here - base - back) % field.block)
    return samples


@nb.njit(cache=True, nogil=True)
def _search(
    field: SearchField,
    starts: IntArray,
    begin: int,
    goal: Grasp,
    end: int,
    interchangeable: bool,
    bound_ndeg: int,
    interrupt: IntArray,
) -> tuple[int, int, IntArray, int]:  # pragma: no cover - compiled
    """Run A*; see `graph_search`. Returns outcome, cost, packed states of the path, expansions."""
    tracks, orientations = field.sample_of.shape
    theta_ndeg = field.theta_ndeg
    nothing = np.zeros(0, dtype=np.int64)
    if len(starts) == 0 or not (is_any(goal) or _stable(field, _samples_at(field, goal, end, 0))):
        return 1, -1, nothing, 0
    first_start = (starts[0, 0], starts[0, 1], starts[0, 2])
    start_total = paper_estimate_ndeg(
        first_start, goal, theta_ndeg[begin], theta_ndeg[end], interchangeable
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
        while next_start < len(starts) and (len(queue) == 0 or queue[0][0] > start_total):
            grasp = (starts[next_start, 0], starts[next_start, 1], starts[next_start, 2])
            next_start += 1
            if interchangeable:
                grasp = sorted_grasp(grasp)
            if _stable(field, _samples_at(field, grasp, begin, 0)):
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
        if total - estimate != cost + stage * RECONFIGURATION_NDEG:
            continue  # a cheaper way to this state has been found since
        grasp, orientation = unpack(key, tracks, orientations)
        placed = 0
        for finger in range(3):
            placed += grasp[finger] >= 0
        if orientation == end and (grasp == goal or (is_any(goal) and placed == 2)):
            return 0, cost, trace_back(key, parent_of), expanded

        if stage == 0:
            expanded += 1
            for arrive in (orientation - 1, orientation + 1):
                if arrive < 0 or arrive >= orientations:
                    continue
                lower = min(orientation, arrive)
                holds = _stable(field, _samples_at(field, grasp, arrive, 0))
                back = 1
                while holds and back <= field.interior[lower]:
                    holds = _stable(field, _samples_at(field, grasp, lower, back))
                    back += 1
                if not holds:
                    continue
                new_cost = cost + placed * abs(theta_ndeg[arrive] - theta_ndeg[orientation])
                new_key = pack(grasp, arrive, tracks, orientations)
                if new_key in cost_of and cost_of[new_key] <= new_cost:
                    continue
                cost_of[new_key] = new_cost
                parent_of[new_key] = key
                left = paper_estimate_ndeg(
                    grasp, goal, theta_ndeg[arrive], theta_ndeg[end], interchangeable
                )
                age -= 1
                heapq.heappush(queue, (new_cost + left, left, age, new_key, 0))

        for finger in range(3):
            if placed == 3:
                low, high = ABSENT, 0  # remove it
            elif grasp[finger] < 0:
                low, high = 0, tracks  # place it anywhere
            else:
                continue
            for track in range(low, high):
                new_grasp = with_finger(grasp, finger, track)
                left = paper_estimate_ndeg(
                    new_grasp, goal, theta_ndeg[orientation], theta_ndeg[end], interchangeable
                )
                if left - estimate != (stage - 1) * RECONFIGURATION_NDEG:
                    continue
                if interchangeable:
                    new_grasp = sorted_grasp(new_grasp)
                new_key = pack(new_grasp, orientation, tracks, orientations)
                new_cost = cost + RECONFIGURATION_NDEG
                if new_key in cost_of and cost_of[new_key] <= new_cost:
                    continue
                if not _stable(field, _samples_at(field, new_grasp, orientation, 0)):
                    continue
                cost_of[new_key] = new_cost
                parent_of[new_key] = key
                age -= 1
                heapq.heappush(queue, (new_cost + left, left, age, new_key, 0))
        if stage < _LAST_STAGE:
            age -= 1
            heapq.heappush(queue, (total + RECONFIGURATION_NDEG, estimate, age, key, stage + 1))
