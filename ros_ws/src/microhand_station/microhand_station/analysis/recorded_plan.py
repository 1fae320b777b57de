# SPDX-License-Identifier: Apache-2.0
"""The plan in a record → a plan of the core, without ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from microhand_planner.core.errors import InvalidPlan
from microhand_planner.core.hold import Hold
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, Mode, SearchOptions
from microhand_planner.core.plan import (
    FINGERS,
    FORMAT_VERSION,
    Plan,
    RotationReport,
    Step,
    StepKind,
)
from microhand_planner.core.plan_file import plan_hash
from microhand_planner.core.pose import FloatArray, Pose

UM_PER_M = 1e6
UN_PER_N = 1e6
# By the numbers of PlanStep.msg and PlanOptions.msg.
_KINDS = (
    StepKind.APPROACH,
    StepKind.ROLL,
    StepKind.PLACE,
    StepKind.REMOVE,
    StepKind.TRANSLATE,
    StepKind.GRIP,
)
_MODES = (Mode.ROBUST, Mode.PAPER)


def recorded_plan(message: Any) -> Plan:
    """Turn a decoded ``microhand_msgs_py/msg/Plan`` into a plan, checked against its hash.

    Parameters
    ----------
    message : object
        With the fields of the message, SI units.

    Raises
    ------
    InvalidPlan
        Another format version, or a hash that does not fit: damaged, or from another version.
    BadRequest
        Fields that no plan can have.
    """
    major = FORMAT_VERSION.split('.')[0]
    if message.format_version.split('.')[0] != major:
        raise InvalidPlan('format_version', repr(message.format_version), f'{major}.x')
    options = message.options
    plan = Plan(
        object_name=message.object_name,
        object_sha256=message.object_hash,
        start=_pose(message.start_pose),
        goal=_pose(message.goal_pose),
        finger=Finger(
            _scaled(options.finger_radius, UM_PER_M), _scaled(options.clearance, UM_PER_M)
        ),
        law=ContactLaw(
            options.friction,
            _scaled(options.pull_off_force, UN_PER_N),
            _scaled(options.max_force, UN_PER_N),
            adhesion=not options.no_adhesion,
        ),
        options=SearchOptions(
            options.step, _choice('mode', options.mode, _MODES), options.time_limit or None
        ),
        rules=GripRules(
            options.margin_factor,
            options.roll_factor,
            _scaled(options.least_margin, UN_PER_N),
            _scaled(options.nominal_grip, UN_PER_N),
            _scaled(options.grip_tolerance, UN_PER_N),
        ),
        steps=tuple(_step(step) for step in message.steps),
        rotations=tuple(_rotation(rotation) for rotation in message.rotations),
    )
    if message.plan_hash and message.plan_hash != plan_hash(plan):
        raise InvalidPlan('plan_hash', message.plan_hash, plan_hash(plan))
    return plan


def _step(message: Any) -> Step:
    first, second, third = (bool(touches) for touches in message.in_contact)
    hold = (message.grip, message.grip_low, message.grip_high, message.margin)
    return Step(
        kind=_choice('kind', message.kind, _KINDS),
        rotation=message.rotation,
        finger=message.finger,
        angle_rad=message.angle,
        in_contact=(first, second, third),
        object_position_um=UM_PER_M * _rows(message.object_positions, 3),
        object_quaternion_wxyz=_rows(message.object_orientations, 4)[:, [3, 0, 1, 2]],
        tip_um=UM_PER_M * _rows(message.tip_positions, FINGERS, 3),
        normal=_rows(message.contact_normals, FINGERS, 3),
        force_uN=UN_PER_N * _rows(message.contact_forces, FINGERS, 3),
        hold=None
        if all(math.isnan(value) for value in hold)
        else Hold(*(_scaled(value, UN_PER_N) for value in hold)),
    )


def _rotation(message: Any) -> RotationReport:
    axis = (message.axis.x, message.axis.y, message.axis.z)
    degrees = math.degrees(1.0)
    return RotationReport(
        axis='xyz'[int(np.argmax(np.abs(axis)))],
        angle_deg=_scaled(message.angle, degrees),
        cost_deg=_scaled(message.cost, degrees),
        reconfigurations=message.reconfigurations,
        expanded=message.expanded,
        waiting=message.waiting,
        time_s=message.time,
    )


def _pose(message: Any) -> Pose:
    p, q = message.position, message.orientation
    return Pose(UM_PER_M * np.array([p.x, p.y, p.z]), (q.w, q.x, q.y, q.z))


def _rows(flat: Any, *row: int) -> FloatArray:
    values = np.asarray(flat, dtype=np.float64)
    if values.size % math.prod(row):
        raise InvalidPlan('array', f'of length {values.size}', f'a multiple of {math.prod(row)}')
    return values.reshape(-1, *row)


def _choice(field: str, number: int, choices: Sequence[Any]) -> Any:
    if not 0 <= number < len(choices):
        raise InvalidPlan(field, number, f'0 to {len(choices) - 1}')
    return choices[number]


def _scaled(value: float, factor: float) -> float:
    """Return a number in the core's unit, with the decimals that it had before it was sent."""
    return round(value * factor, 9)
