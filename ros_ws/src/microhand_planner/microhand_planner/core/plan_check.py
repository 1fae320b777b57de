# SPDX-License-Identifier: Apache-2.0
"""Plan to verdict: what can be told about a plan without its search and its mesh."""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import InvalidPlan
from microhand_planner.core.parameters import Mode
from microhand_planner.core.plan import FINGERS, Plan, Step, StepKind
from microhand_planner.core.pose import FloatArray, Pose, angle_between_rad

SAME_UM = 1e-3
"""Positions that differ by less are the same [µm]."""
SAME_RAD = 1e-5
"""Angles that differ by less are the same [rad]."""
SLIP_UM = 0.01
"""During a roll, a tip may stray this far from where rolling takes it [µm]."""
OVERLAP_UM = 5e-3
"""Tips may come this much closer than allowed where waypoints cut an arc [µm]."""

MOVES_OBJECT = (StepKind.ROLL, StepKind.TRANSLATE)


class InvalidStep(InvalidPlan):
    """A step that contradicts itself, the step before it, or the laws of rolling.

    Parameters
    ----------
    step : int
        Index of the step, from 0.
    kind : StepKind
        What the step is meant to do.
    field, value, allowed
        As in `BadRequest`.
    """

    def __init__(self, step: int, kind: StepKind, field: str, value: object, allowed: str) -> None:
        super().__init__(f'step {step} ({kind.value}): {field}', value, allowed)
        self.step = step


def check_plan(plan: Plan) -> None:
    """Check a plan step by step.

    It begins at the start pose and ends at the goal pose; each step begins where the one before
    ended; the object moves in rolls and translations only, held by two fingers or three; tips in
    contact roll without slipping or stand still on it; fingers come into contact by steps that
    place them, and leave by steps that remove them; no two tips overlap.

    Parameters
    ----------
    plan : Plan
        Its arrays have been checked when it was built.

    Raises
    ------
    InvalidPlan
        The plan as a whole has no steps, or misses its start or its goal.
    InvalidStep
        Names the first step that fails, and what is wrong with it.
    """
    if not plan.steps:
        raise InvalidPlan('steps', 'empty', 'at least one step')
    first = plan.steps[0]
    _check_pose(
        'start pose',
        plan.start,
        Pose(first.object_position_um[0], first.object_quaternion_wxyz[0]),
    )
    for number, step in enumerate(plan.steps):
        _check_object(number, step)
        _check_touching(number, step, plan.finger.radius_um)
        _check_distances(number, step, plan.finger.min_distance_um)
        if number:
            _check_join(number, plan.steps[number - 1], step)
    # on the lattice of the paper a goal between two multiples of the step is only approximated
    if plan.options.mode is not Mode.PAPER:
        _check_pose('goal pose', plan.goal, plan.reached)


def _check_pose(name: str, stated: Pose, found: Pose) -> None:
    """Compare a pose of the plan with the one that its steps have."""
    gap_um = float(np.linalg.norm(np.subtract(found.position_um, stated.position_um)))
    angle_rad = angle_between_rad(found.rotation, stated.rotation)
    if gap_um > SAME_UM or angle_rad > SAME_RAD:
        raise InvalidPlan(
            name,
            f'{gap_um:.4f} µm and {math.degrees(angle_rad):.4f}° away from the steps',
            'the same pose',
        )


def _check_object(number: int, step: Step) -> None:
    """Check how far the object moves, and that enough fingers hold it."""
    position, orientation = step.object_position_um, _orientation(step)
    turned = (orientation[0].inv() * orientation).magnitude()
    moved_um = np.linalg.norm(position - position[0], axis=1)
    if step.kind is not StepKind.ROLL and turned.max() > SAME_RAD:
        raise _fault(number, step, 'turn of the object', _degrees(turned.max()), '0°')
    if step.kind is not StepKind.TRANSLATE and moved_um.max() > SAME_UM:
        raise _fault(number, step, 'motion of the object', f'{moved_um.max():.4f} µm', '0 µm')
    if step.kind is StepKind.ROLL:
        sweep = (orientation[:-1].inv() * orientation[1:]).magnitude().sum()
        if abs(sweep - abs(step.angle_rad)) > SAME_RAD * len(step):
            raise _fault(
                number, step, 'turn of the object', _degrees(sweep), _degrees(step.angle_rad)
            )
    if step.kind is StepKind.TRANSLATE:
        slip = np.abs(np.diff(step.tip_um, axis=0) - np.diff(position, axis=0)[:, None])
        if slip[:, step.in_contact].max(initial=0.0) > SAME_UM:
            raise _fault(
                number, step, 'motion of a tip in contact', 'not that of the object', 'the same'
            )
    holding = sum(step.in_contact)
    if step.kind is not StepKind.APPROACH and holding < 2:
        raise _fault(number, step, 'fingers that hold the object', holding, 'two or three')


