# SPDX-License-Identifier: Apache-2.0
"""Motions of whole plans: continuous, without slip or collision, on an analytic ellipsoid."""

import itertools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import ContactLaw, Finger, Mode, SearchOptions
from microhand_planner.core.plan import StepKind
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.section import XY_PLANE, XZ_PLANE
from microhand_planner.core.section_curves import SectionCurves
from tests.planner.oracles import (
    distance_to_ellipsoid_um,
    nearest_on_ellipsoid_um,
    planar_cross,
    preload_window_lp,
    presses_lp,
    removal_window_lp,
)
from tests.planner.solids import ellipsoid

FINGER = Finger()
TOUCH_UM = 1e-3
START = Pose((3.0, -2.0, 1.0), (0.9, 0.1, -0.3, 0.2))


def geometry_of(semi_axes_um, finger=FINGER):
    """Return an ellipsoid with the exact curves of its sections."""
    a, b, c = semi_axes_um
    curves = {
        'z': offset_curve(ellipse_section(a, b, XY_PLANE), finger.radius_um),
        'y': offset_curve(ellipse_section(a, c, XZ_PLANE), finger.radius_um),
    }
    return SectionCurves(ellipsoid(semi_axes_um), finger, curves)


def planned(name):
    """Return semi-axes and plan of one of the cases."""
    turn = Rotation.from_euler('ZYZ', [40.0, 110.0, 30.0], degrees=True)
    axes_um, law, options, more = (18.0, 11.0, 14.0), ContactLaw(), SearchOptions(), {}
    goal = Pose.of((6.0, -2.0, -40.0), START.rotation * turn)
    if name == 'paper':
        axes_um, options = (16.22, 11.586, 11.586), SearchOptions(mode=Mode.PAPER)
        triple = [('z', 80.0), ('y', 220.0), ('z', 100.0)]
        parts = [PlanarRotation(axis, math.radians(angle)) for axis, angle in triple]
        turn = Rotation.from_euler('ZYZ', [80.0, 220.0, 100.0], degrees=True)
        goal = Pose.of(START.position_um, START.rotation * turn)
        more = {'decomposition': parts}
    elif name == 'no adhesion':
        axes_um, law = (15.0, 13.5, 14.0), ContactLaw(friction=0.5, adhesion=False)
    elif name == 'fine':
        options = SearchOptions(math.radians(7.0))
        turn = Rotation.from_euler('ZYZ', [-123.4, 171.0, 77.7], degrees=True)
        goal = Pose.of((0.0, 0.0, 0.0), START.rotation * turn)
    return axes_um, plan_reorientation(
        geometry_of(axes_um), START, goal, FINGER, law, options, **more
    )


@pytest.fixture(scope='module', params=['robust', 'paper', 'no adhesion', 'fine'])
def case(request):
    """Return semi-axes [um] and a plan for them."""
    axes_um, plan = planned(request.param)
    assert any(step.kind is StepKind.ROLL for step in plan.steps)
    assert plan.reconfigurations > 0
    return axes_um, plan


def attitudes(step):
    """Return the orientations of the object along a step."""
    return Rotation.from_quat(step.object_quaternion_wxyz[:, [1, 2, 3, 0]])


def in_object(step, vectors):
    """Return vectors (n, 3, 3) of the station frame in the object's frame."""
    rotations = attitudes(step).inv().as_matrix()
    return np.einsum('nij,nfj->nfi', rotations, vectors)


def densely(step, between=4):
    """Return tips relative to the object, object frame, also between the waypoints."""
    shares = np.arange(len(step))
    dense = np.linspace(0, len(step) - 1, between * (len(step) - 1) + 1)
    tips = np.stack(
        [np.interp(dense, shares, column) for column in step.tip_um.reshape(len(step), 9).T], -1
    ).reshape(-1, 3, 3)
    origins = np.stack(
        [np.interp(dense, shares, column) for column in step.object_position_um.T], axis=-1
    )
    turned = Slerp(shares, attitudes(step))(dense).inv().as_matrix()
    return np.einsum('nij,nfj->nfi', turned, tips - origins[:, None])


def test_each_step_begins_where_the_one_before_ended(case):
    """Tips are continuous to 1e-3 um, and so is the object's pose."""
    _, plan = case
    for before, after in itertools.pairwise(plan.steps):
        assert after.tip_um[0] == pytest.approx(before.tip_um[-1], abs=1e-3)
        assert after.object_position_um[0] == pytest.approx(before.object_position_um[-1])
        gap = attitudes(before)[-1].inv() * attitudes(after)[0]
        assert gap.magnitude() < 1e-9
    first = plan.steps[0]
    assert first.object_position_um[0] == pytest.approx(plan.start.position_um)
    assert (attitudes(first)[0].inv() * plan.start.rotation).magnitude() < 1e-9


