# SPDX-License-Identifier: Apache-2.0
"""Plan to verdict: whether the fingers hold, and may let go, at every step."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from microhand_planner.core.equilibrium import can_balance, wrench_of
from microhand_planner.core.parameters import Mode
from microhand_planner.core.plan import FINGERS, Plan, Step, StepKind
from microhand_planner.core.plan_check import InvalidStep
from microhand_planner.core.pose import FloatArray
from microhand_planner.core.spring_response import spring_response_uN

_AXES = {'z': (0.0, 0.0, 1.0), 'y': (0.0, 1.0, 0.0)}
_PRESS_SHARE = 1e-3  # of the largest force: without adhesion, fingers that hold press at least so
_SAME_UN = 5e-3
"""Forces that differ by less are the same: what the facets of a mesh may cost [µN]."""
_PAIR = 2
_ARM_UM = 10.0  # torques are compared as forces at this arm


def check_forces(plan: Plan) -> None:
    """Check that the fingers of a plan hold the object, and let go of it, without slipping.

    Without adhesion, the fingers in contact must be able to hold by pressing at every waypoint.
    With adhesion they always hold ([Kumar2021] Eq. 1 and 3 allow zero force), but a finger that is
    removed pulls with its pull-off force, which the others must balance without pulling
    themselves ([Kumar2021] Eq. 4). Both are linear programs.

    In robust mode the forces that the plan states count instead: they are continuous, in balance,
    and inside the friction cones with the margins of the plan's rules; at a removal also together
    with the response of the springs that stay to the pull. Without adhesion they must press. The
    grip and the margin that a step states are those of its forces.

    Parameters
    ----------
    plan : Plan
        Has passed `check_plan`.

    Raises
    ------
    InvalidStep
        Names the first step whose grasp does not hold.
    """
    sticks = plan.law.stick_uN > 0.0
    planned = plan.options.mode is Mode.ROBUST
    for number, step in enumerate(plan.steps):
        if planned:
            _check_continuous(plan, number, step)
            _check_stated(plan, number, step)
            _check_hold(plan, number, step)
        if sum(step.in_contact) < 2:
            continue
        if not sticks:
            (_check_pressed if planned else _check_pressing)(plan, number, step)
        elif step.kind is StepKind.REMOVE:
            (_check_release if planned else _check_removal)(plan, number, step)


def _check_continuous(plan: Plan, number: int, step: Step) -> None:
    """Check that forces do not jump between steps."""
    before = plan.steps[number - 1].force_uN[-1] if number else step.force_uN[0]
    jump_uN = float(np.abs(step.force_uN[0] - before).max())
    if jump_uN > _SAME_UN:
        raise InvalidStep(number, step.kind, 'jump of a force', f'{jump_uN:.4f} µN', '0 µN')


def _check_stated(plan: Plan, number: int, step: Step) -> None:
    """Check that the stated forces are in balance and inside the cones, at every waypoint."""
    touching = np.array(step.in_contact)
    if not touching.any():
        return
    share = plan.rules.margin_factor
    for waypoint in range(len(step)):
        contact_um, normal = _contacts(plan, step, waypoint, touching)
        force_uN = step.force_uN[waypoint, touching]
        total = sum(wrench_of(f, at) for f, at in zip(force_uN, contact_um, strict=True))
        off_uN = float(np.abs(np.asarray(total) / np.repeat([1.0, _ARM_UM], 3)).max())
        if off_uN > _SAME_UN:
            raise InvalidStep(
                number,
                step.kind,
                f'sum of forces and torques at waypoint {waypoint}',
                f'{off_uN:.4f} µN',
                '0 µN',
            )
        margin_uN = _margin_uN(plan, share, normal, force_uN)
        if margin_uN < -_SAME_UN:
            raise InvalidStep(
                number,
                step.kind,
                f'forces at waypoint {waypoint}',
                f'{-margin_uN:.4f} µN outside what contacts bear',
                f'forces inside the friction cones at {share:g} of the friction',
            )


def _check_release(plan: Plan, number: int, step: Step) -> None:
    """Check that the grip holds while the pull of the leaving finger comes and goes."""
    left_um, outward = _left(plan, number, step)
    touching = np.array(step.in_contact)
    contact_um, normal = _contacts(plan, step, 0, touching)
    pull = wrench_of(plan.law.pull_off_uN * outward, left_um)
    response_uN = spring_response_uN(contact_um, _plane_normal(plan, step, 0), pull)
    least_uN = math.inf
    for share in (0.0, 1.0):
        force_uN = step.force_uN[0, touching] + share * response_uN
        margin_uN = _margin_uN(plan, plan.rules.margin_factor, normal, force_uN)
        least_uN = min(least_uN, margin_uN)
        if margin_uN < plan.rules.least_margin_uN - _SAME_UN:
            raise InvalidStep(
                number,
                step.kind,
                f'margin of the grip, {"with" if share else "without"} the pull of finger '
                f'{step.finger}',
                f'{margin_uN:.4f} µN',
                f'at least {plan.rules.least_margin_uN:g} µN',
            )
    _check_claimed(number, step, least_uN)


def _check_hold(plan: Plan, number: int, step: Step) -> None:
    """Check that the grip that a step of two fingers states is that of its forces."""
    touching = np.array(step.in_contact)
    if step.hold is None or np.count_nonzero(touching) != _PAIR:
        return
    grips_uN, margins_uN = [], []
    for waypoint in range(len(step)):
        contact_um, normal = _contacts(plan, step, waypoint, touching)
        force_uN = step.force_uN[waypoint, touching]
        line = contact_um[1] - contact_um[0]
        grips_uN.append(float(force_uN[0] @ line / np.linalg.norm(line)))
        margins_uN.append(_margin_uN(plan, plan.rules.margin_factor, normal, force_uN))
    if abs(step.hold.grip_uN - min(grips_uN)) > _SAME_UN:
        raise InvalidStep(
            number,
            step.kind,
            'hold: grip_uN',
            f'{step.hold.grip_uN:.4f} µN',
            f'{min(grips_uN):.4f} µN, as in its forces',
        )
    _check_claimed(number, step, min(margins_uN))


def _check_claimed(number: int, step: Step, margin_uN: float) -> None:
    """Check that a step does not state more margin than it has."""
    if step.hold is not None and step.hold.margin_uN > margin_uN + _SAME_UN:
        raise InvalidStep(
            number,
            step.kind,
            'hold: margin_uN',
            f'{step.hold.margin_uN:.4f} µN',
            f'up to {margin_uN:.4f} µN, as in its forces',
        )


def _margin_uN(plan: Plan, share: float, normal: FloatArray, force_uN: FloatArray) -> float:
    """Return the least distance of forces (k, 3) to slipping, detaching and overload [µN]."""
    law, friction = plan.law, share * plan.law.friction
    press = -np.sum(force_uN * normal, axis=1)
    slide = np.linalg.norm(force_uN + press[:, None] * normal, axis=1)
    margins = (
        friction * (press + law.stick_uN) - slide,
        press + law.stick_uN,
        friction * (law.max_force_uN - press),
    )
    return float(np.min(margins))


def _check_pressed(plan: Plan, number: int, step: Step) -> None:
    """Check that the stated forces press, all along a step, or once a first grip has closed."""
    least_uN = _PRESS_SHARE * plan.law.max_force_uN
    pressed_uN = -np.nansum(step.force_uN * np.nan_to_num(step.normal), axis=-1)
    if step.kind is StepKind.GRIP:
        pressed_uN = pressed_uN[-1:]
    weakest = int(np.argmin(pressed_uN.max(axis=1)))
    if pressed_uN[weakest].max() < least_uN:
        raise InvalidStep(
            number,
            step.kind,
            f'grip at waypoint {weakest}',
            f'{pressed_uN[weakest].max():.4f} µN',
            f'at least {least_uN:g} µN where nothing sticks',
        )


def _check_pressing(plan: Plan, number: int, step: Step) -> None:
    """Check that the fingers hold by pressing, all along a roll."""
    least_uN = _PRESS_SHARE * plan.law.max_force_uN
    for waypoint in range(len(step)) if step.kind is StepKind.ROLL else (0,):
        plane_normal = _plane_normal(plan, step, waypoint)
        contact_um, normal = _contacts(plan, step, waypoint, np.array(step.in_contact))
        if not can_balance(contact_um, normal, plane_normal, plan.law, least_normal_uN=least_uN):
            raise InvalidStep(
                number,
                step.kind,
                f'grasp at waypoint {waypoint}',
                'not in equilibrium by pressing alone',
                'contacts whose friction cones face each other',
            )


def _check_removal(plan: Plan, number: int, step: Step) -> None:
    """Check that the fingers that stay balance the pull of the one that goes."""
    left_um, outward = _left(plan, number, step)
    pull = wrench_of(plan.law.pull_off_uN * outward, left_um)
    contact_um, normal = _contacts(plan, step, 0, np.array(step.in_contact))
    plane_normal = _plane_normal(plan, step, 0)
    if not can_balance(contact_um, normal, plane_normal, plan.law, pull, least_normal_uN=0.0):
        raise InvalidStep(
            number,
            step.kind,
            f'pull of finger {step.finger}',
            f'{plan.law.pull_off_uN:g} µN, which the others cannot balance',
            'a pull-off that their friction cones can balance',
        )


def _left(plan: Plan, number: int, step: Step) -> tuple[FloatArray, FloatArray]:
    """Return contact (3,) [µm] and normal (3,) of the finger that a step removes."""
    before = plan.steps[number - 1]
    leaves = np.arange(FINGERS) == step.finger - 1
    if number == 0 or not np.all(np.isfinite(before.normal[-1, leaves])):
        raise InvalidStep(
            number, step.kind, f'finger {step.finger}', 'not in contact before', 'a finger that is'
        )
    left_um, outward = _contacts(plan, before, -1, leaves)
    return left_um[0], outward[0]


def _contacts(
    plan: Plan, step: Step, waypoint: int, fingers: npt.NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return contacts [µm] about the object's origin and normals at a waypoint, station axes.

    They are projected into the section plane: two fingers bear no torque about their own line,
    not even that of the picometres to which a plan is rounded.
    """
    out = _plane_normal(plan, step, waypoint)
    normal = step.normal[waypoint, fingers]
    centre_um = step.tip_um[waypoint, fingers] - step.object_position_um[waypoint]
    contact_um = centre_um - plan.finger.radius_um * normal
    return contact_um - np.outer(contact_um @ out, out), normal - np.outer(normal @ out, out)


def _plane_normal(plan: Plan, step: Step, waypoint: int) -> FloatArray:
    """Return the normal of the section plane in which the fingers stand, station axes."""
    x, y, z, w = np.roll(step.object_quaternion_wxyz[waypoint], -1)
    axis = _AXES[plan.rotations[step.rotation].axis]
    return np.asarray(Rotation.from_quat((x, y, z, w)).apply(axis))