def _check_touching(number: int, step: Step, radius_um: float) -> None:
    """Check that tips in contact keep to the object: no slip, no motion on an object at rest."""
    for finger in np.flatnonzero(step.in_contact):
        tip, normal = step.tip_um[:, finger], step.normal[:, finger]
        name = f'finger {finger + 1}'
        if np.abs(np.linalg.norm(normal, axis=1) - 1.0).max() > 1e-6:
            raise _fault(number, step, f'{name} normal', 'not a unit vector', 'length 1')
        if step.kind is StepKind.ROLL:
            slip_um = _slip_um(step, tip - radius_um * normal, tip)
            if slip_um.max() > SLIP_UM:
                at = int(np.argmax(slip_um))
                raise _fault(
                    number,
                    step,
                    f'slip of {name} at waypoint {at + 1}',
                    f'{slip_um[at]:.4f} µm',
                    f'up to {SLIP_UM} µm',
                )
        elif step.kind is not StepKind.TRANSLATE:
            moved_um = float(np.linalg.norm(tip - tip[0], axis=1).max())
            if moved_um > SAME_UM:
                raise _fault(
                    number, step, f'motion of {name} in contact', f'{moved_um:.4f} µm', '0 µm'
                )


def _slip_um(step: Step, contact_um: FloatArray, tip_um: FloatArray) -> FloatArray:
    """Return how far a tip has strayed from where rolling takes it, from waypoint 1 on.

    A finger that only translates and does not slip moves with the velocity that the object has
    at the contact point p: ``dx = d(rotation) x (p - origin)``, integrated by the trapezoid rule.
    """
    orientation = _orientation(step)
    turn = (orientation[1:] * orientation[:-1].inv()).as_rotvec()
    arm = contact_um - step.object_position_um
    rolled = np.cross(turn, 0.5 * (arm[:-1] + arm[1:]))
    return np.linalg.norm(np.cumsum(np.diff(tip_um, axis=0) - rolled, axis=0), axis=1)


def _check_distances(number: int, step: Step, min_um: float) -> None:
    """Check that tips do not overlap, neither at the waypoints nor on the chords in between."""
    for a, b in itertools.combinations(range(FINGERS), 2):
        apart = step.tip_um[:, a] - step.tip_um[:, b]
        change = np.diff(apart, axis=0)
        length2 = np.maximum(np.sum(change**2, axis=1), 1e-30)
        nearest = np.clip(-np.sum(apart[:-1] * change, axis=1) / length2, 0.0, 1.0)
        distance_um = np.linalg.norm(apart[:-1] + nearest[:, None] * change, axis=1)
        if distance_um.min() < min_um - OVERLAP_UM:
            raise _fault(
                number,
                step,
                f'distance of fingers {a + 1} and {b + 1}',
                f'{distance_um.min():.4f} µm',
                f'>= {min_um:g} µm',
            )


def _check_join(number: int, before: Step, step: Step) -> None:
    """Check that a step begins where the one before ended, with the same fingers in contact."""
    gaps_um = {
        'the object': np.abs(step.object_position_um[0] - before.object_position_um[-1]).max(),
        'a tip': np.abs(step.tip_um[0] - before.tip_um[-1]).max(),
    }
    for name, gap_um in gaps_um.items():
        if gap_um > SAME_UM:
            raise _fault(number, step, f'jump of {name}', f'{gap_um:.4f} µm', '0 µm')
    jump = angle_between_rad(_orientation(before)[-1], _orientation(step)[0])
    if jump > SAME_RAD:
        raise _fault(number, step, 'jump of the object', _degrees(jump), '0°')
    for finger in range(FINGERS):
        was, is_now = before.in_contact[finger], step.in_contact[finger]
        placed = before.kind is StepKind.APPROACH or (
            before.kind is StepKind.PLACE and before.finger == finger + 1
        )
        removed = step.kind is StepKind.REMOVE and step.finger == finger + 1
        if is_now and not was and not placed:
            raise _fault(
                number, step, f'finger {finger + 1}', 'in contact', 'only after it was placed'
            )
        if was and not is_now and not removed:
            raise _fault(
                number, step, f'finger {finger + 1}', 'not in contact', 'only by removing it'
            )


def _orientation(step: Step) -> Rotation:
    """Return the orientations of the object in a step."""
    return Rotation.from_quat(step.object_quaternion_wxyz[:, [1, 2, 3, 0]])


def _degrees(angle_rad: float) -> str:
    """Return an angle as people read it."""
    return f'{math.degrees(angle_rad):.4f}°'


def _fault(number: int, step: Step, field: str, value: object, allowed: str) -> InvalidStep:
    """Return the error for a step."""
    return InvalidStep(number, step.kind, field, value, allowed)
