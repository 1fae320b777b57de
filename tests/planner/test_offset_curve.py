# SPDX-License-Identifier: Apache-2.0
"""The path of a tip's centre: lengths by hand, distances by brute force, rolling by an ODE."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial import ConvexHull
from scipy.special import ellipe

from microhand_planner.core.analytic_sections import (
    ellipse_section,
    parametric_section,
    polygon_section,
    waisted_section,
)
from microhand_planner.core.errors import BadRequest, InadmissibleContact
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.section import XY_PLANE, XZ_PLANE
from tests.planner.solids import distance_um, outline_points_um

RADIUS_UM = 4.5
SQUARE = np.array([[5.0, 5.0], [-5.0, 5.0], [-5.0, -5.0], [5.0, -5.0]])


def slot(width_um):
    """Return the outline of a 40 x 20 block with a slot, 8 deep, in the middle of its top."""
    half = width_um / 2.0
    corners = [[20, -10], [20, 10], [half, 10], [half, 2], [-half, 2], [-half, 10], [-20, 10]]
    return polygon_section(np.array([*corners, [-20, -10]], dtype=float), XY_PLANE)


def flower(petals, depth_um):
    """Return the outline with radius 20 + depth cos(petals · angle)."""

    def point_um(t):
        radius = 20.0 + depth_um * np.cos(petals * t)
        return radius[:, None] * np.column_stack([np.cos(t), np.sin(t)])

    def derivative_um(t):
        radius = 20.0 + depth_um * np.cos(petals * t)
        growth = -depth_um * petals * np.sin(petals * t)
        along = np.column_stack([np.cos(t), np.sin(t)])
        return growth[:, None] * along + radius[:, None] * (along[:, ::-1] * [-1.0, 1.0])

    return parametric_section(XY_PLANE, point_um, derivative_um)


def test_phase_of_a_circle_is_its_angle_times_the_ratio_of_radii():
    """On a circle of radius R the centre runs (R + r)/r rad of phase per rad of angle."""
    curve = offset_curve(ellipse_section(9.0, 9.0, XY_PLANE), RADIUS_UM)
    angle = np.linspace(-7.0, 7.0, 101)
    points = curve.at(angle * (9.0 + RADIUS_UM) / RADIUS_UM)
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(points.centre_um, 13.5 * direction, atol=1e-9)
    np.testing.assert_allclose(points.contact_um, 9.0 * direction, atol=1e-9)
    np.testing.assert_allclose(points.normal, direction, atol=1e-9)
    assert points.admissible.all()


def test_ellipse_has_the_contacts_of_the_paper():
    """T = (P + 2πr)/r, 74 contacts at 20°, and J half a turn from I."""
    curve = offset_curve(ellipse_section(16.2, 11.6, XY_PLANE), RADIUS_UM)
    perimeter_um = 4.0 * 16.2 * ellipe(1.0 - (11.6 / 16.2) ** 2)
    assert curve.length_rad == pytest.approx(perimeter_um / RADIUS_UM + 2.0 * math.pi, abs=1e-8)
    assert round(curve.length_rad / math.radians(20.0)) == 74
    assert curve.phase_of_joint_j == pytest.approx(curve.length_rad / 2.0, abs=1e-12)


@given(st.integers(0, 100_000), st.floats(0.1, 20.0))
@settings(max_examples=60, deadline=None)
def test_turn_of_convex_polygons(seed, radius_um):
    """T = (P + 2πr)/r for any convex polygon: corners add arcs of 2πr in all."""
    points = np.random.default_rng(seed).normal(size=(12, 2)) * 10.0
    hull = ConvexHull(points)
    corners = points[hull.vertices]
    section = polygon_section(corners - corners.mean(axis=0), XY_PLANE)
    curve = offset_curve(section, radius_um)
    perimeter_um = hull.area  # of a 2-D hull
    assert curve.length_rad == pytest.approx((perimeter_um + 2 * math.pi * radius_um) / radius_um)
    assert len(curve.kinks_rad) == 0
    assert curve.unreachable_share == pytest.approx(0.0, abs=1e-12)


def test_square_by_hand():
    """Half an edge, a quarter arc about the corner, an edge: phases and places by hand."""
    curve = offset_curve(polygon_section(SQUARE, XY_PLANE), RADIUS_UM)
    half, quarter = 5.0 / RADIUS_UM, math.pi / 2.0
    phase = [0.0, half, half + quarter / 2.0, half + quarter, 2.0 * half + quarter]
    diagonal = 5.0 + RADIUS_UM / math.sqrt(2.0)
    np.testing.assert_allclose(
        curve.at(np.array(phase)).centre_um,
        [[9.5, 0.0], [9.5, 5.0], [diagonal, diagonal], [5.0, 9.5], [0.0, 9.5]],
        atol=1e-12,
    )
    np.testing.assert_allclose(
        curve.at(np.array(phase)).contact_um,
        [[5.0, 0.0], [5.0, 5.0], [5.0, 5.0], [5.0, 5.0], [0.0, 5.0]],
        atol=1e-12,
    )
    assert curve.length_rad == pytest.approx(8.0 * half + 4.0 * quarter)
    assert curve.phase_of_joint_j == pytest.approx(4.0 * half + 2.0 * quarter)


def test_slot_narrower_than_the_tip_by_hand():
    """A slot of 6 holds a tip of 9 by its two rims: one kink, and walls and floor out of reach."""
    curve = offset_curve(slot(6.0), RADIUS_UM)
    kink = curve.at(curve.kinks_rad)
    np.testing.assert_allclose(
        kink.centre_um, [[0.0, 10.0 + math.sqrt(RADIUS_UM**2 - 9.0)]], atol=1e-9
    )
    outside_um = 20.0 + 40.0 + 20.0 + 17.0 + 17.0
    rims_um = 2.0 * RADIUS_UM * math.asin(3.0 / RADIUS_UM)
    turn_um = outside_um + 2.0 * math.pi * RADIUS_UM + rims_um
    assert curve.length_rad * RADIUS_UM == pytest.approx(turn_um)
    assert curve.unreachable_share == pytest.approx(22.0 / (outside_um + 22.0))


def test_slot_wider_than_the_tip_by_hand():
    """In a slot of 12 the tip reaches the floor, but not its corners: two kinks."""
    curve = offset_curve(slot(12.0), RADIUS_UM)
    np.testing.assert_allclose(
        curve.at(curve.kinks_rad).centre_um, [[1.5, 6.5], [-1.5, 6.5]], atol=1e-12
    )
    assert curve.unreachable_share == pytest.approx(4.0 * RADIUS_UM / (20 + 40 + 20 + 28 + 28))


def test_kinks_of_a_flower_lie_between_its_petals():
    """A tip too large for the hollows touches two petals: where, is a root in one unknown."""
    petals, depth_um = 7, 6.0
    curve = offset_curve(flower(petals, depth_um), RADIUS_UM)
    assert len(curve.kinks_rad) == petals

    def gap_um(distance):
        t = np.linspace(0.0, math.pi / petals, 20001)
        radius = 20.0 + depth_um * np.cos(petals * t)
        middle = distance * np.array([math.cos(math.pi / petals), math.sin(math.pi / petals)])
        away = np.hypot(radius * np.cos(t) - middle[0], radius * np.sin(t) - middle[1])
        return away.min() - RADIUS_UM

    distance = brentq(gap_um, 21.0, 31.0)
    angle = math.pi * (2.0 * np.arange(petals) + 1.0) / petals
    np.testing.assert_allclose(
        curve.at(curve.kinks_rad).centre_um,
        distance * np.column_stack([np.cos(angle), np.sin(angle)]),
        atol=1e-5,
    )


def test_smooth_hollow_wider_than_the_tip_is_rolled_through():
    """The waist of the concave object is all within reach: T = (P + 2πr)/r, no kink."""
    section = waisted_section(36.5, 16.0, 76.0, XY_PLANE)
    curve = offset_curve(section, RADIUS_UM)
    assert not section.is_convex
    assert len(curve.kinks_rad) == 0
    turn_um = section.perimeter_um + 2.0 * math.pi * RADIUS_UM
    assert curve.length_rad * RADIUS_UM == pytest.approx(turn_um, rel=1e-12)


def _curvature(t, a, b):
    return a * b / (a**2 * np.sin(t) ** 2 + b**2 * np.cos(t) ** 2) ** 1.5


@pytest.mark.parametrize('axes', [(16.2, 11.6), (8.0, 20.0)])
@pytest.mark.parametrize('roll_rad', [-5.0, -0.3, 0.7, 6.0])
def test_rolling_by_the_ode_moves_the_phase_by_the_angle(axes, roll_rad):
    """Integrating ds = −dθ/(κ + 1/r) over the ellipse ends at the contact of phase x − θ."""
    a, b = axes
    curve = offset_curve(ellipse_section(a, b, XY_PLANE), RADIUS_UM)
    start = curve.at(2.2).contact_um[0]
    t0 = math.atan2(start[1] / b, start[0] / a)

    def per_angle(_, t):
        speed_um = np.hypot(a * np.sin(t), b * np.cos(t))
        return -1.0 / ((_curvature(t, a, b) + 1.0 / RADIUS_UM) * speed_um)

    solution = solve_ivp(per_angle, (0.0, roll_rad), [t0], rtol=1e-10, atol=1e-12)
    t1 = solution.y[0, -1]
    end = curve.at(2.2 - roll_rad).contact_um[0]
    np.testing.assert_allclose(end, [a * math.cos(t1), b * math.sin(t1)], atol=3e-5)


@given(st.integers(0, 100_000), st.floats(0.3, 8.0))
@settings(max_examples=40, deadline=None)
def test_centre_is_one_radius_from_any_outline(seed, radius_um):
    """Brute force on spiky stars: distance r from contact and outline, and no jump at kinks."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 30))
    angle = np.sort(rng.uniform(0.0, 2.0 * math.pi, count))
    reach = rng.uniform(3.0, 20.0, count)
    assume(np.diff(angle, append=angle[0] + 2.0 * math.pi).max() < math.pi)  # origin inside
    corners = reach[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    section = polygon_section(corners, XY_PLANE)
    curve = offset_curve(section, radius_um)
    phase = np.linspace(0.0, curve.length_rad, 1500, endpoint=False)
    points = curve.at(phase)
    outline_um = outline_points_um(section, 0.1, 40)
    away_um = distance_um(points.centre_um, outline_um)
    assert away_um.min() > radius_um - 1e-7
    np.testing.assert_allclose(points.centre_um - points.contact_um, radius_um * points.normal)
    step_um = np.linalg.norm(np.diff(points.centre_um, axis=0), axis=1)
    assert step_um.max() <= radius_um * phase[1] + 1e-7
    # Contacts are on the outline, up to the spacing of its points.
    spacing_um = np.linalg.norm(np.diff(outline_um, axis=0), axis=1).max()
    assert distance_um(points.contact_um, outline_um).max() <= spacing_um


@pytest.mark.parametrize('width_um', [6.0, 8.9, 9.1, 12.0])
def test_whatever_is_reachable_is_reached(width_um):
    """Every place at distance r from the outline, seen from outside, is on the path."""
    section = slot(width_um)
    curve = offset_curve(section, RADIUS_UM)
    outline_um = outline_points_um(section, 0.02, 200)
    arcs = section.arcs.split(0.02)
    row = np.repeat(np.arange(len(arcs)), 20)
    contact_um, normal = arcs.points(row, np.tile(np.arange(20) / 20.0, len(arcs)))
    centre_um = contact_um + RADIUS_UM * normal
    free_um = centre_um[distance_um(centre_um, outline_um) > RADIUS_UM - 1e-3]
    path_um = curve.at(np.linspace(0.0, curve.length_rad, 8000)).centre_um
    assert distance_um(free_um, path_um).max() < 0.06


def test_phases_repeat_after_a_turn_and_start_on_the_axis():
    """at() is periodic; at phase 0 and at joint J the centre is on the X axis."""
    curve = offset_curve(waisted_section(36.5, 16.0, 76.0, XZ_PLANE), RADIUS_UM)
    phase = np.linspace(0.0, curve.length_rad, 50, endpoint=False)
    for turns in (-2, 1, 5):
        shifted = curve.at(phase + turns * curve.length_rad)
        np.testing.assert_allclose(shifted.centre_um, curve.at(phase).centre_um, atol=1e-9)
    joints = curve.at(np.array([0.0, curve.phase_of_joint_j])).centre_um
    np.testing.assert_allclose(joints, [[41.0, 0.0], [-41.0, 0.0]], atol=1e-9)


def test_outermost_crossing_is_joint_i():
    """A hook that crosses +X three times is met by the tip that comes along the axis."""
    hook = np.array([[4, -4], [30, -4], [30, 6], [18, 6], [18, 4], [27, 4], [27, -1], [4, -1],
                     [4, 4], [-4, 4], [-4, -4]], dtype=float)  # fmt: skip
    curve = offset_curve(polygon_section(hook, XY_PLANE), 1.0)
    np.testing.assert_allclose(curve.at(0.0).centre_um, [[31.0, 0.0]], atol=1e-12)


def test_rolling_is_refused_across_kinks_only():
    """rolls_freely agrees with counting kinks between the phases, over several turns."""
    curve = offset_curve(slot(12.0), RADIUS_UM)
    rng = np.random.default_rng(7)
    start = rng.uniform(-100.0, 100.0, 300)
    end = start + rng.uniform(-30.0, 30.0, 300)
    turns = curve.length_rad * np.arange(-8, 9)
    kinks = (curve.kinks_rad[:, None] + turns).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    met = ((kinks >= low[:, None]) & (kinks <= high[:, None])).any(axis=1)
    assert met.any()
    assert not met.all()
    np.testing.assert_array_equal(curve.rolls_freely(start, end), ~met)


def test_origin_outside_is_named():
    """A section beside the origin has no joints: the message says on which side none is met."""
    with pytest.raises(InadmissibleContact, match=r'\+X axis in the plane normal to Z'):
        offset_curve(polygon_section(SQUARE - [30.0, 0.0], XY_PLANE), RADIUS_UM)


@pytest.mark.parametrize('radius_um', [0.0, -4.5, math.nan, math.inf, 1e6])
def test_impossible_radii_are_bad_requests(radius_um):
    """The radius of a tip is a number of plausible size."""
    with pytest.raises(BadRequest, match='finger-radius'):
        offset_curve(polygon_section(SQUARE, XY_PLANE), radius_um)
