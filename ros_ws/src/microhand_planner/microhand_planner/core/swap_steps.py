# SPDX-License-Identifier: Apache-2.0
"""The steps of the search over swaps: expanding one state after the other.

A state has some hundred swaps, nearly all of them dear: their estimates exceed the state's own by
0, 360 or 720 deg. So a state is expanded in up to three stages, and waits in between at the least
that it has left to offer. Swaps that bring it no nearer to the goal, but to where none brings it
nearer either, are as dear as those that take it farther away, and are put off until then.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb

from microhand_planner.core.exploration import ENDED, MORE_ROOM, MORE_STARTS
from microhand_planner.core.key_table import NOBODY
from microhand_planner.core.known_verdicts import (
    WORD,
    KnownVerdicts,
    known_roll,
    note_roll,
    swap_row,
)
from microhand_planner.core.open_list import least_total, lowest_bit, take, wait
from microhand_planner.core.outlook import (
    NOWHERE,
    SEEN,
    SWAP_NDEG,
    UNSEEN,
    Outlook,
    detour_ndeg,
    look,
)
from microhand_planner.core.removal_verdicts import swap_verdict
from microhand_planner.core.rotation_lattice import IntArray
from microhand_planner.core.search_field import rolls
from microhand_planner.core.search_result import Outcome
from microhand_planner.core.search_state import (
    ABSENT,
    RECONFIGURATION_NDEG,
    Grasp,
    is_any,
    pack_grasp,
    sorted_grasp,
    unpack_grasp,
    with_finger,
)
from microhand_planner.core.states import (
    AT,
    DONE,
    EXPANDED,
    GRASP,
    STAGE,
    States,
    grasp_number,
    has_room,
    reach,
)
from microhand_planner.core.swap_task import (
    Task,
    free_finger,
    goal_tracks,
    left_after,
    left_of,
    on_goal_track,
)

_NEARER, _ASIDE, _FARTHER = 0, 1, 2  # stages
_STUCK = -2  # a stage needs more room
_NEW_BY_ROLLS = 2
_NO_PATH, _BOUNDED = int(Outcome.NO_PATH), int(Outcome.BOUNDED)


class Known(NamedTuple):
    """What a search knows, and room for one step of it."""

    verdicts: KnownVerdicts
    states: States
    outlook: Outlook
    tracks: IntArray


@nb.njit(cache=True, nogil=True, error_model='numpy', _nrt=False)
def run(
    task: Task, known: Known, start: int, start_at: int, more_starts: bool, interrupt: IntArray
) -> int:  # pragma: no cover - compiled
    """Expand states until one is the goal, none is left, or more room or starts are needed.

    Parameters
    ----------
    task, known : Task, Known
        See there.
    start, start_at : int
        A packed grasp and an orientation to start from, or -1: no more than before.
    more_starts : bool
        Whether there are more; they cost as much as this one.
    interrupt : (2,) int64
        See `interruption`.

    Returns
    -------
    int
        The number of the state that is the goal, or below zero what is needed.
    """
    states = known.states
    theta_ndeg = task.field.theta_ndeg
    if start >= 0 and has_room(states, 1):
        grasp = unpack_grasp(start, task.bits)
        left = left_of(task, grasp)
        number = grasp_number(states, start)
        total = task.start_ndeg + RECONFIGURATION_NDEG * left
        total += _extra_ndeg(task, known, number, grasp, left, start_at)
        reach(states, number, start_at, 0, NOBODY, total, task.ranks[start_at, left])
    while True:
        if interrupt[0] != 0:
            return interrupt[0] - ENDED
        if not has_room(states, _NEW_BY_ROLLS):
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
        grasp = unpack_grasp(states.grasps.key[number], task.bits)
        if at == task.end and (is_any(task.goal) or grasp == task.goal):
            return state
        left = left_of(task, grasp)
        base = states.cost[state] + RECONFIGURATION_NDEG * left
        base += 2 * abs(theta_ndeg[at] - theta_ndeg[task.end])
        if stage == _NEARER:
            states.counts[EXPANDED] += 1
            interrupt[1] += 1
            _roll(task, known, state, number, grasp, left, at, base)
            if _nothing_nearer(task, states, number, left, at):
                stage = _ASIDE
        while stage != NOBODY and base + stage * SWAP_NDEG <= total:
            following = _swap(task, known, state, grasp, left, at, stage)
            if following == _STUCK:  # begin the stage again, when there is room
                states.counts[EXPANDED] -= stage == _NEARER
                interrupt[1] -= stage == _NEARER
                states.fact[state, STAGE] = stage
                wait(states.waiting, state, total, task.ranks[at, left])
                return MORE_ROOM
            stage = following
        states.fact[state, STAGE] = stage
        if stage == NOBODY:
            states.counts[DONE] += 1
        else:
            wait(states.waiting, state, base + stage * SWAP_NDEG, task.ranks[at, left])


@nb.njit(cache=True, inline='always')
def _roll(
    task: Task,
    known: Known,
    state: int,
    number: int,
    grasp: Grasp,
    left: int,
    at: int,
    base: int,
) -> None:  # pragma: no cover - compiled
    """Reach the states at the orientations beside this one."""
    states, roll, one_step = known.states, known.verdicts.roll, known.verdicts.one_step
    theta_ndeg, place_of = task.field.theta_ndeg, task.place_of
    cost = states.cost[state]
    free = free_finger(grasp)
    one, two = grasp[(free + 1) % 3], grasp[(free + 2) % 3]
    for arrive in (at - 1, at + 1):
        if arrive < 0 or arrive >= len(theta_ndeg):
            continue
        lower = min(at, arrive)
        turn = 2 * (theta_ndeg[lower + 1] - theta_ndeg[lower])
        other = states.state_of[number, arrive] - 1
        if other != NOBODY and states.cost[other] <= cost + turn:
            continue
        may = NOBODY
        key = 0
        if one_step[lower]:
            key = place_of[one, lower] * task.columns.shape[1] + place_of[two, lower] + 1
            may = known_roll(roll, key)
        if may == NOBODY:
            may = int(rolls(task.field, one, two, lower, arrive))
            if one_step[lower]:
                note_roll(roll, key, may == 1)
        if may == 1:
            total = base + turn + _extra_ndeg(task, known, number, grasp, left, arrive)
            total += 2 * abs(theta_ndeg[arrive] - theta_ndeg[task.end])
            total -= 2 * abs(theta_ndeg[at] - theta_ndeg[task.end])
            reach(states, number, arrive, cost + turn, state, total, task.ranks[arrive, left])


@nb.njit(cache=True, inline='always')
def _swap(
    task: Task,
    known: Known,
    state: int,
    grasp: Grasp,
    left: int,
    at: int,
    stage: int,
) -> int:  # pragma: no cover - compiled
    """Reach the states behind the swaps of a stage; return the next stage, or `NOBODY`."""
    states = known.states
    cost = states.cost[state] + SWAP_NDEG
    estimate = 2 * abs(task.field.theta_ndeg[at] - task.field.theta_ndeg[task.end])
    wanted = left + 2 * stage - 2
    free = free_finger(grasp)
    first = (free + 1) % 3
    second = (free + 2) % 3
    following = NOBODY
    for leaves in (first, second):
        stays = first + second - leaves
        stays_on = on_goal_track(task, grasp, stays)
        for placed_on in range(2):
            if placed_on == 1 and goal_tracks(task, free)[0] < 0:
                continue
            after = left_after(task, free, leaves, stays_on, placed_on)
            if after > wanted:
                following = stage + 1
            # at last those that were put off as no better than dearer ones
            put_off = stage == _FARTHER and after == left
            if after != wanted and not put_off:
                continue
            count = _placements(task, known, grasp, free, stays, leaves, placed_on, at)
            if not has_room(states, count):
                return _STUCK
            without = with_finger(grasp, leaves, ABSENT)
            for place in range(count):
                placed = with_finger(without, free, known.tracks[place])
                if task.interchangeable:
                    placed = sorted_grasp(placed)
                number = grasp_number(states, pack_grasp(placed, task.bits))
                other = states.state_of[number, at] - 1
                if other != NOBODY and states.cost[other] <= cost:
                    continue
                extra = _extra_ndeg(task, known, number, placed, after, at)
                if stage == _ASIDE and extra == SWAP_NDEG:
                    following = _FARTHER
                elif not put_off or extra == SWAP_NDEG:
                    total = cost + estimate + RECONFIGURATION_NDEG * after + extra
                    reach(states, number, at, cost, state, total, task.ranks[at, after])
    return following


@nb.njit(cache=True, inline='always')
def _placements(
    task: Task,
    known: Known,
    grasp: Grasp,
    free: int,
    stays: int,
    leaves: int,
    placed_on: int,
    at: int,
) -> int:  # pragma: no cover - compiled
    """Write down the tracks on which the free finger may be placed so that another can leave.

    Parameters
    ----------
    placed_on : int
        1: look at tracks of the goal; 0: at all others.

    Returns
    -------
    int
        The number of tracks.
    """
    verdicts, tracks, place_of = known.verdicts, known.tracks, task.place_of
    stay, leave = place_of[grasp[stays], at], place_of[grasp[leaves], at]
    goals = goal_tracks(task, free)
    count = 0
    if placed_on == 1:
        for track in goals:
            if track >= 0 and swap_verdict(
                task.columns, place_of[track, at], stay, leave, task.reverse, task.law
            ):
                tracks[count] = track
                count += 1
        return count
    turn = place_of[0, at]
    shift = turn % task.contacts  # the track that meets the first contact
    row = swap_row(verdicts, task.columns, turn - shift, stay, leave, task.reverse, task.law)
    for word in range(verdicts.swap_bits.shape[1]):
        bits = verdicts.swap_bits[row, word]
        while bits != 0:
            track = WORD * word + lowest_bit(bits) - shift
            bits &= bits - 1
            if track < 0:
                track += task.contacts
            if track != goals[0] and track != goals[1]:
                tracks[count] = track
                count += 1
    for track in range(task.contacts, len(place_of)):  # off the lattice
        if (
            track != goals[0]
            and track != goals[1]
            and swap_verdict(
                task.columns, place_of[track, at], stay, leave, task.reverse, task.law
            )
        ):
            tracks[count] = track
            count += 1
    return count


@nb.njit(cache=True, inline='always')
def _extra_ndeg(
    task: Task, known: Known, number: int, grasp: Grasp, left: int, at: int
) -> int:  # pragma: no cover - compiled
    """Return by how much a state costs more than its estimate at least, see `outlook`."""
    extra = 0
    if left != 0 and not is_any(task.goal):
        nearest = known.states.nearest
        if nearest[number, at] == UNSEEN:
            _look_at(task, known, number, grasp, left)
        by = nearest[number, at]
        extra = SWAP_NDEG
        if by != NOWHERE:
            extra = min(extra, detour_ndeg(task.field.theta_ndeg, at, by - SEEN, task.end))
    return extra


@nb.njit(cache=True, error_model='numpy', _nrt=False)
def _look_at(
    task: Task, known: Known, number: int, grasp: Grasp, left: int
) -> None:  # pragma: no cover - compiled
    """Fill the row of a grasp in `States.nearest`."""
    nearest = known.states.nearest[number]
    free = free_finger(grasp)
    first = (free + 1) % 3
    second = (free + 2) % 3
    first_on = on_goal_track(task, grasp, first)
    second_on = on_goal_track(task, grasp, second)
    nearer_anywhere = min(
        left_after(task, free, first, second_on, 0), left_after(task, free, second, first_on, 0)
    )
    if nearer_anywhere < left:  # there are too many such swaps to look at
        for at in range(len(nearest)):
            nearest[at] = at + SEEN
        return
    targets = goal_tracks(task, free)
    look(
        known.outlook, task.columns, task.place_of, task.law, task.reverse,
        grasp[first], grasp[second],
        left_after(task, free, first, second_on, 1) < left,
        left_after(task, free, second, first_on, 1) < left,
        (targets[0], targets[1]), task.field.theta_ndeg, task.end, nearest,
    )  # fmt: skip


@nb.njit(cache=True, inline='always')
def _nothing_nearer(
    task: Task, states: States, number: int, left: int, at: int
) -> bool:  # pragma: no cover - compiled
    """Return whether no swap brings a state nearer, as `_extra_ndeg` has found."""
    return left == 0 or is_any(task.goal) or states.nearest[number, at] != at + SEEN