def test_waypoints_are_close_together(case):
    """Within a step nothing jumps: 4 um for a tip, 1.01 deg for the object, at most."""
    _, plan = case
    for step in plan.steps:
        assert np.max(np.linalg.norm(np.diff(step.tip_um, axis=0), axis=2)) < 4.0
        turns = (attitudes(step)[:-1].inv() * attitudes(step)[1:]).magnitude()
        assert np.max(turns) < math.radians(1.01)


def test_tips_in_contact_touch_the_ellipsoid(case):
    """A finger in contact is a tip's radius from the surface, along the normal that is stated."""
    axes_um, plan = case
    touched = 0
    for step in plan.steps:
        for finger in np.flatnonzero(step.in_contact):
            centre = in_object(step, step.tip_um - step.object_position_um[:, None])[:, finger]
            distance_um = distance_to_ellipsoid_um(centre, axes_um)
            assert distance_um == pytest.approx(FINGER.radius_um, abs=TOUCH_UM)
            normal = in_object(step, step.normal)[:, finger]
            contact = centre - FINGER.radius_um * normal
            assert np.sum((contact / axes_um) ** 2, axis=1) == pytest.approx(1.0, abs=1e-4)
            gradient = contact / np.square(axes_um)
            gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
            assert normal == pytest.approx(gradient, abs=1e-4)
            touched += 1
    assert touched > 10


def test_fingers_roll_without_slip(case):
    """The contact's way over the object equals its way over the tip, piece by piece and in all.

    The fingers only translate, so over the tip the contact moves by -r dn in the station frame.
    """
    _, plan = case
    for step in plan.steps:
        if step.kind is not StepKind.ROLL:
            continue
        for finger in np.flatnonzero(step.in_contact):
            centre = in_object(step, step.tip_um - step.object_position_um[:, None])
            contact = (centre - FINGER.radius_um * in_object(step, step.normal))[:, finger]
            on_tip = -FINGER.radius_um * np.diff(step.normal[:, finger], axis=0)
            halfway = Slerp(np.arange(len(step)), attitudes(step))(np.arange(len(step) - 1) + 0.5)
            on_object = halfway.apply(np.diff(contact, axis=0))
            slip_um = np.linalg.norm(on_object - on_tip, axis=1)
            # the chord rule is wrong by the cube of the step: 1 deg of 20 um is 5e-5 um
            assert np.max(slip_um) < 2e-4
            ways_um = [np.linalg.norm(way, axis=1).sum() for way in (on_object, on_tip)]
            assert ways_um[0] == pytest.approx(ways_um[1], rel=1e-4, abs=1e-4)
            assert ways_um[0] > 0.0


def test_the_object_moves_only_in_rolls_and_translations(case):
    """Whoever places or removes a finger leaves the object where it is."""
    _, plan = case
    for step in plan.steps:
        turned = (attitudes(step)[0].inv() * attitudes(step)[-1]).magnitude()
        carried_um = np.linalg.norm(step.object_position_um[-1] - step.object_position_um[0])
        if step.kind is StepKind.ROLL:
            assert turned == pytest.approx(abs(math.remainder(step.angle_rad, 2 * math.pi)))
            assert carried_um == 0.0
        elif step.kind is StepKind.TRANSLATE:
            assert turned < 1e-12
            assert carried_um > 0.0
        else:
            assert turned < 1e-12
            assert carried_um == 0.0


def test_tips_never_overlap(case):
    """The centres of any two tips stay two radii apart, waypoints and the way between them."""
    _, plan = case
    for step in plan.steps:
        tips = densely(step)
        for one, other in itertools.combinations(range(3), 2):
            apart_um = np.linalg.norm(tips[:, one] - tips[:, other], axis=1)
            assert np.min(apart_um) >= 2 * FINGER.radius_um - 2e-3, step.kind


def test_free_fingers_never_touch_the_object(case):
    """A finger that is not in contact stays off the surface; only the ends of its way touch."""
    axes_um, plan = case
    for step in plan.steps:
        tips = densely(step)
        for finger in np.flatnonzero(~np.array(step.in_contact)):
            distance_um = distance_to_ellipsoid_um(tips[:, finger], axes_um)
            assert np.min(distance_um) >= FINGER.radius_um - TOUCH_UM, step.kind
            if step.kind is not StepKind.APPROACH and finger != step.finger - 1:
                assert np.min(distance_um) > 2 * FINGER.radius_um, step.kind


