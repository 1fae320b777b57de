# SPDX-License-Identifier: Apache-2.0
"""Messages to values and back: the one file that converts between SI and µm, µN.

Quaternions are ``x y z w`` in messages and ``w x y z`` in the core.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from microhand_msgs_py.msg import Plan as PlanMsg
from microhand_msgs_py.msg import PlanOptions, PlanStep, RotationStatistics

from microhand_planner.core.errors import BadRequest, InvalidPlan, InvalidRotation
from microhand_planner.core.hold import Hold
from microhand_planner.core.parameters import (
    ContactLaw,
    Finger,
    GripRules,
    Mode,
    SearchOptions,
    firmest_first,
)
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
DEG_PER_RAD = math.degrees(1.0)

KINDS = {
    PlanStep.APPROACH: StepKind.APPROACH,
    PlanStep.ROLL: StepKind.ROLL,
    PlanStep.PLACE: StepKind.PLACE,
    PlanStep.REMOVE: StepKind.REMOVE,
    PlanStep.TRANSLATE: StepKind.TRANSLATE,
    PlanStep.GRIP: StepKind.GRIP,
}
KIND_NUMBERS = {kind: number for number, kind in KINDS.items()}
MODES = {PlanOptions.MODE_ROBUST: Mode.ROBUST, PlanOptions.MODE_PAPER: Mode.PAPER}
MODE_NUMBERS = {mode: number for number, mode in MODES.items()}
AXES = {'x': (1.0, 0.0, 0.0), 'y': (0.0, 1.0, 0.0), 'z': (0.0, 0.0, 1.0)}


def um_from_m(metres: npt.ArrayLike) -> FloatArray:
    """Convert lengths or velocities, of any shape."""
    return np.asarray(metres, dtype=np.float64) * UM_PER_M


def m_from_um(micrometres: npt.ArrayLike) -> FloatArray:
    """Convert lengths or velocities, of any shape."""
    return np.asarray(micrometres, dtype=np.float64) / UM_PER_M


def um_from_point(point: Point | Vector3) -> FloatArray:
    """Return a point or vector [m] as (3,) µm."""
    return um_from_m([point.x, point.y, point.z])


def point_from_um(position_um: FloatArray) -> Point:
    """Return (3,) µm as a point [m]."""
    x, y, z = m_from_um(position_um).tolist()
    return Point(x=x, y=y, z=z)


def pose_from_msg(message: PoseMsg) -> Pose:
    """Return the pose of an object.

    Raises
    ------
    InvalidNumber, InvalidRotation
        NaN, infinity, or a quaternion of zero length.
    """
    q = message.orientation
    return Pose(um_from_point(message.position), (q.w, q.x, q.y, q.z))


def pose_to_msg(pose: Pose) -> PoseMsg:
    """Return the message of a pose."""
    w, x, y, z = (float(value) for value in pose.quaternion_wxyz)
    return PoseMsg(
        position=point_from_um(np.asarray(pose.position_um)),
        orientation=Quaternion(x=x, y=y, z=z, w=w),
    )


def tips_from_msg(points: Sequence[Point]) -> FloatArray | None:
    """Return the tip centres that hold an object, (3, 3) [µm]; NaN: free; None: not given.

    Raises
    ------
    BadRequest
        Neither no point nor one for each finger.
    """
    if not points:
        return None
    if len(points) != FINGERS:
        raise BadRequest('start_tips', f'{len(points)} points', f'none, or {FINGERS}')
    return np.stack([um_from_point(point) for point in points])


def options_from_msg(message: PlanOptions) -> tuple[Finger, ContactLaw, SearchOptions]:
    """Return what the planner is told; 0 means the default of `parameters`.

    Raises
    ------
    InvalidNumber, InvalidParameter, BadRequest
        A number outside its range, or a mode that does not exist.
    """
    if message.mode not in MODES:
        raise BadRequest('mode', message.mode, '0 (robust) or 1 (paper)')
    law, finger, options = ContactLaw(), Finger(), SearchOptions()
    return (
        Finger(
            radius_um=_scaled(message.finger_radius, UM_PER_M) or finger.radius_um,
            clearance_um=_scaled(message.clearance, UM_PER_M) or finger.clearance_um,
        ),
        ContactLaw(
            friction=message.friction or law.friction,
            pull_off_uN=_scaled(message.pull_off_force, UN_PER_N) or law.pull_off_uN,
            max_force_uN=_scaled(message.max_force, UN_PER_N) or law.max_force_uN,
            adhesion=not message.no_adhesion,
        ),
        SearchOptions(
            step_rad=message.step or options.step_rad,
            mode=MODES[message.mode],
            time_limit_s=message.time_limit or None,
        ),
    )


def rules_from_msg(message: PlanOptions) -> tuple[GripRules, ...]:
    """Return the margins that a plan shall keep, one of several; 0 means the default.

    Raises
    ------
    InvalidNumber, InvalidParameter
        A number outside its range.
    """
    rules = GripRules()
    asked = GripRules(
        margin_factor=message.margin_factor or rules.margin_factor,
        roll_factor=message.roll_factor or rules.roll_factor,
        least_margin_uN=_scaled(message.least_margin, UN_PER_N) or rules.least_margin_uN,
        nominal_grip_uN=_scaled(message.nominal_grip, UN_PER_N) or rules.nominal_grip_uN,
        grip_tolerance_uN=_scaled(message.grip_tolerance, UN_PER_N) or rules.grip_tolerance_uN,
    )
    return (asked,) if message.grip_tolerance else firmest_first(asked)


def _scaled(value: float, factor: float) -> float:
    """Return a number in the core's unit, with the decimals that it had before it was sent."""
    return round(value * factor, 9)


