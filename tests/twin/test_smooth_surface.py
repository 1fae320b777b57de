# SPDX-License-Identifier: Apache-2.0
"""Smooth surfaces against formulas: where tips touch, and what stays sharp. Needs no ROS."""

import functools
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
import pytest
import trimesh

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.parameters import Finger
from microhand_planner.core.part import make_part
from microhand_planner.core.pose import Pose
from microhand_planner.core.section_curves import section_curves
from microhand_twin.nearest_point import MOST_CONTACTS, touched_places
from microhand_twin.object_shape import contains, ellipsoid_of
from microhand_twin.simulation import Simulation
from microhand_twin.smooth_surface import smooth_surface
from microhand_twin.surface_table import surface_table
from microhand_twin.world import build_world
from tests.planner.solids import ellipsoid, prism, random_rotation
from tests.twin.rolls import along_curve, roll

RADIUS_UM = 4.5
UNIT_UM = 10.0
# a, waist, flare, h of examples/make_parts.py
FORMULAS = {
    'ellipsoid': (16.2, 11.6, 0.0, 11.6),
    'convex': (36.5, 30.5, 4.0, 29.3),
    'concave': (36.5, 16.0, 76.0, 29.3),
}


def points_of_formula(name, count, seed):
    """Return points and normals of an object of the catalogue: half in each of its planes."""
    a, waist, flare, h = FORMULAS[name]
    sphere = np.random.default_rng(seed).normal(size=(count, 3))
    sphere[: count // 2, 2] = 0.0
    sphere[count // 2 :, 1] = 0.0
    sphere /= np.linalg.norm(sphere, axis=1)[:, None]
    x, y, z = sphere.T
    points_um = np.column_stack([a * x, (waist + flare * x**2) * y, h * z])
    # normals go with the inverse transposed derivative of the map from the sphere
    ny = y / (waist + flare * x**2)
    normals = np.column_stack([(x - 2.0 * flare * x * y * ny) / a, ny, z / h])
    return points_um, normals / np.linalg.norm(normals, axis=1)[:, None]


@functools.cache
def curves_of(name):
    """Return the paths of tips around an object of the catalogue, by axis."""
    return section_curves(find_part(name), Finger()).curves


def touches(part, centres_um, reach_um=0.005):
    """Return for each tip centre the list of (distance, point) that the twin finds [µm]."""
    table = surface_table(smooth_surface(part), RADIUS_UM, UNIT_UM)
    found = np.zeros((MOST_CONTACTS, 4))
    result = []
    for centre_um in np.atleast_2d(centres_um):
        reach = (RADIUS_UM + reach_um) / UNIT_UM
        number = touched_places(table, centre_um / UNIT_UM, reach, found)
        result.append([(found[i, 0] * UNIT_UM, found[i, 1:] * UNIT_UM) for i in range(number)])
    return result


@pytest.mark.parametrize('name', FORMULAS)
def test_tips_touch_where_the_formula_says(name):
    """Within 0.6 nm and 0.1° a tip finds the formula's surface, in hollows too, and once only."""
    points_um, normals = points_of_formula(name, 400, seed=4)
    centres_um = points_um + (RADIUS_UM - 0.002) * normals
    for centre_um, point_um, normal, found in zip(
        centres_um, points_um, normals, touches(find_part(name), centres_um), strict=True
    ):
        assert len(found) == 1
        distance_um, place_um = found[0]
        assert distance_um == pytest.approx(RADIUS_UM - 0.002, abs=6e-4)
        direction = (centre_um - place_um) / distance_um
        assert np.linalg.norm(np.cross(direction, normal)) < np.radians(0.1)
        assert place_um == pytest.approx(point_um, abs=0.02)


def test_flat_sides_stay_flat_and_edges_sharp():
    """On a box, tips touch sides, edges and corners exactly where elementary geometry says."""
    box = trimesh.creation.box(extents=[20.0, 14.0, 10.0])
    part = make_part('box', box.vertices, box.faces)
    rng = np.random.default_rng(5)
    centres_um = rng.uniform(-1.0, 1.0, size=(400, 3)) * [15.0, 12.0, 10.0]
    outside = np.maximum(np.abs(centres_um) - [10.0, 7.0, 5.0], 0.0)
    distance_um = np.linalg.norm(outside, axis=1)
    near = (distance_um > 0.0) & (distance_um < RADIUS_UM)
    nearest_um = np.clip(centres_um, [-10.0, -7.0, -5.0], [10.0, 7.0, 5.0])
    found = touches(part, centres_um[near])
    assert np.count_nonzero(near) > 100
    for places, far_um, point_um in zip(found, distance_um[near], nearest_um[near], strict=True):
        assert places[0][0] == pytest.approx(far_um, abs=1e-9)
        assert places[0][1] == pytest.approx(point_um, abs=1e-8)


def test_a_rounded_prism_keeps_its_flat_ends():
    """A coarse cylinder is round where it turns smoothly, and its ends stay plane and sharp."""
    angle = np.arange(48) * 2.0 * np.pi / 48
    vertices, faces = prism(12.0 * np.column_stack([np.cos(angle), np.sin(angle)]), 8.0)
    part = make_part('cylinder', vertices, faces)
    turned = np.linspace(0.0, 1.0, 23)
    around = np.column_stack([np.cos(turned), np.sin(turned), 0.0 * turned])
    side = touches(part, (12.0 + RADIUS_UM) * around + [0.0, 0.0, 2.0])
    assert [places[0][0] for places in side] == pytest.approx([RADIUS_UM] * 23, abs=2e-3)
    top = touches(part, 6.0 * around + [0.0, 0.0, 8.0 + RADIUS_UM])
    assert [places[0][0] for places in top] == pytest.approx([RADIUS_UM] * 23, abs=1e-9)


def test_a_tip_in_a_groove_touches_both_sides():
    """Between two walls that it touches both, a tip has two places, one on each."""
    # a V groove of 90° along z: its walls are tangent to the tip at 45°
    depth_um = 8.0
    groove = [(-20.0, -12.0), (20.0, -12.0), (20.0, 0.0), (depth_um, 0.0), (0.0, -depth_um),
              (-depth_um, 0.0), (-20.0, 0.0)]  # fmt: skip
    vertices, faces = prism(np.add(groove, (0.0, 10.0)), 15.0)
    part = make_part('groove', vertices, faces)
    centre_um = np.array([0.0, 10.0 - depth_um + np.sqrt(2.0) * RADIUS_UM, 1.0])
    (places,) = touches(part, centre_um)
    reach_um = RADIUS_UM / np.sqrt(2.0)
    assert len(places) == 2
    assert sorted(point[0] for _, point in places) == pytest.approx([-reach_um, reach_um])
    assert [far for far, _ in places] == pytest.approx([RADIUS_UM, RADIUS_UM])


def test_nothing_is_touched_from_afar():
    """A tip beyond reach finds no place."""
    assert touches(find_part('convex'), [[60.0, 0.0, 0.0], [0.0, 0.0, 34.0]]) == [[], []]


def test_ellipsoids_are_recognised():
    """An ellipsoid is found with its centre, semi-axes and directions, however it is turned."""
    turn = random_rotation(6)
    turn *= np.sign(np.linalg.det(turn))
    ball = ellipsoid((18.0, 12.0, 7.0))
    part = make_part('turned', ball.vertices_um @ turn.T + [1.0, -2.0, 3.0], ball.faces)
    found = ellipsoid_of(part)
    assert found is not None
    assert found.centre_um == pytest.approx([1.0, -2.0, 3.0], abs=1e-6)
    matrix = found.axes @ np.diag(found.semi_axes_um**2) @ found.axes.T
    assert matrix == pytest.approx(turn @ np.diag([18.0**2, 12.0**2, 7.0**2]) @ turn.T, abs=1e-4)
    assert np.linalg.det(found.axes) == pytest.approx(1.0)


@pytest.mark.parametrize('subdivisions', [0, 1])
def test_what_only_has_corners_on_an_ellipsoid_is_none(subdivisions):
    """A polyhedron inscribed into a ball is no ball; nor are the other catalogue objects."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=10.0)
    assert ellipsoid_of(make_part('polyhedron', ball.vertices, ball.faces)) is None
    assert ellipsoid_of(find_part('convex')) is None
    assert ellipsoid_of(find_part('concave')) is None


def test_what_is_inside_is_told_from_what_is_not():
    """Random points are inside an object of the catalogue exactly where its formula says."""
    a, waist, flare, h = FORMULAS['concave']
    points_um = np.random.default_rng(9).uniform(-40.0, 40.0, size=(200, 3))
    x, y, z = points_um.T / [[a], [1.0], [h]]
    depth = 1.0 - x**2 - (y / (waist + flare * x**2)) ** 2 - z**2
    clear = np.abs(depth) > 0.01  # not between a facet and the formula
    expected = depth[clear] > 0.0
    assert 20 < expected.sum() < 180
    assert np.array_equal(contains(find_part('concave'), points_um[clear]), expected)


@pytest.mark.parametrize('axis', ['z', 'y'])
@pytest.mark.parametrize('name', FORMULAS)
def test_half_a_turn_rolls_true(name, axis):
    """Rolled by 180° between joints I and J, an object ends within 0.02°, its grip as smooth."""
    part = find_part(name)
    curve = curves_of(name)[axis]
    contacts = along_curve(curve, (0.0, curve.phase_of_joint_j))
    rolled = roll(Simulation(build_world(part)), contacts, curve.plane.normal, 180.0, 1.5)
    assert rolled.error_deg.max() < 0.02
    assert rolled.friction_use.max() < 0.7
    assert np.abs(np.diff(rolled.normal_uN, axis=0)).max() < 0.02


def test_engine_and_patches_agree_on_an_ellipsoid(monkeypatch):
    """MuJoCo's own ellipsoid and the smooth surface of its mesh give the same roll."""
    part = ellipsoid((16.2, 11.6, 11.6))
    curve = section_curves(part, Finger()).curves['z']
    contacts = along_curve(curve, (0.0, curve.phase_of_joint_j))
    exact = build_world(part)
    monkeypatch.setattr('microhand_twin.world.ellipsoid_of', lambda part: None)
    smooth = build_world(part)
    assert (exact.smooth, smooth.smooth) == (False, True)
    one, other = (
        roll(Simulation(world), contacts, (0.0, 0.0, 1.0), 120.0, 2.0) for world in (exact, smooth)
    )
    assert one.error_deg == pytest.approx(other.error_deg, abs=0.01)
    assert one.normal_uN == pytest.approx(other.normal_uN, abs=0.02)


def test_other_models_and_other_threads_are_left_alone():
    """Outside of the twin a box stays a box; inside, threads leave each other their contacts."""
    box = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="box" size="1 1 1"/><body pos="0 0 1.4"><freejoint/>'
        '<geom size="0.5"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(box)

    def step_often(simulation):
        for _ in range(200):
            simulation.advance(simulation.command_um, 5e-5)
        return simulation.contacts().touching.tolist()

    simulations = [Simulation(build_world(find_part('convex'))) for _ in range(2)]
    for simulation in simulations:
        simulation.place(
            Pose(), [[41.0, 0.0, 0.0], [-41.0, 0.0, 0.0], [0.0, 0.0, 500.0]], fixed=True
        )
    with ThreadPoolExecutor(2) as threads:
        assert list(threads.map(step_often, simulations)) == [[True, True, False]] * 2
    mujoco.mj_forward(box, data)
    assert data.contact.dist == pytest.approx([-0.1])
