# SPDX-License-Identifier: Apache-2.0
"""Ways of a free finger: off the object by the first way that is free, around it, and no other."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microhand_planner.core.errors import InadmissibleContact
from microhand_planner.core.parameters import Finger
from microhand_planner.core.transfer import waiting_radius_um, way_around, way_out

FINGER = Finger(radius_um=4.5, clearance_um=0.0)
RADIUS_UM = 40.0
X, Y, Z = np.eye(3)
NOBODY = np.zeros((0, 3))


def free(_centres_um):
    """Nothing is in the way."""
    return False


def out(contact_um, normal, others_um=NOBODY, blocked=free, finger=FINGER):
    """Return the way out of a contact in the XY plane."""
    return way_out(contact_um, normal, Z, np.asarray(others_um), RADIUS_UM, finger, blocked)


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.floats(0.0, 2 * math.pi), st.floats(5.0, 30.0), st.floats(-1.0, 1.0))
def test_way_out_goes_along_the_normal_to_the_sphere(angle, distance_um, lean):
    """Free of obstacles it is a straight line along the normal, closely spaced, to the sphere."""
    contact_um = distance_um * np.array([math.cos(angle), math.sin(angle), 0.0])
    normal = np.array([math.cos(angle + lean), math.sin(angle + lean), 0.0])
    way_um = out(contact_um, normal)
    assert np.array_equal(way_um[0], contact_um)
    assert np.linalg.norm(way_um[-1]) == pytest.approx(RADIUS_UM)
    along = (way_um - contact_um) @ normal
    assert np.all(np.diff(along) > 0.0)
    assert way_um == pytest.approx(contact_um + along[:, None] * normal, abs=1e-9)
    assert np.max(np.diff(along)) <= 1.0 + 1e-9


def test_another_tip_in_the_way_sends_it_out_of_the_plane():
    """With a tip straight ahead the finger backs off by its radius, then leaves upwards."""
    way_um = out(15.0 * X, X, others_um=[30.0 * X])
    assert way_um[-1] == pytest.approx([19.5, 0.0, math.sqrt(40.0**2 - 19.5**2)])
    assert np.min(np.linalg.norm(way_um - 30.0 * X, axis=1)) >= 9.0
    assert np.max(way_um[:, 0]) == pytest.approx(19.5)


def test_object_above_sends_it_below():
    """If the ways along the normal and upwards are blocked, it leaves downwards."""
    way_um = out(
        15.0 * X, X, blocked=lambda c: bool(np.any(c[:, 2] > 1.0) or np.any(c[:, 0] > 25.0))
    )
    assert way_um[-1] == pytest.approx([19.5, 0.0, -math.sqrt(40.0**2 - 19.5**2)])


def test_contact_that_is_shut_in_is_refused():
    """If every way is blocked, the error names the contact and what is allowed."""
    with pytest.raises(InadmissibleContact, match=r'15\.0, 0\.0, 0\.0.*shut in; allowed'):
        out(15.0 * X, X, blocked=lambda c: True)


def test_clearance_is_kept_on_the_way_out():
    """A tip beside the way that is clear without clearance blocks it with one."""
    beside_um = np.array([[25.0, 9.5, 0.0]])
    straight = out(15.0 * X, X, others_um=beside_um)
    assert straight[-1] == pytest.approx([40.0, 0.0, 0.0])
    bent = out(15.0 * X, X, others_um=beside_um, finger=Finger(4.5, 1.0))
    assert bent[-1][2] > 30.0
    assert np.min(np.linalg.norm(bent - beside_um, axis=1)) >= 10.0


def test_the_contact_itself_is_not_an_obstacle():
    """A tip touches the object where its way begins: only the rest of the way must be free."""
    asked = []

    def remember(centres_um):
        asked.append(centres_um)
        return False

    way_um = out(15.0 * X, X, blocked=remember)
    assert np.array_equal(asked[0], way_um[1:])


unit = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@settings(derandomize=True, max_examples=150, deadline=None)
@given(unit, unit)
def test_way_around_is_a_great_circle(start, goal):
    """All of it is on the sphere and in one plane with the centre, and it is the short way."""
    start_um, goal_um = (RADIUS_UM * np.array(v) / np.linalg.norm(v) for v in (start, goal))
    way_um = way_around(start_um, goal_um)
    assert np.array_equal(way_um[0], start_um)
    assert np.array_equal(way_um[-1], goal_um)
    assert np.linalg.norm(way_um, axis=1) == pytest.approx(RADIUS_UM)
    assert np.linalg.eigvalsh(way_um.T @ way_um)[0] < 1e-9 * RADIUS_UM**2
    angle = math.atan2(np.linalg.norm(np.cross(start_um, goal_um)), start_um @ goal_um)
    chords_um = np.linalg.norm(np.diff(way_um, axis=0), axis=1)
    assert chords_um.sum() == pytest.approx(RADIUS_UM * angle, rel=1e-3, abs=1e-6)
    assert np.max(chords_um) <= RADIUS_UM * math.radians(3.0) + 1e-9


def test_way_around_to_the_opposite_point_keeps_to_the_sphere():
    """Half a turn has no short way: any great circle will do, but it must be one."""
    way_um = way_around(RADIUS_UM * Y, -RADIUS_UM * Y)
    assert np.linalg.norm(way_um, axis=1) == pytest.approx(RADIUS_UM)
    assert np.max(np.linalg.norm(np.diff(way_um, axis=0), axis=1)) < 2.2
    assert np.array_equal(way_um[-1], -RADIUS_UM * Y)


def test_way_around_to_where_it_is_stays_there():
    """No distance, no detour."""
    way_um = way_around(RADIUS_UM * X, RADIUS_UM * X)
    assert np.array_equal(way_um, np.array([RADIUS_UM * X, RADIUS_UM * X]))


@pytest.mark.parametrize('bounding_um', [0.5, 10.0, 300.0])
@pytest.mark.parametrize('clearance_um', [0.0, 2.0])
def test_waiting_fingers_are_out_of_reach(bounding_um, clearance_um):
    """Chords of the waiting sphere stay clear of any tip that holds, in whatever orientation."""
    finger = Finger(4.5, clearance_um)
    radius_um = waiting_radius_um(bounding_um, finger)
    way_um = way_around(radius_um * X, radius_um * (X + 2 * Y + Z) / math.sqrt(6.0))
    shares = np.linspace(0.0, 1.0, 21)[:, None, None]
    on_chords = (way_um[:-1] + shares * np.diff(way_um, axis=0)).reshape(-1, 3)
    holders_reach_um = bounding_um + finger.radius_um
    nearest_um = np.min(np.linalg.norm(on_chords, axis=1)) - holders_reach_um
    assert nearest_um >= finger.min_distance_um - 1e-9