def options_to_msg(
    finger: Finger, law: ContactLaw, options: SearchOptions, rules: GripRules | Sequence[GripRules]
) -> PlanOptions:
    """Return the message of what the planner was told, or is; several rules: by default."""
    asked = rules if isinstance(rules, GripRules) else rules[0]
    return PlanOptions(
        mode=MODE_NUMBERS[options.mode],
        step=options.step_rad,
        friction=law.friction,
        pull_off_force=law.pull_off_uN / UN_PER_N,
        no_adhesion=not law.adhesion,
        max_force=law.max_force_uN / UN_PER_N,
        finger_radius=finger.radius_um / UM_PER_M,
        clearance=finger.clearance_um / UM_PER_M,
        time_limit=options.time_limit_s or 0.0,
        margin_factor=asked.margin_factor,
        roll_factor=asked.roll_factor,
        least_margin=asked.least_margin_uN / UN_PER_N,
        nominal_grip=asked.nominal_grip_uN / UN_PER_N,
        grip_tolerance=asked.grip_tolerance_uN / UN_PER_N if asked is rules else 0.0,
    )


def plan_to_msg(plan: Plan, frame_id: str = 'station') -> PlanMsg:
    """Return the message of a plan, with its hash; the stamp is left to the sender."""
    message = PlanMsg(
        format_version=FORMAT_VERSION,
        plan_hash=plan_hash(plan),
        object_name=plan.object_name,
        object_hash=plan.object_sha256,
        start_pose=pose_to_msg(plan.start),
        goal_pose=pose_to_msg(plan.goal),
        options=options_to_msg(plan.finger, plan.law, plan.options, plan.rules),
        steps=[_step_to_msg(step) for step in plan.steps],
        rotations=[_rotation_to_msg(rotation) for rotation in plan.rotations],
        cost=math.radians(plan.cost_deg),
        reconfigurations=plan.reconfigurations,
    )
    message.header.frame_id = frame_id
    return message


def plan_from_msg(message: PlanMsg) -> Plan:
    """Return the plan of a message, checked against its hash if it has one.

    Raises
    ------
    InvalidPlan
        Another format version, arrays that do not fit together, numbers that are not finite,
        an unknown kind of step, or a hash that does not match.
    BadRequest
        Poses or options that are not allowed.
    """
    version = message.format_version
    if version.split('.')[0] != FORMAT_VERSION.split('.')[0]:
        raise InvalidPlan('format_version', repr(version), f'{FORMAT_VERSION.split(".")[0]}.x')
    finger, law, options = options_from_msg(message.options)
    plan = Plan(
        object_name=message.object_name,
        object_sha256=message.object_hash,
        start=pose_from_msg(message.start_pose),
        goal=pose_from_msg(message.goal_pose),
        finger=finger,
        law=law,
        options=options,
        rules=rules_from_msg(message.options)[-1],
        steps=tuple(_step_from_msg(i, step) for i, step in enumerate(message.steps)),
        rotations=tuple(_rotation_from_msg(rotation) for rotation in message.rotations),
    )
    if message.plan_hash and message.plan_hash != plan_hash(plan):
        raise InvalidPlan('plan_hash', message.plan_hash, f'{plan_hash(plan)} for these steps')
    return plan


