# SPDX-License-Identifier: Apache-2.0
"""Plans as JSON, and the hash by which two plans are the same.

Layout 2.x: one object with the fields of `Plan`; lengths in µm, forces in µN, angles in degrees,
quaternions w x y z, NaN as null. Readers refuse another major version.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from microhand_planner.core.errors import BadRequest, InvalidPlan, MicrohandError
from microhand_planner.core.hold import Hold
from microhand_planner.core.parameters import (
    ContactLaw,
    Finger,
    GripRules,
    Mode,
    SearchOptions,
)
from microhand_planner.core.plan import (
    FORCE_DIGITS,
    FORMAT_VERSION,
    Plan,
    RotationReport,
    Step,
    StepKind,
)
from microhand_planner.core.pose import LENGTH_DIGITS, FloatArray, Pose

_DIRECTION_DIGITS = 12
_SCALAR_DIGITS = 9


def plan_hash(plan: Plan) -> str:
    """Return the sha256 of everything in a plan but the time and effort that it took.

    Lengths enter as whole picometres and numbers rounded, so that a plan keeps its hash on the
    way through a file, or through the metres of a message.
    """
    digest = hashlib.sha256()

    def add_text(*values: object) -> None:
        digest.update(json.dumps(values).encode())

    def add_numbers(values: FloatArray, digits: int) -> None:
        whole = np.nan_to_num(np.round(np.asarray(values) * 10.0**digits), nan=np.iinfo('i8').min)
        digest.update(whole.astype('<i8').tobytes())

    def rounded(*values: float) -> list[str]:
        return [f'{value:.{_SCALAR_DIGITS}g}' for value in values]

    finger, law, options = plan.finger, plan.law, plan.options
    add_text(FORMAT_VERSION, plan.object_name, plan.object_sha256, options.mode.value)
    add_text(law.adhesion, rounded(law.friction, law.pull_off_uN, law.max_force_uN))
    add_text(rounded(finger.radius_um, finger.clearance_um, math.degrees(options.step_rad)))
    add_text(rounded(*vars(plan.rules).values()))
    for pose in (plan.start, plan.goal):
        add_numbers(np.asarray(pose.position_um), LENGTH_DIGITS)
        add_numbers(np.asarray(pose.quaternion_wxyz), _DIRECTION_DIGITS)
    for rotation in plan.rotations:
        add_text(rotation.axis, rotation.reconfigurations)
        add_text(rounded(rotation.angle_deg, rotation.cost_deg))
    for step in plan.steps:
        add_text(step.kind.value, step.rotation, step.finger, step.in_contact)
        add_text(rounded(step.angle_rad), len(step))
        add_numbers(step.object_position_um, LENGTH_DIGITS)
        add_numbers(step.tip_um, LENGTH_DIGITS)
        add_numbers(step.object_quaternion_wxyz, _DIRECTION_DIGITS)
        add_numbers(step.normal, _DIRECTION_DIGITS)
        add_numbers(step.force_uN, FORCE_DIGITS)
        add_text(None if step.hold is None else rounded(*vars(step.hold).values()))
    return digest.hexdigest()


def plan_to_dict(plan: Plan) -> dict[str, Any]:
    """Return a plan as plain values, ready for JSON."""
    return {
        'format_version': FORMAT_VERSION,
        'plan_hash': plan_hash(plan),
        'object': {'name': plan.object_name, 'sha256': plan.object_sha256},
        'start': _pose_to_dict(plan.start),
        'goal': _pose_to_dict(plan.goal),
        'finger': {
            'radius_um': plan.finger.radius_um,
            'clearance_um': plan.finger.clearance_um,
        },
        'law': {
            'friction': plan.law.friction,
            'pull_off_uN': plan.law.pull_off_uN,
            'max_force_uN': plan.law.max_force_uN,
            'adhesion': plan.law.adhesion,
        },
        'options': {
            'step_deg': math.degrees(plan.options.step_rad),
            'mode': plan.options.mode.value,
            'time_limit_s': plan.options.time_limit_s,
        },
        'rules': dict(vars(plan.rules)),
        'rotations': [vars(rotation) for rotation in plan.rotations],
        'steps': [_step_to_dict(step) for step in plan.steps],
    }


def plan_from_dict(content: dict[str, Any]) -> Plan:
    """Return the plan that plain values describe.

    Raises
    ------
    InvalidPlan
        Another major version, missing fields, wrong types or shapes, or a hash that does not fit.
    BadRequest
        Numbers that no plan may have.
    """
    version = str(content.get('format_version', 'missing'))
    if version.split('.')[0] != FORMAT_VERSION.split('.')[0]:
        raise InvalidPlan('format_version', version, f'{FORMAT_VERSION} or a later 2.x')
    try:
        plan = Plan(
            object_name=str(content['object']['name']),
            object_sha256=str(content['object']['sha256']),
            start=_pose_from_dict(content['start']),
            goal=_pose_from_dict(content['goal']),
            finger=Finger(**content['finger']),
            law=ContactLaw(**content['law']),
            options=SearchOptions(
                step_rad=math.radians(content['options']['step_deg']),
                mode=Mode(content['options']['mode']),
                time_limit_s=content['options']['time_limit_s'],
            ),
            rules=GripRules(**content['rules']),
            steps=tuple(_step_from_dict(step) for step in content['steps']),
            rotations=tuple(_rotation_from_dict(rotation) for rotation in content['rotations']),
        )
        found = plan_hash(plan)
    except MicrohandError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        why = ' '.join(f'{type(error).__name__}: {error}'.split())
        raise InvalidPlan('plan', f'not readable ({why})', 'the fields of layout 2.x') from error
    if content.get('plan_hash') != found:
        raise InvalidPlan(
            'plan_hash', content.get('plan_hash'), f'{found}, the hash of what the file holds'
        )
    return plan


def write_plan(plan: Plan, path: Path) -> None:
    """Write a plan to a JSON file.

    Raises
    ------
    BadRequest
        The file cannot be written.
    """
    try:
        path.write_text(json.dumps(plan_to_dict(plan), allow_nan=False) + '\n', encoding='utf-8')
    except OSError as error:
        raise BadRequest('output', f'{path} ({error.strerror})', 'a writable file') from error


def read_plan(path: Path) -> Plan:
    """Read a plan from a JSON file.

    Raises
    ------
    BadRequest
        The file cannot be read.
    InvalidPlan
        It holds no plan of a known version, or one that was changed; see `plan_from_dict`.
    """
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise BadRequest('plan', f'{path} ({error.strerror})', 'a readable plan file') from error
    except (ValueError, RecursionError) as error:
        raise InvalidPlan('plan', f'{path}: {error}', 'a JSON file of microhand') from error
    if not isinstance(content, dict):
        raise InvalidPlan('plan', f'{path}: {type(content).__name__}', 'a JSON object')
    return plan_from_dict(content)


def _pose_to_dict(pose: Pose) -> dict[str, Any]:
    return {
        'position_um': list(map(float, pose.position_um)),
        'quaternion_wxyz': list(map(float, pose.quaternion_wxyz)),
    }


def _pose_from_dict(content: dict[str, Any]) -> Pose:
    return Pose(content['position_um'], content['quaternion_wxyz'])


def _rotation_from_dict(content: dict[str, Any]) -> RotationReport:
    return RotationReport(
        axis=str(content['axis']),
        angle_deg=float(content['angle_deg']),
        cost_deg=float(content['cost_deg']),
        reconfigurations=int(content['reconfigurations']),
        expanded=int(content['expanded']),
        waiting=int(content['waiting']),
        time_s=float(content['time_s']),
    )


def _step_to_dict(step: Step) -> dict[str, Any]:
    normals = step.normal.astype(object)
    normals[np.isnan(step.normal)] = None
    return {
        'kind': step.kind.value,
        'rotation': step.rotation,
        'finger': step.finger,
        'angle_deg': math.degrees(step.angle_rad),
        'in_contact': list(step.in_contact),
        'object_position_um': step.object_position_um.tolist(),
        'object_quaternion_wxyz': step.object_quaternion_wxyz.tolist(),
        'tip_um': step.tip_um.tolist(),
        'normal': normals.tolist(),
        'force_uN': step.force_uN.tolist(),
        'hold': None if step.hold is None else dict(vars(step.hold)),
    }


def _step_from_dict(content: dict[str, Any]) -> Step:
    first, second, third = content['in_contact']
    return Step(
        kind=StepKind(content['kind']),
        rotation=int(content['rotation']),
        finger=int(content['finger']),
        angle_rad=math.radians(content['angle_deg']),
        in_contact=(bool(first), bool(second), bool(third)),
        object_position_um=np.array(content['object_position_um'], dtype=np.float64),
        object_quaternion_wxyz=np.array(content['object_quaternion_wxyz'], dtype=np.float64),
        tip_um=np.array(content['tip_um'], dtype=np.float64),
        normal=np.array(content['normal'], dtype=np.float64),
        force_uN=np.array(content['force_uN'], dtype=np.float64),
        hold=None if content['hold'] is None else Hold(**content['hold']),
    )
