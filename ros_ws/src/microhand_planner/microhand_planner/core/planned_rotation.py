# SPDX-License-Identifier: Apache-2.0
"""One planar rotation of a sequence with the cheapest finger motions for it.

Between two rotations the fingers stand on joints I and J, where both section curves meet the X
axis. Fingers are interchangeable, so a rotation from joints to joints has six goals: which
finger ends on I, and which on J ([Kumar2021] §5.3). The first rotation of a sequence may begin,
and the last may end, with any grasp ([Kumar2021] §4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.errors import Cancelled, TimeLimitReached
from microhand_planner.core.graph_search import graph_search
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.rotation_lattice import IntArray, RotationLattice, rotation_lattice
from microhand_planner.core.search_result import NO_BOUND, Outcome, SearchResult
from microhand_planner.core.search_state import ABSENT, ANY_GRASP, Grasp, cost_left_ndeg
from microhand_planner.core.starting_grasps import starting_grasps
from microhand_planner.core.swap_search import swap_search

_FINGER_ORDERS = ((0, 1, 2), (1, 0, 2), (0, 2, 1), (2, 0, 1), (1, 2, 0), (2, 1, 0))


class Role(Enum):
    """Where a rotation stands in its sequence."""

    ONLY = 'only'
    FIRST = 'first'
    """Ends on the joints."""
    MIDDLE = 'middle'
    """Begins and ends on the joints."""
    LAST = 'last'
    """Begins on the joints."""


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
    expanded : int
        States that the searches expanded.
    time_s : float
        Wall time of the searches [s].
    """

    part: PlanarRotation
    curve: OffsetCurve
    lattice: RotationLattice
    states: IntArray
    cost_ndeg: int
    expanded: int
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
    interrupt : (1,) int64
        See `interruption`.
    """

    finger: Finger
    law: ContactLaw
    options: SearchOptions
    clock: Callable[[], float]
    interrupt: IntArray


def plan_planar_rotation(
    part: PlanarRotation,
    role: Role,
    curve: OffsetCurve,
    problem: Problem,
    bound_ndeg: int = NO_BOUND,
) -> PlannedRotation | None:
    """Find the cheapest finger motions for one rotation.

    Parameters
    ----------
    part : PlanarRotation
        Axis and angle.
    role : Role
        Which ends are on the joints. On the joints at the start, finger 1 is on I, finger 2 on J,
        finger 3 free; likewise at the end of a rotation that is the first.
    curve : OffsetCurve
        Path of the tips around the section.
    problem : Problem
        Fingers, contact law, options.
    bound_ndeg : int
        Only motions cheaper than this are wanted [1e-9 deg].

    Returns
    -------
    PlannedRotation or None
        None: nothing cheaper than the bound exists; without a bound: nothing at all.

    Raises
    ------
    TimeLimitReached, Cancelled
        The search was ended from outside.
    """
    started = problem.clock()
    joints = (0.0, curve.phase_of_joint_j)
    begins_on_joints = role in (Role.MIDDLE, Role.LAST)
    ends_on_joints = role in (Role.MIDDLE, Role.FIRST)
    lattice = rotation_lattice(
        curve,
        part.angle_rad,
        problem.options,
        joints if begins_on_joints else (),
        joints if ends_on_joints else (),
    )
    at_start, at_goal = (
        [lattice.track_at(phase, orientation) for phase in joints]
        for orientation in (lattice.start, lattice.goal)
    )
    search = graph_search if problem.law.stick_uN == 0.0 else swap_search
    expanded = 0

    def run(
        starts: IntArray | list[Grasp], goal: Grasp, bound: int, *, reverse: bool = False
    ) -> SearchResult:
        nonlocal expanded
        result = search(
            lattice,
            problem.finger,
            problem.law,
            starts,
            goal,
            reverse=reverse,
            bound_ndeg=bound,
            interrupt=problem.interrupt,
        )
        expanded += result.expanded
        _raise_if_interrupted(result.outcome, part, problem, expanded)
        return result

    found: SearchResult | None = None
    if role is Role.MIDDLE:
        start: Grasp = (at_start[0], at_start[1], ABSENT)
        tracks = (at_goal[0], at_goal[1], ABSENT)
        goals = [(tracks[i], tracks[j], tracks[k]) for i, j, k in _FINGER_ORDERS]
        theta = lattice.theta_ndeg
        goals.sort(
            key=lambda goal: cost_left_ndeg(start, goal, theta[lattice.start], theta[lattice.goal])
        )
        for goal in goals:
            result = run([start], goal, bound_ndeg)
            if result.outcome is Outcome.FOUND:
                found, bound_ndeg = result, result.cost_ndeg
    else:
        if role is Role.FIRST:
            result = run([(at_goal[0], at_goal[1], ABSENT)], ANY_GRASP, bound_ndeg, reverse=True)
        elif role is Role.LAST:
            result = run([(at_start[0], at_start[1], ABSENT)], ANY_GRASP, bound_ndeg)
        else:
            starts = starting_grasps(lattice, lattice.start, problem.finger)
            result = run(starts, ANY_GRASP, bound_ndeg)
        if result.outcome is Outcome.FOUND:
            found = result
    if found is None:
        return None
    return PlannedRotation(
        part=part,
        curve=curve,
        lattice=lattice,
        states=found.states,
        cost_ndeg=found.cost_ndeg,
        expanded=expanded,
        time_s=problem.clock() - started,
    )


def _raise_if_interrupted(
    outcome: Outcome, part: PlanarRotation, problem: Problem, expanded: int
) -> None:
    """Turn an interruption into the error that says so."""
    where = f'while planning the rotation about {part.axis}; {expanded} states expanded'
    if outcome is Outcome.TIME_LIMIT:
        raise TimeLimitReached(
            f'time limit of {problem.options.time_limit_s:g} s reached {where}; '
            'a plan may exist, allow more time',
            expanded,
        )
    if outcome is Outcome.CANCELLED:
        raise Cancelled(f'cancelled {where}', expanded)
