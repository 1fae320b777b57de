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
    """Return a maker of plans: roll a sphere with two fingers, then with three."""

    def make(angle_deg=40.0, wait_um=WAIT_UM):
        touch_um = SPHERE_UM + TIP_UM
        side = np.radians([0.0, 180.0, 90.0])
        first, both = math.radians(0.8 * angle_deg), math.radians(angle_deg)
        # a tip of radius r goes around a sphere of radius R by R / (R + r) of the rolling angle
        around = SPHERE_UM / touch_um

        def roll(from_rad, to_rad, fingers):
            theta = np.linspace(from_rad, to_rad, max(2, math.ceil(0.8 * angle_deg) + 1))
            tips = np.tile([0.0, 0.0, wait_um], (len(theta), 3, 1))
            at = around * theta[:, None] + side
            tips[:, fingers] = on_circle(touch_um, at[:, fingers])
            return theta, tips

        theta_1, roll_1 = roll(0.0, first, [0, 1])
        theta_2, roll_2 = roll(first, both, [0, 1, 2])
        out = np.stack([*on_circle(wait_um, side[:2]), roll_1[0, 2]])
        approach = np.stack([out, [roll_1[0, 0], out[1], out[2]], roll_1[0]])
        place = np.stack([roll_1[-1]] * 3)
        place[1:, 2] = np.outer([wait_um / touch_um, 1.0], roll_2[0, 2])
        remove = np.stack([roll_2[-1], roll_2[-1]])
        remove[1, 2] *= wait_um / touch_um
        two, three = (True, True, False), (True, True, True)
        return Plan(
            object_name='sphere',
            object_sha256='0' * 64,
            start=Pose(),
            goal=Pose.of((0.0, 0.0, 0.0), Rotation.from_rotvec([0.0, 0.0, both])),
            finger=Finger(),
            law=ContactLaw(),
            options=SearchOptions(),
            steps=(
                make_step(StepKind.APPROACH, approach, (False, False, False)),
                make_step(StepKind.ROLL, roll_1, two, 0, theta_1, first),
                make_step(StepKind.PLACE, place, two, 3, first),
                make_step(StepKind.ROLL, roll_2, three, 0, theta_2, both - first),
                make_step(StepKind.REMOVE, remove, two, 3, both),
            ),
            rotations=(RotationReport('z', angle_deg, 2.2 * angle_deg + 360.0, 2, 10, 0.001),),
        )

    return make
