# SPDX-License-Identifier: Apache-2.0
"""Plans before their judge: held ones and lost ones. Needs no ROS."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import InvalidNumber, InvalidParameter, InvalidPlan
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.plan import StepKind
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_twin.true_station import TrueStation
from microhand_twin.verify import LARGEST_ERROR_DEG, verify

EULER_DEG = (80.0, 220.0, 100.0)


def planned(name, euler_deg, **options):
    """Return a plan by default, from a start that is not the origin."""
    start = Pose((3.0, -2.0, 5.0), (0.9, 0.1, -0.3, 0.2))
    turn = Rotation.from_euler('ZYZ', euler_deg, degrees=True)
    goal = Pose.of((5.0, -2.0, 4.0), start.rotation * turn)
    finger = Finger(clearance_um=0.5)
    return plan_reorientation(
        find_part(name), start, goal, finger, ContactLaw(), SearchOptions(), **options
    )


@pytest.fixture(scope='module')
def plan():
    """Return a reorientation of the ellipsoid with several regrasps, and a translation."""
    made = planned('ellipsoid', EULER_DEG)
    assert made.reconfigurations >= 4
    return made


@pytest.fixture(scope='module')
def short_plan():
    """Return a reorientation by rolling alone."""
    return planned('ellipsoid', (40.0, 0.0, 0.0))


@pytest.mark.parametrize('name', ['ellipsoid', 'convex', 'concave'])
def test_a_default_plan_is_held(name):
    """A reorientation by three rotations is held to the end, which is the goal within 0.05°."""
    plan = planned(name, EULER_DEG)
    poses = []
    verdict = verify(
        plan, find_part(name), watch=lambda simulation, *_: poses.append(simulation.object_pose)
    )
    assert verdict.held
    assert verdict.lost_at is None
    assert verdict.final_error_deg < 0.05
    assert verdict.final_error_um < 0.02
    assert verdict.max_error_deg < 0.3
    assert 0.3 < verdict.max_friction_use < 1.0
    assert poses[0] == plan.start
    turned = (plan.goal.rotation.inv() * poses[-1].rotation).magnitude()
    assert np.degrees(turned) == pytest.approx(verdict.final_error_deg, abs=0.01)
    assert poses[-1].position_um == pytest.approx(plan.goal.position_um, abs=0.02)


def test_without_adhesion_the_object_is_lost(plan):
    """Where nothing sticks, a plan that counts on it loses the object, and says where."""
    station = TrueStation(law=replace(plan.law, adhesion=False))
    verdict = verify(plan, find_part('ellipsoid'), station)
    assert not verdict.held
    step = plan.steps[verdict.lost_at.step]
    assert verdict.lost_at.kind is step.kind
    assert 0.0 < verdict.lost_at.time_s <= verdict.duration_s
    assert str(verdict.lost_at).startswith(f'step {verdict.lost_at.step} ({step.kind.value})')


def test_an_object_that_turns_in_the_fingers_is_lost(short_plan):
    """With next to no friction the fingers slide, and the object stays behind or slips away."""
    station = TrueStation(law=replace(short_plan.law, friction=0.005))
    verdict = verify(short_plan, find_part('ellipsoid'), station)
    assert not verdict.held
    assert verdict.max_friction_use > 0.99
    assert verdict.max_error_deg > 0.5 * LARGEST_ERROR_DEG


def test_forces_that_pull_lose_the_object(short_plan):
    """A plan that is edited to pull where it should press is not held."""
    steps = tuple(
        replace(step, force_uN=-2.0 * step.force_uN) if any(step.in_contact) else step
        for step in short_plan.steps
    )
    verdict = verify(replace(short_plan, steps=steps), find_part('ellipsoid'))
    assert not verdict.held
    assert 'lost contact' in verdict.lost_at.what


def test_a_finger_that_meets_nothing_ends_the_run(short_plan):
    """Off by far more than it feels for, a finger misses the object, and the run ends there."""
    station = TrueStation(placement_um=9.0)
    verdict = verify(short_plan, find_part('ellipsoid'), station, rng=np.random.default_rng(3))
    assert not verdict.held
    assert verdict.lost_at.kind is StepKind.APPROACH
    assert 'met nothing' in verdict.lost_at.what


def test_fingers_that_stop_at_contact_make_the_planned_force(short_plan):
    """Fingers 100 nm off in each direction still grip within 0.3 µN, on springs of 100 N/m."""
    station = TrueStation(stiffness_uN_per_um=(100.0, 100.0, 100.0), placement_um=0.1)
    grip = next(i for i, step in enumerate(short_plan.steps) if step.kind is StepKind.GRIP)
    wanted_uN = np.linalg.norm(short_plan.steps[grip].force_uN[-1], axis=1)
    felt_uN = []

    def watch(_, instant, __):
        if instant.step == grip:
            felt_uN.append(np.linalg.norm(instant.contacts.force_uN, axis=1))

    for seed in range(4):
        verify(
            short_plan, find_part('ellipsoid'), station,
            rng=np.random.default_rng(seed), watch=watch,
        )  # fmt: skip
        assert felt_uN[-1] == pytest.approx(wanted_uN, abs=0.3)


def test_errors_come_from_the_generator_alone(short_plan):
    """One seed gives one verdict, another seed another."""
    station = TrueStation(placement_um=0.1)
    part = find_part('ellipsoid')
    one, same, other = (
        verify(short_plan, part, station, rng=np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert replace(one, wall_s=0.0) == replace(same, wall_s=0.0)
    assert one.final_error_deg != other.final_error_deg


def test_fingers_that_hold_at_the_start_need_no_approach(short_plan):
    """A plan that begins in the fingers is run from there: nothing is met, nothing is lost."""
    last = short_plan.steps[-1]
    tips_um = np.where(np.array(last.in_contact)[:, None], last.tip_um[-1], np.nan)
    begun = Pose(last.object_position_um[-1], last.object_quaternion_wxyz[-1])
    goal = Pose.of(begun.position_um, begun.rotation * Rotation.from_euler('z', 30, degrees=True))
    plan = plan_reorientation(
        find_part('ellipsoid'), begun, goal, short_plan.finger, short_plan.law,
        short_plan.options, start_tip_um=tips_um,
    )  # fmt: skip
    assert all(step.kind is not StepKind.APPROACH for step in plan.steps)
    verdict = verify(plan, find_part('ellipsoid'))
    assert verdict.held
    assert verdict.final_error_deg < 0.05


def test_another_object_is_refused(short_plan):
    """A plan is run with the object that it was made for, and no other."""
    with pytest.raises(InvalidPlan, match=r'concave.*ellipsoid'):
        verify(short_plan, find_part('concave'))


@pytest.mark.parametrize(
    'values',
    [
        {'placement_um': float('nan')},
        {'placement_um': -0.1},
        {'stiffness_uN_per_um': (1.0, 2.0)},
        {'stiffness_uN_per_um': (1.0, 0.0, 1.0)},
    ],
)
def test_impossible_stations_are_refused(values):
    """A station of negative errors or without springs is refused by the field's name."""
    with pytest.raises((InvalidNumber, InvalidParameter), match=r'placement|stiffness'):
        TrueStation(**values)
