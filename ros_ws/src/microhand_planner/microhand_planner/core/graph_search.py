# SPDX-License-Identifier: Apache-2.0
"""The cheapest way to turn the object in the plane without adhesion: A* on the paper's graph.

Without adhesion three fingers can hold what two cannot, so grasps of two *and* three fingers are
states ([Kumar2021] §3.3): roll with all placed fingers, place the free one, remove one of three.
A finger that leaves does not pull, so a removal asks only that the grasp that stays is stable;
every edge can be walked both ways. Costs and ties as in `swap_search`, with the estimate of
[Kumar2021] Eq. 13. A placement or removal takes the state nearer to the goal, or farther away by
twice its cost: so a state is expanded in two stages.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numba as nb
import numpy as np

from microhand_planner.core.exploration import (
    ENDED,
    MORE_ROOM,
    MORE_STARTS,
    explore,
)
from microhand_planner.core.grasp import pair_presses, triple_presses
from microhand_planner.core.interruption import uninterrupted
from microhand_planner.core.key_table import NOBODY, spread
from microhand_planner.core.open_list import least_total, take, wait
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules
from microhand_planner.core.rotation_lattice import IntArray, RotationLattice
from microhand_planner.core.search_field import SearchField, clear_of, search_field
from microhand_planner.core.search_result import NO_BOUND, Outcome, SearchResult
from microhand_planner.core.search_state import (
    ABSENT,
    RECONFIGURATION_NDEG,
    Grasp,
    Packing,
    estimate_ranks,
    is_any,
    pack_grasp,
    packing,
    reconfigurations_left,
    sorted_grasp,
    unpack_grasp,
    with_finger,
)
from microhand_planner.core.starting_grasps import starting_grasps
from microhand_planner.core.states import (
    AT,
    DONE,
    EXPANDED,
    GRASP,
    STAGE,
    States,
    grasp_number,
    has_room,
    no_states,
    reach,
)

_NEARER, _FARTHER = 0, 1  # stages
_TOTALS = 8  # new ones at a time: two rolls, two stages, and some to spare
_VERDICTS = 1 << 16
_NO_PATH, _BOUNDED = int(Outcome.NO_PATH), int(Outcome.BOUNDED)


class _Task(NamedTuple):
    """What is asked, in the search's direction."""

    field: SearchField
    bits: Packing
    goal: Grasp
    end: int
    interchangeable: bool
    bound_ndeg: int
    start_ndeg: int
    ranks: IntArray