def _step_to_msg(step: Step) -> PlanStep:
    """Return the message of a step."""
    w, x, y, z = step.object_quaternion_wxyz.T
    return PlanStep(
        kind=KIND_NUMBERS[step.kind],
        rotation=step.rotation,
        finger=step.finger,
        angle=step.angle_rad,
        in_contact=list(step.in_contact),
        object_positions=m_from_um(step.object_position_um).ravel(),
        object_orientations=np.stack([x, y, z, w], axis=1).ravel(),
        tip_positions=m_from_um(step.tip_um).ravel(),
        contact_normals=step.normal.ravel(),
        contact_forces=(step.force_uN / UN_PER_N).ravel(),
        **_hold_to_fields(step.hold),
    )


def _step_from_msg(number: int, message: PlanStep) -> Step:
    """Return the step of a message."""
    if message.kind not in KINDS:
        raise InvalidPlan(f'step {number}: kind', message.kind, f'0 to {max(KINDS)}')
    first, second, third = message.in_contact
    quaternion = _rows(number, 'object_orientations', message.object_orientations, (4,))
    return Step(
        kind=KINDS[message.kind],
        rotation=message.rotation,
        finger=message.finger,
        angle_rad=message.angle,
        in_contact=(bool(first), bool(second), bool(third)),
        object_position_um=um_from_m(
            _rows(number, 'object_positions', message.object_positions, (3,))
        ),
        object_quaternion_wxyz=quaternion[:, [3, 0, 1, 2]],
        tip_um=um_from_m(_rows(number, 'tip_positions', message.tip_positions, (FINGERS, 3))),
        normal=_rows(number, 'contact_normals', message.contact_normals, (FINGERS, 3)),
        force_uN=UN_PER_N * _rows(number, 'contact_forces', message.contact_forces, (FINGERS, 3)),
        hold=_hold_from_msg(message),
    )


def _hold_to_fields(hold: Hold | None) -> dict[str, float]:
    """Return the fields of a step that tell how firmly it holds."""
    if hold is None:
        return dict.fromkeys(('grip', 'grip_low', 'grip_high', 'margin'), math.nan)
    return {
        'grip': hold.grip_uN / UN_PER_N,
        'grip_low': hold.low_uN / UN_PER_N,
        'grip_high': hold.high_uN / UN_PER_N,
        'margin': hold.margin_uN / UN_PER_N,
    }


def _hold_from_msg(message: PlanStep) -> Hold | None:
    """Return how firmly a step holds; None: not planned."""
    values = (message.grip, message.grip_low, message.grip_high, message.margin)
    if all(math.isnan(value) for value in values):
        return None
    return Hold(*(_scaled(value, UN_PER_N) for value in values))


def _rows(number: int, field: str, flat: npt.ArrayLike, row: tuple[int, ...]) -> FloatArray:
    """Return a flat array of a message as an array of rows."""
    values = np.array(flat, dtype=np.float64)
    if values.size % math.prod(row):
        raise InvalidPlan(
            f'step {number}: {field}',
            f'of length {values.size}',
            f'a multiple of {math.prod(row)}',
        )
    return values.reshape(-1, *row)


def _rotation_to_msg(rotation: RotationReport) -> RotationStatistics:
    """Return the message of how a rotation was found."""
    x, y, z = AXES[rotation.axis]
    return RotationStatistics(
        axis=Vector3(x=x, y=y, z=z),
        angle=math.radians(rotation.angle_deg),
        cost=math.radians(rotation.cost_deg),
        reconfigurations=rotation.reconfigurations,
        expanded=rotation.expanded,
        waiting=rotation.waiting,
        time=rotation.time_s,
    )


def _rotation_from_msg(message: RotationStatistics) -> RotationReport:
    """Return how a rotation was found."""
    axis = (message.axis.x, message.axis.y, message.axis.z)
    names = [name for name, unit in AXES.items() if unit == axis]
    if not names:
        raise InvalidRotation('rotation axis', axis, 'x, y or z of the object')
    return RotationReport(
        axis=names[0],
        angle_deg=_scaled(message.angle, DEG_PER_RAD),
        cost_deg=_scaled(message.cost, DEG_PER_RAD),
        reconfigurations=message.reconfigurations,
        expanded=message.expanded,
        waiting=message.waiting,
        time_s=message.time,
    )
