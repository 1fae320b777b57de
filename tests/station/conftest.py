# SPDX-License-Identifier: Apache-2.0
"""Plans on a sphere, where the rolling of a tip has a closed form, and a bench to run them."""

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, SearchOptions
from microhand_planner.core.part import load_part
from microhand_planner.core.plan import Plan, RotationReport, Step, StepKind
from microhand_planner.core.pose import Pose

SPHERE_UM = 12.0
TIP_UM = 4.5
WAIT_UM = 36.0
GRIP_UN = 3.0


def on_circle(radius_um, angle_rad):
    """Return points (..., 3) on a circle about z."""
    angle_rad = np.asarray(angle_rad, dtype=float)
    unit = np.stack([np.cos(angle_rad), np.sin(angle_rad), 0 * angle_rad], axis=-1)
    return radius_um * unit


def make_step(kind, tips, touching, finger=0, turn_rad=None, angle_rad=0.0, grip_uN=GRIP_UN):
    """Make a step from tips (n, 3, 3); the object turns about z by `turn_rad` (n,).

    Fingers 1 and 2 press with `grip_uN`, a number or (n,), where they touch.
    """
    n = len(tips)
    turn_rad = np.zeros(n) if turn_rad is None else np.broadcast_to(turn_rad, n)
    quaternion = Rotation.from_rotvec(turn_rad[:, None] * [0, 0, 1.0]).as_quat()[:, [3, 0, 1, 2]]
    outward = tips / np.linalg.norm(tips, axis=-1, keepdims=True)
    touching_rows = np.array(touching)[None, :, None]
    pressing = touching_rows & np.array([True, True, False])[None, :, None]
    grip_uN = np.broadcast_to(grip_uN, n)[:, None, None]
    return Step(
        kind=kind,
        rotation=0,
        finger=finger,
        angle_rad=angle_rad,
        in_contact=touching,
        object_position_um=np.zeros((n, 3)),
        object_quaternion_wxyz=quaternion,
        tip_um=tips,
        normal=np.where(touching_rows, outward, np.nan),
        force_uN=np.where(pressing, -grip_uN * outward, 0.0),
    )


@pytest.fixture(scope='session')
def sphere_mesh(tmp_path_factory):
    """Return the mesh file of the sphere."""
    path = tmp_path_factory.mktemp('mesh') / 'sphere.stl'
    trimesh.creation.icosphere(subdivisions=4, radius=SPHERE_UM).export(path)
    return path


@pytest.fixture(scope='session')
def sphere_plan(sphere_mesh):
    """Return a maker of plans: roll a sphere with two fingers, then with three."""
    sha256 = load_part(sphere_mesh).sha256

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
        place = np.stack([roll_1[-1]] * 3)
        place[1:, 2] = np.outer([wait_um / touch_um, 1.0], roll_2[0, 2])
        remove = np.stack([roll_2[-1], roll_2[-1]])
        remove[1, 2] *= wait_um / touch_um
        two, three = (True, True, False), (True, True, True)
        grip = make_step(
            StepKind.GRIP, np.stack([roll_1[0]] * 2), two, grip_uN=np.array([0.0, GRIP_UN])
        )
        return Plan(
            object_name='sphere',
            object_sha256=sha256,
            start=Pose(),
            goal=Pose.of((0.0, 0.0, 0.0), Rotation.from_rotvec([0.0, 0.0, both])),
            finger=Finger(),
            law=ContactLaw(),
            options=SearchOptions(),
            rules=GripRules(),
            steps=(
                make_step(StepKind.APPROACH, np.stack([out, roll_1[0]]), (False, False, False)),
                grip,
                make_step(StepKind.ROLL, roll_1, two, 0, theta_1, first),
                make_step(StepKind.PLACE, place, two, 3, first),
                make_step(StepKind.ROLL, roll_2, three, 0, theta_2, both - first),
                make_step(StepKind.REMOVE, remove, two, 3, both),
            ),
            rotations=(RotationReport('z', angle_deg, 2.2 * angle_deg + 360.0, 2, 10, 0, 0.001),),
        )

    return make


@pytest.fixture(scope='module')
def started(ros_domain, tmp_path_factory, sphere_mesh):
    """Start the bench once for all tests of this file."""
    # not at the top: messages read the environment, which tests/conftest.py sets, when imported
    from tests.station.bench import Bench

    bench = Bench(tmp_path_factory.mktemp('bench'), sphere_mesh)
    yield bench
    bench.close()


@pytest.fixture
def bench(started):
    """Return the bench, idle, without faults, and with nothing remembered."""
    started.make_ready()
    return started


@pytest.fixture(scope='module')
def first_run(started, sphere_plan):
    """Return all that can be seen of a run that goes well."""
    from tests.station.bench import run

    started.make_ready()
    return run(started, sphere_plan(20.0))
