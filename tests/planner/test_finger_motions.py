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
from tests.planner.oracles import presses_lp, removal_window_lp
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


def nearest_on_ellipsoid_um(points_um, semi_axes_um):
    """Return the nearest points of an ellipsoid to points (..., 3) outside.

    The nearest point is q with p - q = s (q / axes^2); s >= 0 follows by bisection.
    """
    points_um = np.asarray(points_um)
    squares = np.square(semi_axes_um)
    low = np.zeros(points_um.shape[:-1])
    high = np.max(semi_axes_um) * np.linalg.norm(points_um, axis=-1)
    for _ in range(70):
        s = 0.5 * (low + high)
        nearest = points_um * squares / (squares + s[..., None])
        outside = np.sum(nearest**2 / squares, axis=-1) > 1.0
        low, high = np.where(outside, s, low), np.where(outside, high, s)
    return nearest


def distance_to_ellipsoid_um(points_um, semi_axes_um):
    """Return the distance of points (..., 3) outside an ellipsoid from it."""
    nearest = nearest_on_ellipsoid_um(points_um, semi_axes_um)
    return np.linalg.norm(points_um - nearest, axis=-1)


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


def test_every_removal_is_feasible(case):
    """Where a finger leaves, the fingers that stay can hold the pull, by a linear program."""
    axes_um, plan = case
    plane_of = {'z': XY_PLANE, 'y': XZ_PLANE}
    removals = 0
    for step in plan.steps:
        if step.kind is not StepKind.REMOVE:
            continue
        plane = plane_of[plan.rotations[step.rotation].axis]
        centre = in_object(step, step.tip_um - step.object_position_um[:, None])[0]
        contact = nearest_on_ellipsoid_um(centre, axes_um)
        normal = plane.to_plane((centre - contact) / FINGER.radius_um)
        contact = plane.to_plane(contact)
        gone, stay = step.finger - 1, list(np.flatnonzero(step.in_contact))
        if plan.law.adhesion:
            assert removal_window_lp(
                contact[stay], normal[stay], contact[gone], normal[gone], plan.law
            )
        else:
            assert presses_lp(contact[stay], normal[stay], plan.law.friction) > 0.0
        removals += 1
    assert removals == plan.reconfigurations / 2
