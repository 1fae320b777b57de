# SPDX-License-Identifier: Apache-2.0
"""The cheapest way through all planar rotations of a reorientation, chosen as a whole.

Rotations meet on joints I and J. There fingers are interchangeable: what a rotation costs does
not depend on which of them stands on I, so the permutation that is cheapest for a rotation is
cheapest for the whole, and the rotations after it are the same motions by other fingers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.errors import NoPlan, NoPlanExists
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.planned_rotation import (
    Phases,
    PlannedRotation,
    Problem,
    plan_planar_rotation,
)
from microhand_planner.core.search_result import NO_BOUND
from microhand_planner.core.search_state import ABSENT, NDEG, RECONFIGURATION_NDEG
from microhand_planner.core.start_grasp import StartGrasp

Decomposition = Sequence[PlanarRotation]

_FEWEST_FROM_JOINT_TO_JOINT = 4


def cheapest_sequence(
    decompositions: Sequence[Decomposition],
    curves: Mapping[str, OffsetCurve],
    problem: Problem,
    start: StartGrasp | None = None,
) -> tuple[PlannedRotation, ...]:
    """Plan the cheapest of several decompositions.

    Parameters
    ----------
    decompositions : sequence of sequences of PlanarRotation
        The same rotation in space, taken apart in different ways; none of them empty.
    curves : mapping
        The path of the tips for the axes ``'z'`` and ``'y'``.
    problem : Problem
        Fingers, contact law, options.
    start : StartGrasp, optional
        The grasp to begin with; by default any.

    Returns
    -------
    tuple of PlannedRotation
        In order; the fingers of each continue those of the one before.

    Raises
    ------
    NoPlanExists
        No decomposition can be done: proven, within the contacts and angles of the lattice.
    TimeLimitReached, Cancelled
        The search was ended from outside.
    """
    best: list[PlannedRotation] = []
    best_ndeg = NO_BOUND
    solved: dict[object, tuple[PlannedRotation | None, int]] = {}
    failed: PlanarRotation | None = None
    expanded = 0

    def solve(
        part: PlanarRotation, begin: Phases | None, end: Phases | None, bound_ndeg: int
    ) -> PlannedRotation | None:
        """Solve each planar problem once, unless an earlier bound was tighter."""
        nonlocal expanded
        key = (part, begin, end)
        planned, below_ndeg = solved.get(key, (None, -1))
        if planned is None and below_ndeg < bound_ndeg:
            try:
                planned, effort = plan_planar_rotation(
                    part, curves[part.axis], problem, begin, end, bound_ndeg
                )
            except NoPlan as error:
                error.expanded += expanded  # the searches before it count, too
                raise
            expanded += effort
            solved[key] = (planned, bound_ndeg)
        return planned if planned is not None and planned.cost_ndeg < bound_ndeg else None

    if start is not None:
        decompositions = [_from_plane_of(start, parts) for parts in decompositions]
    choices = [(_least_costs_ndeg(parts, curves, problem), parts) for parts in decompositions]
    for least_ndeg, parts in sorted(choices, key=lambda choice: sum(choice[0])):
        left_ndeg = sum(least_ndeg)
        if left_ndeg >= best_ndeg:
            break
        sequence: list[PlannedRotation] = []
        spent_ndeg = 0
        for index, part in enumerate(parts):
            joints = (0.0, curves[part.axis].phase_of_joint_j)
            given = None if start is None else start.phase_rad
            begin = joints if index > 0 else given
            end = joints if index < len(parts) - 1 else None
            left_ndeg -= least_ndeg[index]
            bound_ndeg = best_ndeg - spent_ndeg - left_ndeg
            planned = solve(part, begin, end, bound_ndeg) if bound_ndeg > 0 else None
            if planned is None:
                failed = part
                break
            spent_ndeg += planned.cost_ndeg
            sequence.append(planned)
        else:
            best, best_ndeg = sequence, spent_ndeg
    if not best:
        raise NoPlanExists(
            'no plan exists: the search was exhaustive, and no sequence of grasps brings the '
            f'object to the goal (last tried: {_spoken(failed)}); '
            f'{_advice(problem, start)} may help',
            expanded,
        )
    if start is not None:
        best[0] = _held_as(start, best[0])
    return _continued(best)


def _from_plane_of(start: StartGrasp, parts: Decomposition) -> Decomposition:
    """Return the rotations, led by one of zero if they begin in another plane than the grasp."""
    if parts[0].axis == start.axis:
        return parts
    return [PlanarRotation(start.axis, 0.0), *parts]


def _held_as(start: StartGrasp, planned: PlannedRotation) -> PlannedRotation:
    """Return the same motions by the fingers that hold the object now."""
    tracks = planned.states[0, :3]
    order = [ABSENT] * 3
    for finger, phase_rad in zip(start.fingers, start.phase_rad, strict=True):
        track = planned.lattice.track_at(phase_rad, int(planned.states[0, 3]))
        order[finger] = int(np.flatnonzero(tracks == track)[0])
    order[order.index(ABSENT)] = 3 - sum(order) - 1
    return planned.renamed((order[0], order[1], order[2]))


def _least_costs_ndeg(
    parts: Decomposition, curves: Mapping[str, OffsetCurve], problem: Problem
) -> list[int]:
    """Return for each rotation a cost that no motion undercuts.

    Two fingers roll all the way. A rotation from joints to joints needs four placements and
    removals besides, unless rolling alone brings a finger from a joint to a joint
    ([Kumar2021] Table 1); a finger that comes as near as two steps is given the benefit of doubt.
    """
    least_ndeg = []
    for index, part in enumerate(parts):
        cost_ndeg = round(2.0 * abs(np.degrees(part.angle_rad)) * NDEG)
        if 0 < index < len(parts) - 1:
            curve = curves[part.axis]
            joints = np.array([0.0, curve.phase_of_joint_j])
            ahead = (joints[:, None] - joints - part.angle_rad) % curve.length_rad
            if np.min(np.minimum(ahead, curve.length_rad - ahead)) > 2 * problem.options.step_rad:
                cost_ndeg += _FEWEST_FROM_JOINT_TO_JOINT * RECONFIGURATION_NDEG
        least_ndeg.append(cost_ndeg)
    return least_ndeg


def _continued(sequence: Sequence[PlannedRotation]) -> tuple[PlannedRotation, ...]:
    """Rename the fingers of each rotation, so that it begins with the grasp before it ended."""
    result = [sequence[0]]
    for planned in sequence[1:]:
        before = result[-1]
        ends = _fingers_on_joints(before, last=True)
        begins = _fingers_on_joints(planned, last=False)
        order = [0, 0, 0]
        for mine, theirs in zip(ends, begins, strict=True):
            order[mine] = theirs
        result.append(planned.renamed((order[0], order[1], order[2])))
    return tuple(result)


def _fingers_on_joints(planned: PlannedRotation, *, last: bool) -> tuple[int, int, int]:
    """Return which fingers are on joint I, on joint J, and free, at an end of a rotation."""
    lattice = planned.lattice
    state = planned.states[-1 if last else 0]
    tracks = state[:3]
    on_i, on_j = (
        int(np.flatnonzero(tracks == lattice.track_at(phase, int(state[3])))[0])
        for phase in (0.0, planned.curve.phase_of_joint_j)
    )
    return on_i, on_j, 3 - on_i - on_j


def _advice(problem: Problem, start: StartGrasp | None) -> str:
    """Return what else a request may ask for."""
    advice = ['a smaller step', 'more friction']
    if problem.rules is not None and problem.law.stick_uN > 0.0:
        advice.append('less margin')
    if start is not None:
        advice.append('a free start')
    return ', '.join(advice[:-1]) + f' or {advice[-1]}'


def _spoken(part: PlanarRotation | None) -> str:
    """Return a rotation in words."""
    if part is None:
        return 'none'
    return f'{np.degrees(part.angle_rad):g} deg about {part.axis}'
