# SPDX-License-Identifier: Apache-2.0
"""Motions of plans: commands that press as planned, slow and guarded where fingers touch."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.errors import InvalidNumber, InvalidParameter, InvalidPlan
from microhand_planner.core.motions import Touch, motions
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.plan import StepKind
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.section import XY_PLANE, XZ_PLANE
from microhand_planner.core.section_curves import SectionCurves
from microhand_planner.core.trajectory import Pace
from tests.planner.oracles import distance_to_ellipsoid_um
from tests.planner.solids import ellipsoid

AXES_UM = (18.0, 11.0, 14.0)
FINGER = Finger(clearance_um=0.5)
START = Pose((3.0, -2.0, 1.0), (0.9, 0.1, -0.3, 0.2))
PACE = Pace()
TOUCH = Touch(speed_um_s=2.0, standoff_um=0.6, overtravel_um=0.3, force_rate_uN_s=40.0)
STIFFNESS = np.array([20.0, 50.0, 100.0])
NANOMETRE = 1e-3


def planned(**more):
    """Return a plan for an analytic ellipsoid, with regrasps and a translation."""
    a, b, c = AXES_UM
    curves = {
        'z': offset_curve(ellipse_section(a, b, XY_PLANE), FINGER.radius_um),
        'y': offset_curve(ellipse_section(a, c, XZ_PLANE), FINGER.radius_um),
    }
    geometry = SectionCurves(ellipsoid(AXES_UM), FINGER, curves)
    turn = Rotation.from_euler('ZYZ', [40.0, 110.0, 30.0], degrees=True)
    start = more.pop('start', START)
    goal = Pose.of((6.0, -2.0, -30.0), start.rotation * turn)
    return plan_reorientation(geometry, start, goal, FINGER, ContactLaw(), SearchOptions(), **more)


@pytest.fixture(scope='module')
def plan():
    """Return a plan in which fingers approach, roll, place, remove, grip and carry."""
    made = planned()
    assert {step.kind for step in made.steps} == set(StepKind)
    return made


@pytest.fixture(scope='module')
def streams(plan):
    """Return its motions, with another stiffness for each finger."""
    return motions(plan, PACE, STIFFNESS, TOUCH)


def commands_um(step):
    """Return what a step's waypoints are commanded as: contact centre + force / stiffness."""
    return step.tip_um + step.force_uN / STIFFNESS[:, None]


def landings(plan):
    """Return for each step that makes contact the fingers that do, from 0."""
    found = {}
    for number, (step, after) in enumerate(itertools.pairwise(plan.steps)):
        new = np.flatnonzero(np.array(after.in_contact) & ~np.array(step.in_contact))
        if len(new):
            found[number] = list(new)
    return found


def ends_um(streams):
    """Return commands (3, 3) at the end of each step, by its number, and who is guarded there."""
    return {
        int(motion.trajectory.step_of[end]): (motion.trajectory.tip_um[end], motion.guarded)
        for motion in streams
        for end in motion.trajectory.step_end
    }


def test_commands_are_contact_centres_and_force_over_stiffness(plan, streams):
    """At the end of every step each finger is commanded into the object by f / k, to a fm."""
    ends = ends_um(streams)
    assert sorted(ends) == list(range(len(plan.steps)))
    for number, (tip_um, guarded) in ends.items():
        free = ~np.array(guarded)
        expected = commands_um(plan.steps[number])[-1]
        assert tip_um[free] == pytest.approx(expected[free], abs=1e-9)
    assert np.array_equal(streams[0].trajectory.tip_um[0], commands_um(plan.steps[0])[0])


