# SPDX-License-Identifier: Apache-2.0
"""Admissible contacts in three dimensions, on solids whose answer follows by hand."""

import math

import numpy as np
import pytest
import trimesh

from microhand_planner.core.analytic_sections import waisted_section
from microhand_planner.core.blocked_phases import blocked_intervals
from microhand_planner.core.cut_section import cut_section
from microhand_planner.core.errors import InadmissibleContact
from microhand_planner.core.joints import check_joints
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import Finger
from microhand_planner.core.part import make_part
from microhand_planner.core.section import XY_PLANE, XZ_PLANE
from microhand_planner.core.tip_clearance import distance_to_part
from tests.planner.solids import ellipsoid, joined, random_rotation

RADIUS_UM = 4.5


def curves(part, radius_um=RADIUS_UM):
    """Return the XY and XZ offset curves of a part."""
    return [
        offset_curve(cut_section(part, plane), radius_um, part) for plane in (XY_PLANE, XZ_PLANE)
    ]


@pytest.mark.parametrize('at_most_um', [2.0, 9.0, 60.0])
def test_distances_equal_those_of_every_face(at_most_um):
    """The culled search agrees with trimesh's closest point over all faces."""
    part = ellipsoid((16.2, 11.6, 7.0), 3, random_rotation(2))
    points_um = np.random.default_rng(3).normal(size=(200, 3)) * 15.0
    mesh = trimesh.Trimesh(part.vertices_um, part.faces, process=False)
    exact = trimesh.proximity.closest_point_naive(mesh, points_um)[1]
    found = distance_to_part(points_um, part, at_most_um)
    np.testing.assert_allclose(found, np.minimum(exact, at_most_um), atol=1e-9)


@pytest.mark.parametrize('seed', [None, 4])
def test_whole_ellipsoid_is_admissible(seed):
    """Facets, in whatever position, block nothing."""
    rotation = None if seed is None else random_rotation(seed)
    xy, xz = curves(ellipsoid((16.2, 11.6, 11.6), 4, rotation))
    for curve in (xy, xz):
        assert curve.inadmissible_share == 0.0
        assert curve.rolls_freely(0.0, curve.length_rad)
    check_joints(xy, xz, Finger())


def test_eaves_block_what_is_under_them():
    """Under eaves 2 µm above the plane, the tip stands only where it clears them: by hand.

    A post of 10 x 10 carries a slab that juts out by 10 on the +X side. About the corner (5, 5)
    the centre (5 + r cos φ, 5 + r sin φ) is sqrt((r sin φ)² + 2²) from the slab's edge.
    """
    part = make_part('crane', *joined(((-5, 5), (-5, 5), (-9, 2)), ((-5, 15), (-5, 5), (2, 6))))
    curve, _ = curves(part)
    allowed_um = 0.999 * RADIUS_UM
    corner_rad = math.asin(math.sqrt(allowed_um**2 - 2.0**2) / RADIUS_UM)
    end = 5.0 / RADIUS_UM + corner_rad
    np.testing.assert_allclose(
        curve.blocked_rad, [[0.0, end], [curve.length_rad - end, curve.length_rad]], atol=2e-6
    )
    assert curve.inadmissible_share == pytest.approx(2.0 * end / curve.length_rad, abs=1e-6)
    assert not curve.at(0.0).admissible
    assert curve.at(end + 0.001).admissible
    assert not curve.at(-end + 0.001).admissible
    assert not curve.rolls_freely(-0.5 * math.pi - end, 0.0)
    assert curve.rolls_freely(end + 0.01, curve.length_rad - end - 0.01)