def test_fingers_come_and_go_by_steps_of_their_own(case):
    """Contact begins with PLACE or APPROACH and ends with REMOVE, and two fingers always hold."""
    _, plan = case
    assert plan.steps[0].kind is StepKind.APPROACH
    for before, after in itertools.pairwise(plan.steps):
        held = np.array(before.in_contact)
        if before.kind is StepKind.APPROACH:
            assert not np.any(held)
            assert np.sum(after.in_contact) == 2
            continue
        assert np.sum(held) >= 2
        if before.kind is StepKind.PLACE:
            held[before.finger - 1] = True
        if after.kind is StepKind.REMOVE:
            held[after.finger - 1] = False
        assert np.array_equal(held, after.in_contact)


def in_plane(axes_um, plan, step, waypoint):
    """Return contacts [µm], normals and forces [µN] (3, 2) at a waypoint, from the ellipsoid.

    Fingers that do not touch have the foot of their perpendicular as contact.
    """
    plane = {'z': XY_PLANE, 'y': XZ_PLANE}[plan.rotations[step.rotation].axis]
    centre = in_object(step, step.tip_um - step.object_position_um[:, None])[waypoint]
    contact = nearest_on_ellipsoid_um(centre, axes_um)
    outward = centre - contact
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    force_uN = in_object(step, step.force_uN)[waypoint]
    return plane.to_plane(contact), plane.to_plane(outward), plane.to_plane(force_uN)


def test_every_removal_is_feasible(case):
    """Where a finger leaves, those that stay hold, by a linear program of the rules in force.

    Robust plans press with a grip inside the window of the program that wants the margin before
    and during the pull; in paper mode Eq. 4 counts, and without adhesion the pair must press.
    """
    axes_um, plan = case
    removals = 0
    for step in plan.steps:
        if step.kind is not StepKind.REMOVE:
            continue
        contact, normal, force_uN = in_plane(axes_um, plan, step, 0)
        gone, stay = step.finger - 1, list(np.flatnonzero(step.in_contact))
        removal = (contact[stay], normal[stay], contact[gone], normal[gone], plan.law)
        if not plan.law.adhesion:
            assert presses_lp(contact[stay], normal[stay], plan.law.friction) > 0.0
        elif plan.options.mode is Mode.PAPER:
            assert removal_window_lp(*removal)
        else:
            low, high = preload_window_lp(
                *removal, plan.rules.margin_factor * plan.law.friction, margin_uN=0.05
            )
            assert (step.hold.low_uN, step.hold.high_uN) == pytest.approx(
                (low, high), rel=5e-4, abs=1e-3
            )
            assert low + 0.49 <= step.hold.grip_uN <= high - 0.49
            line = contact[stay[1]] - contact[stay[0]]
            line /= np.linalg.norm(line)
            assert force_uN[stay[0]] == pytest.approx(step.hold.grip_uN * line, abs=1e-3)
        removals += 1
    assert removals == plan.reconfigurations / 2


# ---------------------------------------------------------------- forces


def test_forces_are_in_balance_at_every_waypoint(case):
    """Forces of the fingers, and their moments about the object, sum up to nothing."""
    _, plan = case
    for step in plan.steps:
        assert np.abs(step.force_uN.sum(axis=1)).max() < 1e-5
        arm_um = step.tip_um - FINGER.radius_um * np.nan_to_num(step.normal)
        arm_um = arm_um - step.object_position_um[:, None]
        moment = np.cross(arm_um, step.force_uN).sum(axis=1)
        assert np.abs(moment).max() < 5e-3  # at 10 um an arm: 0.5 nN
        assert np.all(step.force_uN[:, ~np.array(step.in_contact)] == 0.0)


def test_forces_never_jump(case):
    """Each step begins with the forces with which the one before ended, unless it was a removal.

    Within a roll they change by less than a tenth of the nominal grip per degree. Plans of the
    paper leave forces open, and press with the nominal grip wherever two fingers hold.
    """
    _, plan = case
    assert not np.any(plan.steps[0].force_uN)
    for before, after in itertools.pairwise(plan.steps):
        assert after.force_uN[0] == pytest.approx(before.force_uN[-1], abs=2e-3), after.kind
    for step in plan.steps:
        if step.kind is not StepKind.GRIP:
            changes = np.linalg.norm(np.diff(step.force_uN, axis=0), axis=2)
            assert changes.max() < 0.1 * plan.rules.nominal_grip_uN, step.kind