def test_commands_follow_the_forces_of_a_roll(plan, streams):
    """When the object is where a waypoint has it, so are the commands, to a few nanometres."""
    rolls = 0
    for number, step in enumerate(plan.steps):
        if step.kind is not StepKind.ROLL:
            continue
        (timed,) = (motion.trajectory for motion in streams if number in motion.trajectory.step_of)
        rows = timed.step_of == number
        first = Rotation.from_quat(step.object_quaternion_wxyz[0, [1, 2, 3, 0]])
        passed, expected = (
            (first.inv() * Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])).magnitude()
            for quaternion in (timed.object_quaternion_wxyz[rows], step.object_quaternion_wxyz)
        )
        if abs(step.angle_rad) > math.pi:
            continue  # the magnitude of a turn comes back beyond half a turn
        for finger, axis in itertools.product(np.flatnonzero(step.in_contact), range(3)):
            found = np.interp(expected[1:], passed, timed.tip_um[rows, finger, axis])
            assert found == pytest.approx(commands_um(step)[1:, finger, axis], abs=3 * NANOMETRE)
        rolls += 1
    assert rolls > 1


def test_a_softer_finger_is_commanded_deeper(plan):
    """The same plan for fingers half as stiff: twice the depth, wherever there is a force."""
    rigid, soft = (ends_um(motions(plan, PACE, f * STIFFNESS, TOUCH)) for f in (1.0, 0.5))
    pressed = 0
    for number, (command_um, guarded) in rigid.items():
        free = ~np.array(guarded)
        depth_um = (command_um - plan.steps[number].tip_um[-1])[free]
        deeper_um = (soft[number][0] - plan.steps[number].tip_um[-1])[free]
        assert deeper_um == pytest.approx(2.0 * depth_um, abs=1e-9)
        pressed += np.any(depth_um != 0.0)
    assert pressed > 5


def test_the_sum_of_motions_is_the_plan_in_order(plan, streams):
    """Steps come one after the other, none is left out, and each motion begins at rest."""
    order = np.concatenate([motion.trajectory.step_of for motion in streams])
    assert np.all(np.isin(np.diff(order), (0, 1)))
    assert (order[0], order[-1]) == (0, len(plan.steps) - 1)
    for motion in streams:
        assert not np.any(motion.trajectory.velocity_um_s[[0, -1]])
        assert motion.trajectory.period_s == PACE.period_s


def test_guarded_motions_are_those_in_which_contact_is_made(plan, streams):
    """One for the first grasp, both fingers at once, and one for each placement."""
    expected = landings(plan)
    placements = sum(step.kind is StepKind.PLACE for step in plan.steps)
    assert len(expected) == 1 + placements > 1
    guarded = [motion for motion in streams if any(motion.guarded)]
    assert len(guarded) == len(expected)
    for motion, (number, fingers) in zip(guarded, expected.items(), strict=True):
        assert set(motion.trajectory.step_of) == {number}
        assert list(np.flatnonzero(motion.guarded)) == fingers
        contact_um = plan.steps[number].tip_um[-1, fingers]
        assert np.array_equal(motion.contact_um[fingers], contact_um)
        others = [finger for finger in range(3) if finger not in fingers]
        assert np.all(np.isnan(motion.contact_um[others]))
    assert sum(guarded[0].guarded) == 2


def test_guarded_motions_lead_along_the_normal_from_the_standoff_to_the_overtravel(plan, streams):
    """From 0.6 µm before the planned contact straight to 0.3 µm beyond it, along the normal."""
    for motion in streams:
        for finger in np.flatnonzero(motion.guarded):
            timed = motion.trajectory
            after = plan.steps[int(timed.step_of[-1]) + 1]
            normal = after.normal[0, finger]
            way_um = timed.tip_um[:, finger] - motion.contact_um[finger]
            along_um = way_um @ normal
            assert along_um[0] == pytest.approx(TOUCH.standoff_um, abs=NANOMETRE)
            assert along_um[-1] == pytest.approx(-TOUCH.overtravel_um, abs=NANOMETRE)
            assert np.all(np.diff(along_um) <= 1e-12)
            beside_um = np.linalg.norm(way_um - along_um[:, None] * normal, axis=1)
            assert beside_um.max() < NANOMETRE


def test_fingers_feel_for_contact_slowly(streams):
    """A guarded finger is never faster than the contact speed, and reaches it."""
    for motion in streams:
        for finger in np.flatnonzero(motion.guarded):
            speed_um_s = np.linalg.norm(motion.trajectory.velocity_um_s[:, finger], axis=1)
            assert speed_um_s.max() <= TOUCH.speed_um_s * (1 + 1e-9)
            assert speed_um_s.max() > 0.9 * TOUCH.speed_um_s


