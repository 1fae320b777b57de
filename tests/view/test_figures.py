# SPDX-License-Identifier: Apache-2.0
"""What the scene is drawn from: bodies, ways and arrows keep their geometry."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_station.view.figures import UM_PER_UN, figure_of, force_arrow, tip_ways
from microhand_station.view.snapshot import Contact
from microhand_station.view.twin_mesh import figure_of_corners

TURN = Pose.of((0, 0, 0), Rotation.from_euler('ZYZ', [80, 60, 0], degrees=True))


def test_a_figure_bounds_what_its_part_bounds():
    """Corners are doubled at edges only: the volume stays, edges get corners of their own."""
    for name in ('ellipsoid', 'convex', 'concave'):
        part = find_part(name)
        figure = figure_of(part)
        before = trimesh.Trimesh(part.vertices_um, part.faces, process=False).volume
        after = trimesh.Trimesh(figure.vertices_um, figure.faces, process=False).volume
        assert after == pytest.approx(before, rel=1e-9)
    assert len(figure_of(find_part('ellipsoid')).vertices_um) == len(
        find_part('ellipsoid').vertices_um
    )


def test_a_body_given_corner_by_corner_is_drawn_as_from_its_file():
    """As the twin shows it: equal corners become one, and the volume is that of the part."""
    part = find_part('convex')
    figure = figure_of_corners(part.vertices_um[part.faces.ravel()])
    again = trimesh.Trimesh(figure.vertices_um, figure.faces, process=False)
    expected = trimesh.Trimesh(part.vertices_um, part.faces, process=False).volume
    assert again.volume == pytest.approx(expected, rel=1e-9)
    assert len(figure.vertices_um) < 3 * len(figure.faces) / 2


def test_ways_are_those_of_the_tips_from_the_first_to_the_last_waypoint():
    """Each way is connected, as long as what the tips travel, and has no piece of length 0."""
    plan = plan_reorientation(
        find_part('ellipsoid'), Pose(), TURN, Finger(), ContactLaw(), SearchOptions()
    )
    tips_um = np.concatenate([step.tip_um for step in plan.steps])
    travelled_um = np.linalg.norm(np.diff(tips_um, axis=0), axis=-1).sum(axis=0)
    for finger, way in enumerate(tip_ways(plan)):
        np.testing.assert_allclose(way[1:, 0], way[:-1, 1], atol=1e-9)
        lengths_um = np.linalg.norm(way[:, 1] - way[:, 0], axis=1)
        assert np.all(lengths_um > 0.0)
        assert lengths_um.sum() == pytest.approx(travelled_um[finger], rel=1e-9)
        if len(way):  # a finger may wait
            np.testing.assert_allclose(way[-1, 1], tips_um[-1, finger], atol=1e-9)


@given(
    arrays(float, 3, elements=st.floats(-40.0, 40.0)),
    arrays(float, 3, elements=st.floats(-30.0, 30.0)),
    st.booleans(),
)
def test_an_arrow_has_the_length_and_the_direction_of_its_force(point_um, force_uN, pushes):
    """Head minus tail is the force to scale; a push ends at the contact, a pull begins there."""
    contact = Contact(True, point_um, force_uN, 1.0 if pushes else -1.0, 0.5)
    tail_um, head_um = force_arrow(contact)
    np.testing.assert_allclose(head_um - tail_um, UM_PER_UN * force_uN, atol=1e-9)
    np.testing.assert_array_equal(head_um if pushes else tail_um, point_um)


def test_no_contact_has_no_arrow_that_could_be_drawn():
    """Its point is NaN, and so are both ends."""
    nothing = Contact(False, np.full(3, np.nan), np.zeros(3), 0.0, math.nan)
    assert np.all(np.isnan(force_arrow(nothing)))
