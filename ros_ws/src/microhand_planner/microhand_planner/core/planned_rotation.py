# SPDX-License-Identifier: Apache-2.0
"""One planar rotation of a sequence with the cheapest finger motions for it.

Between two rotations the fingers stand on joints I and J, where both section curves meet the X
axis. Which finger ends on I, and which on J, is open: six goals, of which the cheapest counts
([Kumar2021] §5.3). The first rotation of a sequence may begin, and the last may end, with any
grasp ([Kumar2021] §4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.errors import Cancelled, TimeLimitReached
from microhand_planner.core.graph_search import graph_search
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, SearchOptions
from microhand_planner.core.rotation_lattice import IntArray, RotationLattice, rotation_lattice
from microhand_planner.core.search_result import NO_BOUND, Outcome, SearchResult
from microhand_planner.core.search_state import ABSENT, ANY_GRASP, Grasp
from microhand_planner.core.swap_search import swap_search

Phases = tuple[float, float]


@dataclass(frozen=True)
class PlannedRotation:
    """One planar rotation with the cheapest finger motions for it.

    Parameters
    ----------
    part : PlanarRotation
        Axis and angle.
    curve : OffsetCurve
        Where the tips move around the section.
    lattice : RotationLattice
        The discrete problem that `states` index.
    states : (k, 4) int
        Tracks of fingers 1, 2, 3 (-1: free) and orientation, in order.
    cost_ndeg : int
        By [Kumar2021] Eq. 11 and 12 [1e-9 deg].
    expanded, waiting : int
        States that the search expanded, and those that it had met and not done with.
    time_s : float
        Wall time of the searches [s].
    """

    part: PlanarRotation
    curve: OffsetCurve
    lattice: RotationLattice
    states: IntArray
    cost_ndeg: int
    expanded: int
    waiting: int
    time_s: float

    @property
    def reconfigurations(self) -> int:
        """Placements and removals; a swap is one of each."""
        placed = self.states[1:, :3] != self.states[:-1, :3]
        was = self.states[:-1, :3] != ABSENT
        now = self.states[1:, :3] != ABSENT
        return int(np.sum(placed & was) + np.sum(placed & now))

    def renamed(self, order: tuple[int, int, int]) -> PlannedRotation:
        """Return the same motions with finger f + 1 doing what finger ``order[f]`` + 1 did."""
        states = self.states.copy()
        states[:, :3] = self.states[:, order]
        return replace(self, states=states)


@dataclass(frozen=True)
class Problem:
    """What all searches of one request share.

    Parameters
    ----------
    finger, law, options : Finger, ContactLaw, SearchOptions
        What the planner assumes.
    clock : callable
        Current time [s].
    interrupt : (2,) int64
        See `interruption`.
    rules : GripRules or None
        Margins that removals keep; None: [Kumar2021] Eq. 4 alone.
    """

    finger: Finger
    law: ContactLaw
    options: SearchOptions
    clock: Callable[[], float]
    interrupt: IntArray
    rules: GripRules | None = None


def plan_planar_rotation(
    part: PlanarRotation,
    curve: OffsetCurve,
    problem: Problem,
    start_phase_rad: Phases | None,
    goal_phase_rad: Phases | None,
    bound_ndeg: int = NO_BOUND,
) -> tuple[PlannedRotation | None, int]:
    """Find the cheapest finger motions for one rotation.

    Parameters
    ----------
    part : PlanarRotation
        Axis and angle.
    curve : OffsetCurve
        Path of the tips around the section.
    problem : Problem
        Fingers, contact law, options.
    start_phase_rad, goal_phase_rad : (float, float) or None
        Contact phases of the two fingers that hold before and after the rotation [rad]; None:
        any grasp. Which finger is where is open.
    bound_ndeg : int
        Only motions cheaper than this are wanted [1e-9 deg].

    Returns
    -------
    planned : PlannedRotation or None
        None: nothing cheaper than the bound exists; without a bound: nothing at all.
    expanded : int
        States expanded, whether or not something was found.

    Raises
    ------
    TimeLimitReached, Cancelled
        The search was ended from outside.
    """
    started = problem.clock()
    lattice = rotation_lattice(
        curve,
        part.angle_rad,
        problem.options,
        start_phase_rad or (),
        goal_phase_rad or (),
        problem.interrupt,
    )
    search = graph_search if problem.law.stick_uN == 0.0 else swap_search
    goal = ANY_GRASP
    if goal_phase_rad is not None:
        goal = _grasp_at(lattice, goal_phase_rad, lattice.goal)
    backward = start_phase_rad is None and goal_phase_rad is not None
    start = ANY_GRASP
    if start_phase_rad is not None:
        start = _grasp_at(lattice, start_phase_rad, lattice.start)
    elif backward:
        start, goal = goal, ANY_GRASP  # from the one end that is given to any grasp at the other
    result = search(
        lattice,
        problem.finger,
        problem.law,
        start,
        goal,
        reverse=backward,
        bound_ndeg=bound_ndeg,
        interrupt=problem.interrupt,
        rules=problem.rules,
    )
    _raise_if_interrupted(result, part, problem)
    if result.outcome is not Outcome.FOUND:
        return None, result.expanded
    planned = PlannedRotation(
        part=part,
        curve=curve,
        lattice=lattice,
        states=result.states,
        cost_ndeg=result.cost_ndeg,
        expanded=result.expanded,
        waiting=result.waiting,
        time_s=problem.clock() - started,
    )
    return planned, result.expanded


def _grasp_at(lattice: RotationLattice, phase_rad: Phases, orientation: int) -> Grasp:
    """Return the grasp of two fingers with the given contact phases at an orientation."""
    first, second = (lattice.track_at(phase, orientation) for phase in phase_rad)
    return first, second, ABSENT


def _raise_if_interrupted(result: SearchResult, part: PlanarRotation, problem: Problem) -> None:
    """Turn an interruption into the error that says so."""
    where = f'while planning a rotation about {part.axis}; {result.expanded} states expanded'
    if result.outcome is Outcome.TIME_LIMIT:
        raise TimeLimitReached(
            f'time limit of {problem.options.time_limit_s:g} s reached {where}; '
            'a plan may exist, allow more time',
            result.expanded,
        )
    if result.outcome is Outcome.CANCELLED:
        raise Cancelled(f'cancelled {where}', result.expanded)
