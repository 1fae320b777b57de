# SPDX-License-Identifier: Apache-2.0
"""Plan a reorientation: from a part and two poses to a plan that fingers can follow."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from microhand_planner.core.decomposition import PlanarRotation, decompositions
from microhand_planner.core.errors import InvalidParameter, InvalidRotation, NoPlan, NoPlanExists
from microhand_planner.core.finger_motions import finger_motions
from microhand_planner.core.grip_forces import GripForces
from microhand_planner.core.interruption import interruption
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.parameters import (
    ROBUST_RULES,
    ContactLaw,
    Finger,
    GripRules,
    Mode,
    SearchOptions,
)
from microhand_planner.core.part import Part
from microhand_planner.core.plan import Plan, RotationReport
from microhand_planner.core.planned_rotation import PlannedRotation, Problem
from microhand_planner.core.pose import FloatArray, Pose, angle_between_rad
from microhand_planner.core.rotation_sequence import cheapest_sequence
from microhand_planner.core.search_state import NDEG
from microhand_planner.core.section_curves import SectionCurves, section_curves
from microhand_planner.core.start_grasp import StartGrasp, start_grasp
from microhand_planner.core.transfer import waiting_radius_um

_SAME_ROTATION_RAD = 1e-9


def plan_reorientation(
    part: Part | SectionCurves,
    start: Pose,
    goal: Pose,
    finger: Finger,
    law: ContactLaw,
    options: SearchOptions,
    rules: GripRules | Sequence[GripRules] = ROBUST_RULES,
    *,
    start_tip_um: FloatArray | None = None,
    decomposition: Sequence[PlanarRotation] | None = None,
    clock: Callable[[], float] = time.monotonic,
    cancelled: Callable[[], bool] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Plan:
    """Plan the cheapest finger motions that bring an object from one pose to another.

    Parameters
    ----------
    part : Part or SectionCurves
        The object; `SectionCurves` of it, when several requests are planned.
    start, goal : Pose
        Object in the station frame. The rotation between them is taken in the object frame:
        ``R_goal = R_start R``.
    finger : Finger
        Tips.
    law : ContactLaw
        Friction and adhesion.
    options : SearchOptions
        Step, mode, time limit.
    rules : GripRules or sequence of GripRules
        Margins that plans in robust mode keep. Of several, the first for which there is a plan;
        the plan tells which.
    start_tip_um : (3, 3) float, optional
        Tip centres of the fingers that hold the object at the start, station frame [µm]; NaN for
        the free finger. By default the planner chooses the first grasp.
    decomposition : sequence of PlanarRotation, optional
        Use these planar rotations; by default the cheapest of all decompositions is chosen.
    clock : callable
        Current time [s].
    cancelled : callable, optional
        Asked during the search; True ends it.
    progress : callable, optional
        Told again and again during the search, in another thread, how many states were expanded.

    Returns
    -------
    Plan
        Reaches the goal orientation exactly; equal requests give equal plans.

    Raises
    ------
    BadRequest
        The part, or the request, cannot be served as it stands.
    NoPlanExists
        Proven: no sequence of grasps reaches the goal, within the steps of the search.
    TimeLimitReached, Cancelled
        The search was cut off.

    Examples
    --------
    >>> from microhand_planner.core.catalogue import find_part
    >>> from scipy.spatial.transform import Rotation
    >>> goal = Pose.of((0, 0, 0), Rotation.from_euler('ZYZ', [80, 220, 100], degrees=True))
    >>> plan = plan_reorientation(
    ...     find_part('ellipsoid'), Pose(), goal, Finger(), ContactLaw(), SearchOptions())
    >>> goal_error_deg(plan) < 1e-6, len(plan.rotations)
    (True, 3)
    """
    geometry = part if isinstance(part, SectionCurves) else section_curves(part, finger)
    turn = start.rotation.inv() * goal.rotation
    if decomposition is None:
        choices = decompositions(turn)
    else:
        choices = (tuple(decomposition),)
        reached = turn.inv()
        for rotation in reversed(choices[0]):
            reached = rotation.rotation * reached
        if reached.magnitude() > _SAME_ROTATION_RAD:
            raise InvalidRotation(
                'decomposition', 'another rotation', 'planar rotations that make up the goal'
            )
    # no rotation at all is a rotation by zero: the object must be grasped all the same
    choices = tuple(choice or (PlanarRotation('z', 0.0),) for choice in choices)
    robust = options.mode is Mode.ROBUST
    wanted = (rules,) if isinstance(rules, GripRules) else tuple(rules)
    held = None
    if start_tip_um is not None:
        held = start_grasp(start_tip_um, start, geometry.curves)
    with interruption(options.time_limit_s, cancelled, clock, progress) as interrupt:
        problem = Problem(finger, law, options, clock, interrupt)
        if robust:
            sequence, kept = _firmest_sequence(choices, geometry.curves, problem, held, wanted)
        else:
            sequence, kept = cheapest_sequence(choices, geometry.curves, problem, held), wanted[-1]

    steps = finger_motions(
        sequence,
        start,
        goal,
        finger,
        GripForces(law, kept, planned=robust),
        waiting_radius_um(geometry.bounding_radius_um, finger),
        geometry.touches,
        held=held is not None,
    )
    return Plan(
        object_name=geometry.part.name,
        object_sha256=geometry.part.sha256,
        start=start,
        goal=goal,
        finger=finger,
        law=law,
        options=options,
        rules=kept,
        steps=steps,
        rotations=tuple(_report(planned) for planned in sequence),
    )


def _firmest_sequence(
    choices: Sequence[Sequence[PlanarRotation]],
    curves: Mapping[str, OffsetCurve],
    problem: Problem,
    held: StartGrasp | None,
    wanted: Sequence[GripRules],
) -> tuple[tuple[PlannedRotation, ...], GripRules]:
    """Return the cheapest sequence by the first of several rules that allow one, and the rules."""
    expanded = 0
    for rules in wanted:
        try:
            return cheapest_sequence(choices, curves, replace(problem, rules=rules), held), rules
        except NoPlan as error:
            error.expanded = expanded = error.expanded + expanded
            if rules is wanted[-1] or not isinstance(error, NoPlanExists):
                raise
    raise InvalidParameter('rules', 'none', 'at least one')


def goal_error_deg(plan: Plan) -> float:
    """Return the angle between the goal and the orientation that the plan reaches [deg]."""
    return float(np.degrees(angle_between_rad(plan.reached.rotation, plan.goal.rotation)))


def _report(planned: PlannedRotation) -> RotationReport:
    """Return the figures of one rotation."""
    return RotationReport(
        axis=planned.part.axis,
        angle_deg=float(np.degrees(planned.part.angle_rad)),
        cost_deg=planned.cost_ndeg / NDEG,
        reconfigurations=planned.reconfigurations,
        expanded=planned.expanded,
        waiting=planned.waiting,
        time_s=planned.time_s,
    )