def graph_search(
    lattice: RotationLattice,
    finger: Finger,
    law: ContactLaw,
    start: Grasp,
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
    start, goal : tuple of 3 int
        Grasps of two fingers, or `ANY_GRASP` for the goal or for both.
    interchangeable, reverse : bool
        As in `swap_search`.
    bound_ndeg : int
        Stop as soon as no path costs less than this [1e-9 deg].
    interrupt : (2,) int64, optional
        As in `swap_search`.
    rules : GripRules, optional
        Only their share of the friction counts.

    Returns
    -------
    SearchResult

    Raises
    ------
    TimeLimitReached
        The search has met more states than it has memory for.
    """
    begin, end = (lattice.goal, lattice.start) if reverse else (lattice.start, lattice.goal)
    if interchangeable:
        start, goal = sorted_grasp(start), sorted_grasp(goal)
    interrupt = uninterrupted() if interrupt is None else interrupt
    theta_ndeg = lattice.theta_ndeg
    ranks, rank_count = estimate_ranks(theta_ndeg, end)
    task = _Task(
        field=search_field(lattice, finger, law, rules),
        bits=packing(len(lattice.track_unit), len(theta_ndeg)),
        goal=goal,
        end=end,
        interchangeable=interchangeable,
        bound_ndeg=bound_ndeg,
        start_ndeg=2 * abs(int(theta_ndeg[begin] - theta_ndeg[end])),
        ranks=ranks,
    )
    verdicts = np.zeros(_VERDICTS, dtype=np.int64)

    def starts() -> Iterator[int]:
        """Yield the packed grasps to start from."""
        if not (is_any(goal) or _is_stable(task.field, verdicts, goal, end, 0)):
            return
        for grasp in starting_grasps(task.field, begin, interrupt) if is_any(start) else (start,):
            yield pack_grasp(sorted_grasp(grasp) if interchangeable else grasp, task.bits)

    return explore(
        lambda states, code, more_starts: run(
            task, verdicts, states, code, begin, more_starts, interrupt
        ),
        no_states(len(theta_ndeg), rank_count, _TOTALS, looks=False),
        starts(),
        task.bits,
        interrupt,
        several=is_any(start),
        interchangeable=interchangeable,
        reverse=reverse,
    )


@nb.njit(cache=True, nogil=True, error_model='numpy')
def run(
    task: _Task,
    verdicts: IntArray,
    states: States,
    start: int,
    start_at: int,
    more_starts: bool,
    interrupt: IntArray,
) -> int:  # pragma: no cover - compiled
    """Expand states; `exploration.Step` says what is returned."""
    theta_ndeg = task.field.theta_ndeg
    tracks, orientations = task.field.sample_of.shape
    if start >= 0 and has_room(states, 1):
        grasp = unpack_grasp(start, task.bits)
        if _is_stable(task.field, verdicts, grasp, start_at, 0):
            left = reconfigurations_left(grasp, task.goal, task.interchangeable)
            total = task.start_ndeg + RECONFIGURATION_NDEG * left
            rank = task.ranks[start_at, left]
            reach(states, grasp_number(states, start), start_at, 0, NOBODY, total, rank)
    while True:
        if interrupt[0] != 0:
            return interrupt[0] - ENDED
        if not has_room(states, tracks + 2):
            return MORE_ROOM
        total = least_total(states.waiting)
        if more_starts and (total == NOBODY or total > task.start_ndeg):
            return MORE_STARTS
        if total == NOBODY:
            return _NO_PATH - ENDED
        if total >= task.bound_ndeg:
            return _BOUNDED - ENDED
        state = take(states.waiting)
        number = states.fact[state, GRASP]
        at = states.fact[state, AT]
        stage = states.fact[state, STAGE]
        cost = states.cost[state]
        grasp = unpack_grasp(states.grasps.key[number], task.bits)
        placed = 0
        for finger in range(3):
            placed += grasp[finger] >= 0
        if at == task.end and (grasp == task.goal or (is_any(task.goal) and placed == 2)):
            return state
        left = reconfigurations_left(grasp, task.goal, task.interchangeable)
        estimate = 2 * abs(theta_ndeg[at] - theta_ndeg[task.end])

        if stage == _NEARER:
            states.counts[EXPANDED] += 1
            interrupt[1] += 1
            for arrive in (at - 1, at + 1):
                if arrive < 0 or arrive >= orientations:
                    continue
                lower = min(at, arrive)
                its = cost + placed * (theta_ndeg[lower + 1] - theta_ndeg[lower])
                other = states.state_of[number, arrive] - 1
                if other != NOBODY and states.cost[other] <= its:
                    continue
                holds = _is_stable(task.field, verdicts, grasp, arrive, 0)
                back = 1
                while holds and back <= task.field.interior[lower]:
                    holds = _is_stable(task.field, verdicts, grasp, lower, back)
                    back += 1
                if holds:
                    total = its + 2 * abs(theta_ndeg[arrive] - theta_ndeg[task.end])
                    total += RECONFIGURATION_NDEG * left
                    reach(states, number, arrive, its, state, total, task.ranks[arrive, left])

        cost += RECONFIGURATION_NDEG
        wanted = left - 1 if stage == _NEARER else left + 1
        for finger in range(3):
            if placed == 3:
                low, high = ABSENT, 0  # remove it
            elif grasp[finger] < 0:
                low, high = 0, tracks  # place it anywhere
            else:
                continue
            for track in range(low, high):
                new_grasp = with_finger(grasp, finger, track)
                if reconfigurations_left(new_grasp, task.goal, task.interchangeable) != wanted:
                    continue
                if task.interchangeable:
                    new_grasp = sorted_grasp(new_grasp)
                if not _is_stable(task.field, verdicts, new_grasp, at, 0):
                    continue
                total = cost + estimate + RECONFIGURATION_NDEG * wanted
                new = grasp_number(states, pack_grasp(new_grasp, task.bits))
                reach(states, new, at, cost, state, total, task.ranks[at, wanted])
        if stage == _NEARER:
            states.fact[state, STAGE] = _FARTHER
            total = cost + estimate + RECONFIGURATION_NDEG * (left + 1)
            wait(states.waiting, state, total, task.ranks[at, left])
        else:
            states.fact[state, STAGE] = NOBODY
            states.counts[DONE] += 1


@nb.njit(cache=True, error_model='numpy', inline='always')
def _is_stable(
    field: SearchField, verdicts: IntArray, grasp: Grasp, orientation: int, back: int
) -> bool:  # pragma: no cover - compiled
    """Return whether a grasp holds, rolled on by `back` samples from an orientation.

    Each verdict has a place in a table, and is formed anew if another has taken its place.
    """
    samples = _samples(field.sample_of, field.block, grasp, orientation, back)
    some = len(field.usable) + 1
    key = (samples[0] * some + samples[1]) * some + samples[2] + 2
    slot = spread(key) & (len(verdicts) - 1)
    if verdicts[slot] >> 1 != key:
        verdicts[slot] = 2 * key + _holds(field, samples)
    return verdicts[slot] & 1 == 1


@nb.njit(cache=True, error_model='numpy', _nrt=False)
def _samples(
    sample_of: IntArray, block: int, grasp: Grasp, orientation: int, back: int
) -> Grasp:  # pragma: no cover - compiled
    """Return the samples of the fingers in falling order; -1 if one is free."""
    samples = (ABSENT, ABSENT, ABSENT)
    for finger in range(3):
        if grasp[finger] >= 0:
            here = sample_of[grasp[finger], orientation]
            base = here - here % block
            samples = with_finger(samples, finger, base + (here - base - back) % block)
    return sorted_grasp(samples)


@nb.njit(cache=True)
def _holds(field: SearchField, samples: Grasp) -> bool:  # pragma: no cover - compiled
    """Return whether fingers on two or three samples hold by pressing; the third may be -1."""
    at_um = np.zeros((3, 2))
    at_normal = np.zeros((3, 2))
    placed = 0
    for one in range(3):
        sample = samples[one]
        if sample < 0:
            continue
        if not field.usable[sample]:
            return False
        for other in range(one):
            if not clear_of(field, sample, samples[other]):
                return False
        at_um[placed] = field.contact_um[sample]
        at_normal[placed] = field.normal[sample]
        placed += 1
    if placed == 2:
        return pair_presses(at_um, at_normal, field.friction)
    return triple_presses(at_um, at_normal, field.friction)
