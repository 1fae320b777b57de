# SPDX-License-Identifier: Apache-2.0
"""A plan → at each waypoint, the window in which the grip of two fingers keeps its margin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from microhand_planner.core.plan import Plan, Step, StepKind
from microhand_planner.core.rolling_grip import rolling_grips_uN

FloatArray = NDArray[np.float64]

_AXES = {'x': (1.0, 0.0, 0.0), 'y': (0.0, 1.0, 0.0), 'z': (0.0, 0.0, 1.0)}
_PAIR = 2


def grip_windows_uN(plan: Plan) -> FloatArray:
    """Return the windows at all waypoints of all steps in a row, (w, 2) [µN].

    A removal has one window. In a roll the upper end changes with the contacts; the plan keeps
    the smallest only, so it is worked out anew. NaN: none was planned.

    Parameters
    ----------
    plan : Plan
        With at least one step.
    """
    return np.concatenate([_window(plan, step) for step in plan.steps])


def _window(plan: Plan, step: Step) -> FloatArray:
    if step.hold is None:
        return np.full((len(step), 2), np.nan)
    window = np.tile([step.hold.low_uN, step.hold.high_uN], (len(step), 1))
    touching = np.flatnonzero(step.in_contact)
    if step.kind is StepKind.ROLL and len(touching) == _PAIR:
        contact_um = step.tip_um - plan.finger.radius_um * step.normal
        axis = _AXES[plan.rotations[step.rotation].axis]
        orientation = Rotation.from_quat(step.object_quaternion_wxyz[:, [1, 2, 3, 0]])
        plane = _plane(orientation[0].apply(axis))
        _, window[:, 1], _ = rolling_grips_uN(
            contact_um[:, touching] @ plane, step.normal[:, touching] @ plane, plan.law, plan.rules
        )
    return window


def _plane(axis: FloatArray) -> FloatArray:
    """Return two unit vectors, (3, 2), that span the plane across an axis, right-handed."""
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(axis, aside)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)], axis=1)
