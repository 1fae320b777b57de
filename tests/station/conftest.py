# SPDX-License-Identifier: Apache-2.0
"""Hand-made plans on a sphere, where the rolling of a tip has a closed form."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.plan import Plan, RotationReport, Step, StepKind
from microhand_planner.core.pose import Pose

SPHERE_UM = 12.0
TIP_UM = 4.5
WAIT_UM = 36.0


def on_circle(radius_um, angle_rad):
    """Return points (..., 3) on a circle about z."""
    angle_rad = np.asarray(angle_rad, dtype=float)
    unit = np.stack([np.cos(angle_rad), np.sin(angle_rad), 0 * angle_rad], axis=-1)
    return radius_um * unit


def make_step(kind, tips, touching, finger=0, turn_rad=None, angle_rad=0.0):
    """Make a step from tips (n, 3, 3); the object turns about z by `turn_rad` (n,)."""
    n = len(tips)
    turn_rad = np.zeros(n) if turn_rad is None else np.broadcast_to(turn_rad, n)
    quaternion = Rotation.from_rotvec(turn_rad[:, None] * [0, 0, 1.0]).as_quat()[:, [3, 0, 1, 2]]
    normal = np.where(
        np.array(touching)[None, :, None],
        tips / np.linalg.norm(tips, axis=-1, keepdims=True),
        np.nan,
    )
    return Step(kind, 0, finger, angle_rad, touching, np.zeros((n, 3)), quaternion, tips, normal)


@pytest.fixture(scope='session')
def sphere_plan():
    """Return a maker of plans: grip a sphere with fingers 1 and 2, roll it, place 3, remove 1."""

    def make(angle_deg=40.0, wait_um=WAIT_UM):
        touch_um = SPHERE_UM + TIP_UM
        angle = math.radians(angle_deg)
        side = np.radians([0.0, 180.0, 90.0])
        out, there = on_circle(wait_um, side), on_circle(touch_um, side)
        approach = np.stack([out, [there[0], out[1], out[2]], [there[0], there[1], out[2]]])
        theta = np.linspace(0.0, angle, max(2, math.ceil(angle_deg) + 1))
        # a tip of radius r goes around a sphere of radius R by R / (R + r) of the rolling angle
        around = theta * SPHERE_UM / touch_um
        roll = on_circle(touch_um, around[:, None] + side[:2])
        roll = np.concatenate([roll, np.broadcast_to(out[2], (len(theta), 1, 3))], axis=1)
        end = around[-1] + side
        place = np.stack([roll[-1], roll[-1], roll[-1]])
        place[1, 2], place[2, 2] = on_circle(wait_um, end[2]), on_circle(touch_um, end[2])
        remove = np.stack([place[-1], place[-1]])
        remove[1, 0] = on_circle(wait_um, end[0])
        return Plan(
            object_name='sphere',
            object_sha256='0' * 64,
            start=Pose(),
            goal=Pose.of((0.0, 0.0, 0.0), Rotation.from_rotvec([0.0, 0.0, angle])),
            finger=Finger(),
            law=ContactLaw(),
            options=SearchOptions(),
            steps=(
                make_step(StepKind.APPROACH, approach, (False, False, False)),
                make_step(StepKind.ROLL, roll, (True, True, False), 0, theta, angle),
                make_step(StepKind.PLACE, place, (True, True, False), 3, angle),
                make_step(StepKind.REMOVE, remove, (False, True, True), 1, angle),
            ),
            rotations=(RotationReport('z', angle_deg, 2 * angle_deg + 360.0, 2, 10, 0.001),),
        )

    return make
