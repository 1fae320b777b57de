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
from microhand_planner.core.errors import NoPlanExists
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.planned_rotation import (
    PlannedRotation,
    Problem,
    Role,
    plan_planar_rotation,
)
from microhand_planner.core.search_result import NO_BOUND
from microhand_planner.core.search_state import NDEG

Decomposition = Sequence[PlanarRotation]


def cheapest_sequence(
    decompositions: Sequence[Decomposition],
    curves: Mapping[str, OffsetCurve],
    problem: Problem,
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
    solved: dict[tuple[PlanarRotation, Role], tuple[PlannedRotation | None, int]] = {}
    failed: PlanarRotation | None = None
    expanded = 0

    def solve(part: PlanarRotation, role: Role, bound_ndeg: int) -> PlannedRotation | None:
        """Solve each planar problem once, unless an earlier bound was tighter."""
        nonlocal expanded
        planned, below_ndeg = solved.get((part, role), (None, -1))
        if planned is None and below_ndeg < bound_ndeg:
            planned, effort = plan_planar_rotation(
                part, role, curves[part.axis], problem, bound_ndeg
            )
            expanded += effort
            solved[part, role] = (planned, bound_ndeg)
        return planned if planned is not None and planned.cost_ndeg < bound_ndeg else None

    for parts in sorted(decompositions, key=_least_cost_ndeg):
        left_ndeg = _least_cost_ndeg(parts)
        if left_ndeg >= best_ndeg:
            break
        sequence: list[PlannedRotation] = []
        spent_ndeg = 0
        for part, role in zip(parts, _roles(len(parts)), strict=True):
            left_ndeg -= _least_cost_ndeg([part])
            bound_ndeg = best_ndeg - spent_ndeg - left_ndeg
            planned = solve(part, role, bound_ndeg) if bound_ndeg > 0 else None
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
            f'object to the goal (last tried: {_spoken(failed)}); a smaller step, more friction '
            'or a free start may help',
            expanded,
        )
    return _continued(best)


def _roles(rotations: int) -> list[Role]:
    """Return the role of each rotation of a sequence."""
    if rotations == 1:
        return [Role.ONLY]
    return [Role.FIRST, *[Role.MIDDLE] * (rotations - 2), Role.LAST]


def _least_cost_ndeg(parts: Decomposition) -> int:
    """Return what two rolling fingers cost: no motion is cheaper."""
    return sum(round(2.0 * abs(np.degrees(part.angle_rad)) * NDEG) for part in parts)


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


def _spoken(part: PlanarRotation | None) -> str:
    """Return a rotation in words."""
    if part is None:
        return 'none'
    return f'{np.degrees(part.angle_rad):g} deg about {part.axis}'
