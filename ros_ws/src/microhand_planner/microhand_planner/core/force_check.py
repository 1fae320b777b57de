# SPDX-License-Identifier: Apache-2.0
"""Plan to verdict: whether the fingers hold, and may let go, at every step."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from microhand_planner.core.equilibrium import can_balance, wrench_of
from microhand_planner.core.plan import FINGERS, Plan, Step, StepKind
from microhand_planner.core.plan_check import InvalidStep
from microhand_planner.core.pose import FloatArray

_AXES = {'z': (0.0, 0.0, 1.0), 'y': (0.0, 1.0, 0.0)}
_PRESS_SHARE = 1e-3  # of the largest force: without adhesion, fingers that hold press at least so


def check_forces(plan: Plan) -> None:
    """Check the forces of a plan with the linear program of `equilibrium`.

    Without adhesion, the fingers in contact must be able to hold by pressing at every waypoint.
    With adhesion they always hold ([Kumar2021] Eq. 1 and 3 allow zero force), but a finger that is
    removed pulls with its pull-off force, which the others must balance without pulling
    themselves ([Kumar2021] Eq. 4).

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
    for number, step in enumerate(plan.steps):
        if sum(step.in_contact) < 2:
            continue
        if not sticks:
            _check_pressing(plan, number, step)
        elif step.kind is StepKind.REMOVE:
            _check_removal(plan, number, step)


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
    before = plan.steps[number - 1]
    leaves = np.arange(FINGERS) == step.finger - 1
    if number == 0 or not np.all(np.isfinite(before.normal[-1, leaves])):
        raise InvalidStep(
            number, step.kind, f'finger {step.finger}', 'not in contact before', 'a finger that is'
        )
    left_um, outward = _contacts(plan, before, -1, leaves)
    pull = wrench_of(plan.law.pull_off_uN * outward[0], left_um[0])
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