def test_second_leg_beside_the_outline_blocks():
    """A U cut across its legs: the outline is one leg, the other one is in the way."""
    part = make_part(
        'U',
        *joined(
            ((-5, 5), (-5, 5), (-9, 9)),
            ((12, 60), (-5, 5), (-9, 9)),
            ((-5, 60), (-5, 5), (-40, -9)),
        ),
    )
    section = cut_section(part, XY_PLANE)
    curve = offset_curve(section, RADIUS_UM, part)
    assert section.ignored_loops == 1
    assert not curve.at(0.0).admissible
    assert curve.at(curve.phase_of_joint_j).admissible


def test_surface_that_leans_out_of_the_plane_is_blocked():
    """On a sheared ellipsoid contacts are left only where the lean, by calculus, is below 0.02."""
    shear = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.05, 0.0, 1.0]])
    round_part = ellipsoid((16.2, 11.6, 11.6))
    part = make_part('sheared', round_part.vertices_um @ shear, round_part.faces)
    curve = offset_curve(cut_section(part, XY_PLANE), RADIUS_UM)
    phase = np.linspace(0.0, curve.length_rad, 2000)
    points = curve.at(phase)
    x, y = (points.contact_um / np.array([16.2, 11.6]) ** 2).T
    lean = np.abs(0.05 * x) / np.sqrt(x**2 + y**2 + (0.05 * x) ** 2)
    clear = np.abs(lean - 0.02) > 0.002
    np.testing.assert_array_equal(points.admissible[clear], lean[clear] < 0.02)
    assert 0.1 < curve.inadmissible_share < 0.9


def test_waist_of_the_concave_object_lets_the_tip_in():
    """At the waist the tip clears the lobes; a tip twice as large touches two places: kinks."""
    section = waisted_section(36.5, 16.0, 76.0, XY_PLANE)
    assert len(offset_curve(section, RADIUS_UM).kinks_rad) == 0
    assert len(offset_curve(section, 3.0 * RADIUS_UM).kinks_rad) == 2


@pytest.mark.parametrize(
    'intervals',
    [[], [(0.5, 1.0)], [(0.0, 0.3), (9.5, 10.0)], [(0.0, 10.0)], [(1.0, 2.0), (4.0, 4.5)]],
)
def test_blocked_intervals_are_found_to_a_microradian(intervals):
    """Intervals of a predicate come back, also over phase 0, with ends on the safe side."""

    def is_blocked(phase):
        return np.array([any(a <= x <= b for a, b in intervals) for x in phase], dtype=bool)

    found = blocked_intervals(is_blocked, 10.0)
    assert found.shape == (len(intervals), 2)
    for (start, end), (a, b) in zip(found, intervals, strict=True):
        assert a - 1e-6 <= start <= a
        assert b <= end <= b + 1e-6


def test_joint_that_two_sections_see_differently_is_refused():
    """On a body sheared in the plane, the tip on the X axis touches it beside the axis."""
    part = ellipsoid((16.2, 11.6, 11.6))
    shear = np.array([[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 1.0]])
    xy, xz = curves(make_part('sheared', part.vertices_um @ shear, part.faces))
    with pytest.raises(InadmissibleContact, match='joint I'):
        check_joints(xy, xz, Finger())


def test_joint_where_the_tip_cannot_stand_is_refused():
    """Eaves over joint I: the message names joint and plane."""
    crane = joined(((-5, 5), (-5, 5), (-9, 2)), ((-5, 15), (-5, 5), (2, 6)))
    xy, xz = curves(make_part('crane', *crane))
    with pytest.raises(InadmissibleContact, match='joint I is where the tip cannot stand'):
        check_joints(xy, xz, Finger())


def test_object_thinner_than_the_clearance_is_refused():
    """Tips at I and J of a plate of 1 µm cannot keep 2 µm apart."""
    part = make_part('plate', *joined(((-0.5, 0.5), (-9, 9), (-9, 9))))
    xy, xz = curves(part)
    check_joints(xy, xz, Finger(clearance_um=0.9))
    with pytest.raises(InadmissibleContact, match='thin along X'):
        check_joints(xy, xz, Finger(clearance_um=2.0))
