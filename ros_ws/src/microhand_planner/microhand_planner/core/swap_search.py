# SPDX-License-Identifier: Apache-2.0
"""The cheapest way to turn the object in the plane, under adhesion: an exact search over swaps.

With adhesion a grasp of three is stable exactly when its pairs are, so 'place k, roll on three,
remove i' is never better than 'roll on two, place k, remove i'. What is left of the graph of
[Kumar2021] §3.3 are grasps of two fingers, rolls, and *swaps* (place the free finger, remove one
of the others; cost 360 deg). On them runs A* in integer costs. Its estimate is that of
[Kumar2021] Eq. 13 with what `outlook` finds to be missing there; ties are broken by the smaller
Eq. 13 ([Kumar2021] §4), then by the younger state.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator

import numpy as np

from microhand_planner.core.exploration import explore
from microhand_planner.core.interruption import uninterrupted
from microhand_planner.core.known_verdicts import known_verdicts
from microhand_planner.core.outlook import SWAP_NDEG, no_outlook
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules
from microhand_planner.core.removal_verdicts import contact_columns, removal_law
from microhand_planner.core.rotation_lattice import IntArray, RotationLattice
from microhand_planner.core.search_field import search_field
from microhand_planner.core.search_result import NO_BOUND, SearchResult
from microhand_planner.core.search_state import (
    ABSENT,
    Grasp,
    estimate_ranks,
    is_any,
    pack_grasp,
    packing,
    reconfigurations_left,
    sorted_grasp,
)
from microhand_planner.core.starting_grasps import starting_grasps
from microhand_planner.core.states import no_states
from microhand_planner.core.swap_steps import Known, run
from microhand_planner.core.swap_task import Task


def swap_search(
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
    """Find the cheapest sequence of rolls and swaps from one grasp to another.

    Parameters
    ----------
    lattice : RotationLattice
        The planar problem.
    finger, law : Finger, ContactLaw
        Tips, and contacts with adhesion.
    start, goal : tuple of 3 int
        Grasps of two fingers, or `ANY_GRASP` for the goal or for both; the firmest of equally
        good starts is taken. The orientations are those of the lattice.
    interchangeable : bool
        True: any finger may end on any track of the goal, and the path is that of the cheapest of
        its six permutations; fingers are then named along the path. False: as given.
    reverse : bool
        True: search backward in time, from the lattice's goal orientation and the grasp `start`
        to its start orientation and the grasp `goal`. The path is returned in forward order.
    bound_ndeg : int
        Stop as soon as no path costs less than this [1e-9 deg].
    interrupt : (2,) int64, optional
        Looked at before every expansion, and counts them; see `interruption`.
    rules : GripRules, optional
        Margins that removals and rolls keep; by default [Kumar2021] Eq. 4 alone.

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
    field = search_field(lattice, finger, law, rules)
    density = lattice.block // lattice.contacts
    task = Task(
        field=field,
        columns=contact_columns(field, density),
        place_of=_places(lattice, density),
        law=removal_law(field),
        contacts=lattice.contacts,
        bits=packing(len(lattice.track_unit), len(theta_ndeg)),
        goal=goal,
        end=end,
        interchangeable=interchangeable,
        reverse=reverse,
        bound_ndeg=bound_ndeg,
        start_ndeg=2 * abs(int(theta_ndeg[begin] - theta_ndeg[end])),
        left_of=_left_of(
            (goal[0] >= 0, goal[1] >= 0, goal[2] >= 0), interchangeable=interchangeable
        ),
        ranks=ranks,
    )
    verdicts = known_verdicts(lattice)
    outlook = no_outlook(len(theta_ndeg))
    tracks = np.zeros(len(lattice.track_unit), dtype=np.int64)

    def starts() -> Iterator[int]:
        """Yield the packed grasps to start from."""
        if not (is_any(goal) or _stands(task, goal, end)):
            return
        if is_any(start):
            for grasp in starting_grasps(field, begin, interrupt):
                yield pack_grasp(sorted_grasp(grasp) if interchangeable else grasp, task.bits)
        elif _stands(task, start, begin):
            yield pack_grasp(start, task.bits)

    return explore(
        lambda states, code, more_starts: run(
            task, Known(verdicts, states, outlook, tracks), code, begin, more_starts, interrupt
        ),
        no_states(len(theta_ndeg), rank_count, _totals_at_a_time(theta_ndeg), looks=True),
        starts(),
        task.bits,
        interrupt,
        several=is_any(start),
        interchangeable=interchangeable,
        reverse=reverse,
    )


def _places(lattice: RotationLattice, density: int) -> IntArray:
    """Return the place among `contact_columns` of each track and orientation, read-only."""
    if density == 1:
        return lattice.sample_of
    places = lattice.sample_of // density
    places.setflags(write=False)
    return places


def _stands(task: Task, grasp: Grasp, at: int) -> bool:
    """Return whether two fingers may stand so at an orientation."""
    x, y = np.diff(task.columns[4:, [task.place_of[track, at] for track in grasp if track >= 0]])
    return bool(x[0] * x[0] + y[0] * y[0] >= task.law.least_um * task.law.least_um)


def _totals_at_a_time(theta_ndeg: IntArray) -> int:
    """Return how many totals the expansion of a state brings at most.

    A child exceeds its parent by whole swaps and a detour. There are as many detours cheaper than
    a swap as orientations that near to the state's, or that near behind the goal's.
    """
    step_ndeg = int(np.diff(theta_ndeg).max(initial=1)) if len(theta_ndeg) > 1 else SWAP_NDEG
    return 3 * (2 * (SWAP_NDEG // (4 * step_ndeg)) + 4)


@functools.cache
def _left_of(used: tuple[bool, bool, bool], *, interchangeable: bool) -> IntArray:
    """Return the placements and removals that are left for two fingers, (3, 2, 2) int.

    By the finger f that is free, and by whether f + 1 and f + 2 are on tracks of the goal.

    Parameters
    ----------
    used : (bool, bool, bool)
        Which fingers the goal uses.
    interchangeable : bool
        As in `swap_search`.
    """
    goal = tuple(track if use else ABSENT for track, use in enumerate(used))
    elsewhere = 3
    left_of = np.zeros((3, 2, 2), dtype=np.int64)
    for free, first_on, second_on in np.ndindex(3, 2, 2):
        first, second = (free + 1) % 3, (free + 2) % 3
        there = (goal[0], goal[1]) if interchangeable else (goal[first], goal[second])
        grasp = [ABSENT] * 3
        grasp[first] = there[0] if first_on else elsewhere
        grasp[second] = there[1] if second_on else elsewhere
        if grasp[first] >= 0 and grasp[second] >= 0:
            left_of[free, first_on, second_on] = reconfigurations_left(
                (grasp[0], grasp[1], grasp[2]), (goal[0], goal[1], goal[2]), interchangeable
            )
    left_of.setflags(write=False)
    return left_of