def test_the_fingers_that_hold_do_not_move_while_another_feels_for_contact(plan, streams):
    """Their commands stand still, with the force that the plan has them press with."""
    for motion in streams:
        number = int(motion.trajectory.step_of[-1])
        if not any(motion.guarded) or not any(plan.steps[number].in_contact):
            continue
        holding = np.array(plan.steps[number].in_contact)
        tips = motion.trajectory.tip_um[:, holding]
        assert np.all(tips == tips[0])
        assert tips[0] == pytest.approx(commands_um(plan.steps[number])[0, holding], abs=1e-9)


def test_each_motion_begins_where_the_one_before_ended(plan, streams):
    """But for guarded fingers: contact stops them, and the next motion begins at the contact."""
    for before, after in itertools.pairwise(streams):
        gap_um = after.trajectory.tip_um[0] - before.trajectory.tip_um[-1]
        free = ~np.array(before.guarded)
        assert np.abs(gap_um[free]).max() < 1e-9
        touched = ~free
        assert after.trajectory.tip_um[0, touched] == pytest.approx(
            before.contact_um[touched], abs=1e-9
        )
        gap = after.trajectory.object_position_um[0] - before.trajectory.object_position_um[-1]
        assert np.abs(gap).max() < 1e-6


def test_a_finger_lets_go_slowly_until_its_spring_is_free(plan, streams):
    """While it is less than 4 f_po / k away, with the softest k, it keeps the contact speed.

    An adhesive finger of stiffness k snaps off after f_po / k.
    """
    stretch_um = 4.0 * plan.law.pull_off_uN / STIFFNESS.min()
    removals = 0
    for motion in streams:
        timed = motion.trajectory
        for number in np.unique(timed.step_of):
            step = plan.steps[number]
            if step.kind is not StepKind.REMOVE:
                continue
            finger = step.finger - 1
            rows = timed.step_of == number
            away_um = np.linalg.norm(timed.tip_um[rows, finger] - step.tip_um[0, finger], axis=1)
            speed_um_s = np.linalg.norm(timed.velocity_um_s[rows, finger], axis=1)
            near = away_um < stretch_um - 1e-6
            assert speed_um_s[near].max() <= TOUCH.speed_um_s * (1 + 1e-9)
            assert speed_um_s[~near].max() > 10.0 * TOUCH.speed_um_s
            outward = plan.steps[number - 1].normal[-1, finger]
            away = timed.tip_um[rows, finger] - step.tip_um[0, finger]
            along_um = away @ outward
            beside_um = np.linalg.norm(away - along_um[:, None] * outward, axis=1)
            assert beside_um[near].max() < NANOMETRE
            removals += 1
    assert removals == sum(step.kind is StepKind.REMOVE for step in plan.steps)


def test_forces_are_ramped_no_faster_than_allowed(plan, streams):
    """In grip steps the force of each finger, as far as it is commanded, changes gently."""
    for motion in streams:
        timed = motion.trajectory
        for number in np.unique(timed.step_of):
            if plan.steps[number].kind is not StepKind.GRIP:
                continue
            rows = timed.step_of == number
            rate_uN_s = timed.velocity_um_s[rows] * STIFFNESS[:, None]
            fastest = np.linalg.norm(rate_uN_s, axis=-1).max()
            assert 0.0 < fastest <= TOUCH.force_rate_uN_s * (1 + 1e-9)


def test_speed_and_acceleration_of_all_motions_are_within_the_pace(streams):
    """Differences of the sampled velocities: along the way the pace, and what a bend adds.

    On the sphere where they wait, free fingers turn with v²/R on top.
    """
    fastest = PACE.travel_um_s
    inward = fastest**2 / 30.0
    for motion in streams:
        speed_um_s = np.linalg.norm(motion.trajectory.velocity_um_s, axis=-1)
        assert speed_um_s.max() <= fastest * (1 + 1e-9)
        change = np.diff(motion.trajectory.velocity_um_s, axis=0) / PACE.period_s
        most = math.hypot(PACE.acceleration_um_s2, inward)
        assert np.linalg.norm(change, axis=-1).max() <= most


