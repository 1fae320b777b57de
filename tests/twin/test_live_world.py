# SPDX-License-Identifier: Apache-2.0
"""The object of a running station: put between fingers, released, held, dropped, waited for."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import Pose
from microhand_twin.ros.live_world import LOST_AFTER_S, NOT_ALLOWED, LiveWorld
from microhand_twin.world import build_world

STIFFNESS = 20.0
END_UM = 16.2 + 4.5
"""Distance of a tip's centre from the ellipsoid's, on its long axis."""
WAIST_UM = 11.6
"""Radius of the ellipsoid about its long axis."""
AWAY = np.array([[60.0, 0, 0], [-60.0, 0, 0], [0, 60.0, 0]])
TOUCHING = np.array([[END_UM, 0, 0], [-END_UM, 0, 0], [0, 60.0, 0]])
PRESS = np.array([[-0.2, 0, 0], [0.2, 0, 0], [0, 0, 0]])
FREE = np.full((3, 3), np.nan)


@pytest.fixture(scope='module')
def ellipsoid():
    """Return the world of the ellipsoid."""
    return build_world(find_part('ellipsoid'), stiffness_uN_per_um=STIFFNESS)


def gripping(world):
    """Return a live world whose fingers 1 and 2 press on the fixed object with 4 µN."""
    live = LiveWorld(world, Pose(), FREE)
    live.follow(AWAY, 0.0)
    live.follow(TOUCHING, 1.0)
    live.follow(TOUCHING + PRESS, 1.1)
    return live


def test_a_fixed_object_does_not_move_and_a_released_one_is_held_by_its_fingers(ellipsoid):
    """Pressed from one side it stays while fixed; released and gripped it follows the fingers."""
    live = LiveWorld(ellipsoid, Pose(), FREE)
    live.follow(AWAY, 0.0)
    assert not live.report.contacts.touching.any()
    live.follow(TOUCHING + PRESS * [[1.0], [0.0], [0.0]], 1.0)
    np.testing.assert_array_equal(live.report.pose.position_um, 0.0)
    live = gripping(ellipsoid)
    live.release()
    assert live.report.released
    live.follow(TOUCHING + PRESS + [0.5, -0.3, 0.2], 1.2)
    np.testing.assert_allclose(live.report.pose.position_um, [0.5, -0.3, 0.2], atol=0.01)
    assert live.report.lost_because == ''
    # the springs press with k times the way that they were bent by
    np.testing.assert_allclose(live.report.contacts.normal_uN[:2], STIFFNESS * 0.2, rtol=0.03)
    np.testing.assert_allclose(live.report.contacts.direction[0], [-1, 0, 0], atol=0.05)


@pytest.mark.parametrize(('fingers', 'who'), [([], 'no finger'), ([1], 'only finger 2')])
def test_release_needs_two_fingers(ellipsoid, fingers, who):
    """With fewer the object would fall: refused, and it stays fixed."""
    live = LiveWorld(ellipsoid, Pose(), FREE)
    live.follow(AWAY, 0.0)
    tips = np.array(AWAY)
    tips[fingers] = (TOUCHING + PRESS)[fingers]
    live.follow(tips, 1.0)
    with pytest.raises(RunFailed, match=f'{who} touches the object; allowed: at least 2') as error:
        live.release()
    assert error.value.code == NOT_ALLOWED
    assert not live.report.released


def test_an_object_that_only_one_finger_touches_is_lost_and_stays_lost(ellipsoid):
    """A finger that leaves takes 50 ms to be believed; coming back does not undo it."""
    live = gripping(ellipsoid)
    live.release()
    apart = TOUCHING + PRESS + [[5.0, 0, 0], [0, 0, 0], [0, 0, 0]]
    live.follow(apart, 1.4)
    live.follow(apart, 1.4 + 0.8 * LOST_AFTER_S)
    assert live.report.lost_because == ''
    live.follow(apart, 1.4 + 1.2 * LOST_AFTER_S)
    assert live.report.lost_because in ('only finger 2 touches it', 'no finger touches it')
    reason = live.report.lost_because
    live.follow(TOUCHING + PRESS, 2.5)
    assert live.report.lost_because == reason


def test_the_object_waits_until_no_finger_is_in_its_place(ellipsoid):
    """A tip inside: nothing touches, and release names it; once it is out, the object is there."""
    live = LiveWorld(ellipsoid, Pose(), FREE)
    inside = np.array(AWAY)
    inside[1] = [-10.0, 0, 0]
    live.follow(inside, 0.0)
    assert live.report.contacts is None
    with pytest.raises(RunFailed, match='finger 2: where the object is to be'):
        live.release()
    live.follow(AWAY, 0.5)
    assert live.report.contacts is not None
    np.testing.assert_array_equal(live.report.pose.position_um, 0.0)


def test_fingers_that_hold_from_the_beginning_are_put_at_their_contacts(ellipsoid):
    """Commanded 0.25 µm into the object by their grip, they are not in its way, and press."""
    holding = np.array(TOUCHING)
    holding[2] = np.nan
    live = LiveWorld(ellipsoid, Pose(), holding)
    live.follow(TOUCHING + 1.25 * PRESS, 0.0)
    live.follow(TOUCHING + 1.25 * PRESS, 0.1)
    live.release()
    live.follow(TOUCHING + 1.25 * PRESS, 0.3)
    assert live.report.lost_because == ''
    np.testing.assert_allclose(live.report.contacts.normal_uN[:2], STIFFNESS * 0.25, rtol=0.05)


def test_a_plan_goes_on_only_with_the_object_that_is_held_where_it_begins(ellipsoid):
    """The same object near the pose: yes. Another one, another pose, or a fixed object: no."""
    live = gripping(ellipsoid)
    sha256 = ellipsoid.part.sha256
    assert not live.holds(sha256, Pose())
    live.release()
    assert live.holds(sha256, Pose())
    assert not live.holds('0' * 64, Pose())
    assert not live.holds(sha256, Pose.of((2.0, 0, 0), Rotation.identity()))
    assert not live.holds(sha256, Pose.of((0, 0, 0), Rotation.from_rotvec([0, 0.1, 0])))


@pytest.mark.parametrize('reports', [40, 800])
def test_the_outcome_does_not_depend_on_how_often_stages_report(ellipsoid, reports):
    """A roll about the long axis, where the ellipsoid is as round as a sphere: 60° are 60°."""
    live = LiveWorld(ellipsoid, Pose(), FREE)
    live.follow(3.0 * around_waist_um(0.0), 0.0)
    live.follow(around_waist_um(0.0), 1.0)
    live.release()
    angle_rad = np.radians(60.0)
    for share in np.arange(1, reports + 1) / reports:
        live.follow(around_waist_um(share * angle_rad), 1.0 + 0.8 * share)
    turned = Rotation.from_rotvec([angle_rad, 0.0, 0.0]).inv() * live.report.pose.rotation
    assert np.degrees(turned.magnitude()) < 0.2
    assert live.report.lost_because == ''


def around_waist_um(angle_rad):
    """Return commands that roll the object about x by an angle, with 3 µN.

    A tip of radius r goes around a circle of radius R by R / (R + r) of the rolling angle.
    """
    at_rad = angle_rad * WAIST_UM / (WAIST_UM + 4.5)
    out = np.array([0.0, np.cos(at_rad), np.sin(at_rad)])
    distance_um = WAIST_UM + 4.5 - 3.0 / STIFFNESS
    return np.array([distance_um * out, -distance_um * out, [60.0, 0.0, 0.0]])
