# SPDX-License-Identifier: Apache-2.0
"""The way to where a plan begins: one finger after another, around the object."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

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
    keeps away from the object, else around it on arcs. The plan begins with its fingers where they
    cannot touch the object; that distance from its origin is kept.

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
    ways = {
        f: [centre + way for way in _ways(tip_um[f] - centre, goal[f] - centre, keep_um)]
        for f in moving
    }
    best = _Try((), -math.inf, (0, 0))
    for order in itertools.permutations(moving):
        found = _in_order(order, ways, tip_um, plan)
        if found.nearest_um >= plan.finger.min_distance_um:
            return found.steps
        best = max(best, found, key=lambda one: one.nearest_um)
    raise RunFailed(
        f'no safe way to the start of the plan: fingers {best.pair[0] + 1} and {best.pair[1] + 1} '
        f'would come as near as {best.nearest_um:.2f} µm; '
        f'allowed: >= {plan.finger.min_distance_um:g} µm. Home the stages first',
        NOT_ALLOWED,
    )


@dataclass(frozen=True)
class _Try:
    """What one order of the fingers gives: the steps, and the nearest pair of tips."""

    steps: tuple[Step, ...]
    nearest_um: float
    pair: tuple[int, int]


def _ways(start: FloatArray, goal: FloatArray, keep_um: float) -> Iterator[FloatArray]:
    """Return ways (n, 3) between two points around the origin, the shortest ones first.

    Straight if the chord keeps the distance; else along the sphere of the goal or that of the
    start, directly or by way of one of its poles.
    """
    chord = goal - start
    share = np.clip(-float(start @ chord) / max(float(chord @ chord), 1e-30), 0.0, 1.0)
    if float(np.linalg.norm(start + share * chord)) >= keep_um - ALREADY_THERE_UM:
        yield np.stack([start, goal])
    first = _unit(start, fallback=-goal)
    last = _unit(goal, fallback=-first)
    arcs = [_arc(first, last)]
    for pole in np.concatenate([np.eye(3), -np.eye(3)]):
        arcs.append(np.concatenate([_arc(first, pole), _arc(pole, last)]))
    inner_um = max(keep_um, float(np.linalg.norm(goal)))
    outer_um = max(inner_um, float(np.linalg.norm(start)))
    for arc in arcs:
        for radius_um in dict.fromkeys((inner_um, outer_um)):
            yield np.concatenate([[start], radius_um * arc, [goal]])


def _arc(u: FloatArray, v: FloatArray) -> FloatArray:
    """Return directions (n, 3) on the great circle from one direction to another."""
    angle = math.atan2(float(np.linalg.norm(np.cross(u, v))), float(u @ v))
    across = v - (u @ v) * u
    # opposite sides: any great circle will do; the one through the axis furthest from u
    if np.linalg.norm(across) < 1e-9:
        axis = np.eye(3)[np.argmin(np.abs(u))]
        across = axis - (u @ axis) * u
    across /= np.linalg.norm(across)
    turn = np.linspace(0.0, angle, max(2, math.ceil(angle / ARC_STEP_RAD) + 1))[:, None]
    return np.asarray(np.cos(turn) * u + np.sin(turn) * across)


def _unit(vector: FloatArray, fallback: FloatArray) -> FloatArray:
    """Return the direction of a vector, or of another one if it has none."""
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        return fallback / float(np.linalg.norm(fallback))
    return vector / length


def _in_order(
    order: tuple[int, ...], ways: dict[int, list[FloatArray]], tip_um: FloatArray, plan: Plan
) -> _Try:
    """Move the fingers one after another, each on the first of its ways that is free."""
    tips = np.array(tip_um)
    steps = []
    nearest_um, pair = math.inf, (0, 0)
    for finger in order:
        best_um, best_way, best_other = -math.inf, ways[finger][0], finger
        for way in ways[finger]:
            apart = {
                other: _distance_to_polyline_um(tips[other], way)
                for other in range(FINGERS)
                if other != finger
            }
            other = min(apart, key=lambda one: apart[one])
            if apart[other] > best_um:
                best_um, best_way, best_other = apart[other], way, other
            if best_um >= plan.finger.min_distance_um:
                break
        if best_um < nearest_um:
            nearest_um, pair = best_um, (finger, best_other)
        waypoints = np.tile(tips, (len(best_way), 1, 1))
        waypoints[:, finger] = best_way
        tips[finger] = best_way[-1]
        steps.append(_step(finger, waypoints, plan))
    return _Try(tuple(steps), nearest_um, pair)


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