def test_tips_keep_their_distance_but_for_what_forces_cost(plan, streams):
    """Commands are nearer than the plan's tips by no more than f / k of the two, and a nm."""
    depth_um = {
        number: np.linalg.norm(step.force_uN, axis=-1).max(axis=0) / STIFFNESS
        for number, step in enumerate(plan.steps)
    }
    for motion in streams:
        timed = motion.trajectory
        for one, other in itertools.combinations(range(3), 2):
            apart_um = np.linalg.norm(timed.tip_um[:, one] - timed.tip_um[:, other], axis=1)
            cost_um = np.array(
                [depth_um[number][one] + depth_um[number][other] for number in timed.step_of]
            )
            beyond_um = TOUCH.overtravel_um * any(motion.guarded)
            shortfall_um = FINGER.min_distance_um - apart_um - cost_um - beyond_um
            assert shortfall_um.max() < NANOMETRE


def test_free_fingers_keep_off_the_object_until_they_feel_for_it(plan, streams):
    """No setpoint of a finger in the air is within a tip's radius of the ellipsoid.

    Only guarded fingers go on, and they end as far inside as the overtravel says.
    """
    for motion in streams:
        timed = motion.trajectory
        turned = Rotation.from_quat(timed.object_quaternion_wxyz[:, [1, 2, 3, 0]])
        to_object = turned.inv().as_matrix()
        relative = timed.tip_um - timed.object_position_um[:, None]
        tips = np.einsum('nij,nfj->nfi', to_object, relative)
        touching = np.array([plan.steps[number].in_contact for number in timed.step_of])
        for finger in range(3):
            free = tips[~touching[:, finger], finger]
            if len(free) == 0:
                continue
            distance_um = distance_to_ellipsoid_um(free, AXES_UM) - FINGER.radius_um
            nearest_um = distance_um.min()
            if motion.guarded[finger]:
                assert nearest_um == pytest.approx(-TOUCH.overtravel_um, abs=2 * NANOMETRE)
            else:
                assert nearest_um > -2 * NANOMETRE


def test_fingers_that_hold_already_do_not_feel_for_the_object(plan):
    """A plan that begins with a grasp has no guarded motion before its first placement."""
    tips = np.array(plan.steps[-1].tip_um[-1])
    tips[~np.array(plan.steps[-1].in_contact)] = np.nan
    chained = planned(start=plan.reached, start_tip_um=tips)
    assert any(chained.steps[0].in_contact)
    made = motions(chained, PACE, STIFFNESS, TOUCH)
    placements = sum(step.kind is StepKind.PLACE for step in chained.steps)
    assert sum(any(motion.guarded) for motion in made) == placements
    assert not any(made[0].guarded)


@pytest.mark.parametrize(
    'stiffness', [(100.0, 100.0), (100.0, 0.0, 100.0), (1.0, -1.0, 1.0), (1.0, math.nan, 1.0)]
)
def test_a_stiffness_that_is_none_is_refused(plan, stiffness):
    """Two numbers, zero, negative or NaN: no command could be made of it."""
    with pytest.raises(InvalidParameter, match=r'stiffness is .*; allowed: three numbers > 0'):
        motions(plan, PACE, stiffness, TOUCH)


def test_plans_without_steps_have_no_motions(plan):
    """An empty plan is refused in words."""
    with pytest.raises(InvalidPlan, match='steps is empty'):
        motions(dataclasses.replace(plan, steps=()), PACE, STIFFNESS, TOUCH)


@pytest.mark.parametrize(
    ('changes', 'error', 'field'),
    [
        ({'speed_um_s': 0.0}, InvalidParameter, 'contact_speed'),
        ({'standoff_um': 0.0}, InvalidParameter, 'standoff'),
        ({'overtravel_um': -1.0}, InvalidParameter, 'overtravel'),
        ({'force_rate_uN_s': math.nan}, InvalidNumber, 'force_rate'),
    ],
)
def test_ways_of_touching_that_are_none_are_refused(changes, error, field):
    """Speeds, distances and rates of zero and less, and NaN, are named."""
    with pytest.raises(error, match=f'^{field} is '):
        Touch(**changes)
