# SPDX-License-Identifier: Apache-2.0
"""Sections of meshes against the shapes that the meshes stand for."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ellipe

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.cut_section import cut_section
from microhand_planner.core.errors import BadRequest, EmptySection
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.part import make_part
from microhand_planner.core.section import XY_PLANE, XZ_PLANE
from tests.planner.solids import distance_um, ellipsoid, joined, prism, random_rotation

SEMI_AXES_UM = (16.2, 11.6, 11.6)
PERIMETER_UM = 4.0 * 16.2 * ellipe(1.0 - (11.6 / 16.2) ** 2)


def largest_differences(section, exact, radius_um=4.5):
    """Return the largest distance of contacts [µm] and angle of normals [rad] at equal phases."""
    curve, wanted = offset_curve(section, radius_um), offset_curve(exact, radius_um)
    share = np.linspace(0.0, 1.0, 5000)
    got = curve.at(share * curve.length_rad)
    true = wanted.at(share * wanted.length_rad)
    cross = got.normal[:, 0] * true.normal[:, 1] - got.normal[:, 1] * true.normal[:, 0]
    return np.linalg.norm(got.contact_um - true.contact_um, axis=1).max(), np.abs(cross).max()


@pytest.mark.parametrize('plane', [XY_PLANE, XZ_PLANE])
@pytest.mark.parametrize('seed', [None, 0, 1, 2, 3])
def test_facets_of_an_ellipsoid_do_not_show(seed, plane):
    """5120 facets, however they lie: contacts within 0.004 µm and normals within 0.05°.

    Seed None has vertices, edges and so whole facets' sides in the plane.
    """
    rotation = None if seed is None else random_rotation(seed)
    section = cut_section(ellipsoid(SEMI_AXES_UM, 4, rotation), plane)
    contact_um, normal_rad = largest_differences(section, ellipse_section(16.2, 11.6, plane))
    assert contact_um < 0.004
    assert math.degrees(normal_rad) < 0.05
    assert section.perimeter_um == pytest.approx(PERIMETER_UM, abs=5e-4)
    assert section.is_convex
    assert np.abs(section.out_of_plane_sin).max() < 0.002


def test_accuracy_grows_with_the_facets():
    """Four times the facets, a tenth of the error or less; 320 facets are still within 0.5°."""
    exact = ellipse_section(16.2, 11.6, XY_PLANE)
    errors = [
        largest_differences(
            cut_section(ellipsoid(SEMI_AXES_UM, level, random_rotation(5)), XY_PLANE), exact
        )
        for level in (2, 3, 4, 5)
    ]
    assert errors[0][0] < 0.06
    assert math.degrees(errors[0][1]) < 0.5
    contact_um = [error[0] for error in errors]
    assert contact_um[3] < contact_um[2] < contact_um[1] < contact_um[0]
    assert contact_um[3] < 0.001


def test_stated_facet_gap_covers_the_facets():
    """The outline is nowhere further from the facets than it says, nor much less."""
    part = ellipsoid(SEMI_AXES_UM, 3, random_rotation(6))
    section = cut_section(part, XY_PLANE)
    mesh = trimesh.Trimesh(part.vertices_um, part.faces, process=False)
    points_um = section.plane.to_object(section.points_um)
    gap_um = trimesh.proximity.closest_point_naive(mesh, points_um)[1].max()
    assert 0.5 * section.facet_gap_um < gap_um <= section.facet_gap_um


@given(st.floats(0.0, 2.0 * math.pi))
@settings(max_examples=10, deadline=None)
def test_section_turns_with_the_part(angle_rad):
    """Turning a box about Z turns its section and changes nothing else."""
    vertices, faces = prism([[9, 5], [-9, 5], [-9, -5], [9, -5]], 3.0)
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turned = vertices @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    section = cut_section(make_part('box', turned, faces), XY_PLANE)
    assert section.perimeter_um == pytest.approx(56.0, abs=1e-9)
    corners = section.arc_length_um < 1e-9
    np.testing.assert_allclose(section.turn_rad[corners], [math.pi / 2.0] * 4, atol=1e-9)


@pytest.mark.parametrize('chords', [5, 8, 16])
@pytest.mark.parametrize('fillet_um', [0.3, 3.0])
def test_rounded_box_keeps_its_edges_straight(chords, fillet_um):
    """Fillets become round; straight edges stay straight, and as long as they are."""
    a, b = 20.0 - fillet_um, 10.0 - fillet_um
    quarter = np.linspace(0.0, math.pi / 2.0, chords + 1)
    polygon = np.vstack(
        [
            np.array(centre) + fillet_um * np.column_stack([np.cos(angle), np.sin(angle)])
            for centre, angle in (
                ((a, b), quarter),
                ((-a, b), quarter + 0.5 * math.pi),
                ((-a, -b), quarter + math.pi),
                ((a, -b), quarter + 1.5 * math.pi),
            )
        ]
    )
    section = cut_section(make_part('box', *prism(polygon, 4.0)), XY_PLANE)
    straight = np.abs(section.turn_rad) < 1e-9
    assert sorted(section.arc_length_um[straight]) == pytest.approx(
        [2 * b, 2 * b, 2 * a, 2 * a], abs=1e-9
    )
    exact_um = 4.0 * (a + b) + 2.0 * math.pi * fillet_um
    assert section.perimeter_um == pytest.approx(exact_um, abs=3e-4 * fillet_um)
    # No normal in a fillet is off: centre and radius of the fillets give the outline points.
    outer = np.maximum(np.abs(section.points_um) - [a, b], 0.0)
    assert np.abs(np.hypot(*outer.T) - fillet_um).max() < 2e-4 * fillet_um


@pytest.mark.parametrize(('sides', 'corners'), [(5, 5), (12, 12), (17, 17), (18, 0), (36, 0)])
def test_turns_above_twenty_degrees_are_corners(sides, corners):
    """A prism of 17 sides has corners; one of 18 or more stands for a cylinder."""
    angle = 2.0 * math.pi * (np.arange(sides) + 0.5) / sides
    polygon = 10.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    section = cut_section(make_part('prism', *prism(polygon, 5.0)), XY_PLANE)
    assert (section.arc_length_um < 1e-9).sum() == corners
    if corners:
        assert section.perimeter_um == pytest.approx(20.0 * sides * math.sin(math.pi / sides))
    else:
        assert section.perimeter_um == pytest.approx(20.0 * math.pi, abs=5e-3)


def test_gentle_bend_between_long_edges_is_a_corner():
    """A gable of 5.7° on either side is no arc: its edges are straight, its ridge is sharp."""
    gable = [[20.0, -10.0], [20.0, 8.0], [0.0, 10.0], [-20.0, 8.0], [-20.0, -10.0]]
    section = cut_section(make_part('gable', *prism(gable, 5.0)), XY_PLANE)
    corners = section.arc_length_um < 1e-9
    slope = math.degrees(math.atan(0.1))
    assert sorted(np.degrees(section.turn_rad[corners])) == pytest.approx(
        [2 * slope, 90 - slope, 90 - slope, 90, 90]
    )


def test_long_straight_edges_do_not_bow_between_fine_facets():
    """The cylinder of a capsule, one ruling long, is cut as a circle."""
    capsule = trimesh.creation.capsule(height=20.0, radius=6.0, count=[32, 32])
    vertices = capsule.vertices - capsule.center_mass
    section = cut_section(make_part('capsule', vertices, capsule.faces), XY_PLANE)
    np.testing.assert_allclose(np.linalg.norm(section.points_um, axis=1), 6.0, atol=1e-3)


def test_box_is_cut_through_its_diagonals():
    """Coplanar facets make one straight edge: 4 corners, 4 edges, nothing else."""
    box = trimesh.creation.box(extents=[20.0, 10.0, 6.0])
    for _ in range(3):
        box = box.subdivide()
    for plane, v_um in ((XY_PLANE, 10.0), (XZ_PLANE, 6.0)):
        section = cut_section(make_part('box', box.vertices, box.faces), plane)
        assert len(section.points_um) == 8
        assert section.perimeter_um == pytest.approx(2.0 * (20.0 + v_um), abs=1e-12)
        assert section.facet_gap_um < 1e-9


def test_face_in_the_plane_is_cut_from_below():
    """Where a step lies in the plane, the section is that of the material under it."""
    step = joined(((-10, 10), (-8, 8), (-5, 0)), ((-4, 4), (-3, 3), (0, 5)))
    section = cut_section(make_part('step', *step), XY_PLANE)
    assert section.perimeter_um == pytest.approx(2.0 * (20.0 + 16.0))
    assert section.ignored_loops == 0


def test_outer_loop_of_a_ring_is_taken():
    """A torus cut along its plane has two loops: the outer one counts, the hole is counted."""
    torus = trimesh.creation.torus(20.0, 6.0, 128, 64)
    section = cut_section(make_part('torus', torus.vertices, torus.faces), XY_PLANE)
    assert section.ignored_loops == 1
    np.testing.assert_allclose(np.linalg.norm(section.points_um, axis=1), 26.0, atol=0.01)


def test_section_beside_the_origin_is_empty():
    """A torus cut across has two loops beside the origin, none around it: a clear refusal."""
    torus = trimesh.creation.torus(20.0, 6.0)
    with pytest.raises(EmptySection, match='origin is outside the section of torus normal to Y'):
        cut_section(make_part('torus', torus.vertices, torus.faces), XZ_PLANE)


@pytest.mark.parametrize('shift_um', [3.0, 3.5, -3.0, 40.0])
def test_plane_that_misses_the_object_is_refused(shift_um):
    """Beside the box, or only touching a face of it; the message says from where to where."""
    box = trimesh.creation.box(extents=[20.0, 10.0, 6.0])
    part = make_part('box', box.vertices + np.array([0.0, 0.0, shift_um]), box.faces)
    with pytest.raises(EmptySection, match=f'z runs from {shift_um - 3:g} to {shift_um + 3:g}'):
        cut_section(part, XY_PLANE)


def test_leaning_surface_is_told():
    """A sheared ellipsoid's normals lean out of the plane as calculus says."""
    part = ellipsoid(SEMI_AXES_UM)
    shear = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.1, 0.0, 1.0]])
    sheared = make_part('sheared', part.vertices_um @ shear, part.faces)
    section = cut_section(sheared, XY_PLANE)
    x, y = (section.points_um / np.array(SEMI_AXES_UM[:2]) ** 2).T
    exact = np.abs(0.1 * x) / np.sqrt(x**2 + y**2 + (0.1 * x) ** 2)
    np.testing.assert_allclose(section.out_of_plane_sin, exact, atol=0.003)


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_any_star_shaped_prism_has_a_section_or_a_message(seed):
    """Needles, slivers and hollows: a closed outline on the polygon, or a bad request."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 60))
    angle = np.sort(rng.uniform(0.0, 2.0 * math.pi, count))
    radius = rng.uniform(2.0, 20.0, count)
    polygon = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    vertices, faces = prism(polygon, 5.0)
    if np.diff(angle, append=angle[0] + 2.0 * math.pi).max() > math.pi:
        with pytest.raises(BadRequest):  # the origin is outside
            cut_section(make_part('star', vertices, faces), XY_PLANE)
        return
    section = cut_section(make_part('star', vertices, faces), XY_PLANE)
    edge = np.roll(polygon, -1, axis=0) - polygon
    share = np.linspace(0.0, 1.0, 400)[None, :, None]
    on_polygon = (polygon[:, None] + share * edge[:, None]).reshape(-1, 2)
    spacing_um = np.linalg.norm(edge, axis=1).max() / 400
    away_um = distance_um(section.points_um, on_polygon)
    assert away_um.max() <= section.facet_gap_um + spacing_um
