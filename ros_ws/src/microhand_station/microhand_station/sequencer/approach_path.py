# SPDX-License-Identifier: Apache-2.0
"""The way to where a plan begins: one finger after another, around the object."""

from __future__ import annotations

import itertools
import math

import numpy as np

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.plan import FINGERS, Plan, Step, StepKind
from microhand_planner.core.pose import FloatArray

NOT_ALLOWED = 308
ARC_STEP_RAD = math.radians(5.0)
"""Waypoints on the way around the object are this far apart."""
ALREADY_THERE_UM = 1e-3
"""A finger that is this near to its start does not move [µm]."""


def way_to_start(tip_um: FloatArray, plan: Plan) -> tuple[Step, ...]:
    """Find a way from the present tips to the first waypoint of a plan.

    One finger moves at a time, in the first of the six orders that works: straight if the chord
    keeps away from the object, else out, around it on an arc, and in. The plan begins with its
    fingers where they cannot touch the object; that distance from its origin is kept.

    Parameters
    ----------
    tip_um : (3, 3) float
        Tip centres of fingers 1, 2, 3, station frame [µm].
    plan : Plan
        Where to go; its object is at the start pose.

    Returns
    -------
    tuple of Step
        One per finger that has to move; the plan's first step fits on.

    Raises
    ------
    RunFailed
        No order keeps the tips apart; the message names the nearest pair.
    """
    goal = plan.steps[0].tip_um[0]
    centre = np.asarray(plan.start.position_um)
    keep_um = float(np.linalg.norm(goal - centre, axis=1).min())
    moving = [f for f in range(FINGERS) if np.linalg.norm(goal[f] - tip_um[f]) > ALREADY_THERE_UM]
    ways = {f: centre + _around(tip_um[f] - centre, goal[f] - centre, keep_um) for f in moving}
    nearest_um, pair = -math.inf, (0, 0)
    for order in itertools.permutations(moving):
        steps, distance_um, closest = _in_order(order, ways, tip_um, plan)
        if distance_um >= plan.finger.min_distance_um:
            return steps
        if distance_um > nearest_um:
            nearest_um, pair = distance_um, closest
    raise RunFailed(
        f'no safe way to the start of the plan: fingers {pair[0] + 1} and {pair[1] + 1} would '
        f'come as near as {nearest_um:.2f} µm; allowed: >= {plan.finger.min_distance_um:g} µm. '
        'Home the stages first',
        NOT_ALLOWED,
    )


def _around(start: FloatArray, goal: FloatArray, keep_um: float) -> FloatArray:
    """Return waypoints (n, 3) between two points, relative to the object's origin.

    Straight if the chord is nowhere nearer to the origin than `keep_um`.
    """
    chord = goal - start
    share = np.clip(-float(start @ chord) / max(float(chord @ chord), 1e-30), 0.0, 1.0)
    passes_at_um = float(np.linalg.norm(start + share * chord))
    if passes_at_um >= keep_um - ALREADY_THERE_UM:
        return np.stack([start, goal])
    radius = max(keep_um, float(np.linalg.norm(start)), float(np.linalg.norm(goal)))
    u = _unit(start, fallback=-goal)
    v = _unit(goal, fallback=-u)
    angle = math.atan2(float(np.linalg.norm(np.cross(u, v))), float(u @ v))
    # opposite sides: any great circle will do; the one through the axis furthest from u
    across = v - (u @ v) * u
    if np.linalg.norm(across) < 1e-9:
        axis = np.eye(3)[np.argmin(np.abs(u))]
        across = axis - (u @ axis) * u
    across /= np.linalg.norm(across)
    turn = np.linspace(0.0, angle, max(2, math.ceil(angle / ARC_STEP_RAD) + 1))[:, None]
    arc = radius * (np.cos(turn) * u + np.sin(turn) * across)
    return np.concatenate([[start], arc, [goal]])


def _unit(vector: FloatArray, fallback: FloatArray) -> FloatArray:
    """Return the direction of a vector, or of another one if it has none."""
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        return fallback / float(np.linalg.norm(fallback))
    return vector / length


def _in_order(
    order: tuple[int, ...], ways: dict[int, FloatArray], tip_um: FloatArray, plan: Plan
) -> tuple[tuple[Step, ...], float, tuple[int, int]]:
    """Move the fingers one after another; return the steps and the nearest pair of tips."""
    tips = np.array(tip_um)
    steps = []
    nearest_um, pair = math.inf, (0, 0)
    for finger in order:
        way = ways[finger]
        for other in set(range(FINGERS)) - {finger}:
            distance_um = _distance_to_polyline_um(tips[other], way)
            if distance_um < nearest_um:
                nearest_um, pair = distance_um, (finger, other)
        waypoints = np.tile(tips, (len(way), 1, 1))
        waypoints[:, finger] = way
        tips[finger] = way[-1]
        steps.append(_step(finger, waypoints, plan))
    return tuple(steps), nearest_um, pair


def _distance_to_polyline_um(point: FloatArray, line: FloatArray) -> float:
    """Return the distance of a point to a polyline (n, 3)."""
    a, chord = line[:-1], np.diff(line, axis=0)
    length2 = np.maximum(np.sum(chord**2, axis=1), 1e-30)
    share = np.clip(np.sum((point - a) * chord, axis=1) / length2, 0.0, 1.0)
    return float(np.linalg.norm(point - a - share[:, None] * chord, axis=1).min())


def _step(finger: int, tip_um: FloatArray, plan: Plan) -> Step:
    """Return a step in which one finger travels and the object stays where the plan has it."""
    n = len(tip_um)
    return Step(
        kind=StepKind.APPROACH,
        rotation=0,
        finger=finger + 1,
        angle_rad=0.0,
        in_contact=(False, False, False),
        object_position_um=np.tile(plan.start.position_um, (n, 1)),
        object_quaternion_wxyz=np.tile(plan.start.quaternion_wxyz, (n, 1)),
        tip_um=tip_um,
        normal=np.full((n, FINGERS, 3), np.nan),
    )