def test_grips_are_ramps_of_fingers_that_stand(case):
    """In a GRIP step nothing moves; two waypoints, between which forces change linearly."""
    _, plan = case
    grips = [step for step in plan.steps if step.kind is StepKind.GRIP]
    assert grips
    for step in grips:
        assert len(step) == 2
        assert np.array_equal(step.tip_um[0], step.tip_um[1])
        assert np.array_equal(step.object_position_um[0], step.object_position_um[1])
        assert np.any(step.force_uN[0] != step.force_uN[1])
        assert step.hold is None


def test_the_order_around_a_change_of_fingers():
    """Place, grip as the removal wants it, remove, grip as the roll wants it; then only roll on.

    The new finger, and the one that leaves, bear nothing when contact is made and broken.
    """
    _, plan = planned('robust')
    removals = [number for number, step in enumerate(plan.steps) if step.kind is StepKind.REMOVE]
    assert removals
    for number in removals:
        place, ramp, remove, after = plan.steps[number - 2 : number + 2]
        assert place.kind is StepKind.PLACE
        assert (ramp.kind, after.kind) == (StepKind.GRIP, StepKind.GRIP)
        assert not np.any(place.force_uN[:, place.finger - 1])
        assert np.all(ramp.in_contact)
        assert not np.any(ramp.force_uN[-1, remove.finger - 1])
        assert np.any(ramp.force_uN[0, remove.finger - 1])
        assert not np.any(remove.force_uN[:, remove.finger - 1])
        assert remove.hold is not None
        # all along the removal the two that stay hold as they did at the end of the ramp
        assert np.all(remove.force_uN == ramp.force_uN[-1])
    first, closing = plan.steps[:2]
    assert (first.kind, closing.kind) == (StepKind.APPROACH, StepKind.GRIP)
    assert not np.any(first.force_uN)


def test_holds_tell_what_the_forces_are(case):
    """Grip, margin and the upper end of a roll's window, recomputed from contacts and vectors."""
    axes_um, plan = case
    law, rules = plan.law, plan.rules
    friction = rules.margin_factor * law.friction
    share = rules.roll_factor if law.adhesion else rules.margin_factor
    told = 0
    for step in plan.steps:
        if step.hold is None:
            continue
        assert plan.options.mode is Mode.ROBUST
        held = np.flatnonzero(step.in_contact)
        grips, margins, room = [], [], []
        for waypoint in range(len(step)):
            contact, normal, force_uN = in_plane(axes_um, plan, step, waypoint)
            line = contact[held[1]] - contact[held[0]]
            line /= np.linalg.norm(line)
            grips.append(force_uN[held[0]] @ line)
            assert force_uN[held] == pytest.approx(
                grips[-1] * np.stack([line, -line]), abs=1e-3
            ), 'forces are along the line between the contacts'
            press = -np.sum(force_uN[held] * normal[held], axis=1)
            slide = np.abs(planar_cross(normal[held], force_uN[held]))
            margins.append(np.min(friction * (press + law.stick_uN) - slide))
            room.append(np.min(share * law.friction * (press + law.stick_uN) - slide))
        assert step.hold.grip_uN == pytest.approx(min(grips), abs=2e-3)
        assert step.hold.margin_uN <= min(margins) + 2e-3
        if step.kind is StepKind.ROLL:
            assert step.hold.margin_uN == pytest.approx(min(margins), abs=2e-3)
            assert min(room) >= -2e-3, 'outside the cones that rolling is planned with'
            assert step.hold.grip_uN == pytest.approx(
                min(rules.nominal_grip_uN, step.hold.high_uN), abs=2e-3
            )
        told += 1
    kinds = {step.kind for step in plan.steps if step.hold is not None}
    assert kinds == (
        {StepKind.ROLL, StepKind.REMOVE} if plan.options.mode is Mode.ROBUST else set()
    )
    assert told or plan.options.mode is Mode.PAPER


def test_rolls_press_with_the_nominal_grip_at_most(case):
    """Robust plans press less where contacts bear less; plans of the paper everywhere alike."""
    _, plan = case
    grips_uN = np.concatenate(
        [
            np.linalg.norm(step.force_uN[:, step.in_contact.index(True)], axis=-1)
            for step in plan.steps
            if step.kind is StepKind.ROLL and sum(step.in_contact) == 2
        ]
    )
    nominal_uN = plan.rules.nominal_grip_uN
    assert grips_uN.max() == pytest.approx(nominal_uN, abs=1e-3)
    if plan.options.mode is Mode.PAPER:
        assert grips_uN == pytest.approx(nominal_uN, abs=1e-3)
