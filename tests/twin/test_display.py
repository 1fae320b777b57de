# SPDX-License-Identifier: Apache-2.0
"""Frames and markers of object and fingers, as RViz is given them."""

import dataclasses

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker

from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import Pose
from microhand_twin.contacts import Contacts
from microhand_twin.ros.display import LOST_COLOR, finger_markers, transforms
from microhand_twin.ros.live_world import ObjectReport
from microhand_twin.ros.twin_parameters import TwinParameters

STAMP = Time(sec=12, nanosec=34)
STATION = TwinParameters(
    friction=-1.0,
    pull_off_uN=-1.0,
    base_um=np.zeros((3, 3)),
    stiffness_uN_per_um=np.full(3, 20.0),
    state_period_s=0.02,
    display_period_s=0.1,
    display_scale=1e4,
    frame='bench',
    frame_prefix='left/',
    catalogue='',
)
TURN = Rotation.from_rotvec([0.3, -1.2, 0.7])
REPORT = ObjectReport(
    pose=Pose.of((1.0, -2.0, 3.0), TURN),
    released=True,
    lost_because='',
    contacts=Contacts(
        touching=np.array([True, False, True]),
        normal_uN=np.array([4.0, 0.0, -0.5]),
        tangential_uN=np.zeros(3),
        friction_use=np.zeros(3),
        force_uN=np.array([[-4.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.5, 0.0]]),
        direction=np.zeros((3, 3)),
    ),
    tip_um=np.array([[20.0, 0.0, 0.0], [-40.0, 0.0, 0.0], [0.0, 21.0, 0.0]]),
)


def xyz(vector):
    """Return the components of a message."""
    return np.array([vector.x, vector.y, vector.z])


def test_frames_are_true_to_scale_but_for_the_enlarged_object():
    """Each frame stands in the station frame, in metres, the object as it is turned."""
    frames = {frame.child_frame_id: frame for frame in transforms(STAMP, STATION, REPORT)}
    assert set(frames) == {
        'left/object',
        'left/object_enlarged',
        *(f'left/finger_{finger}_tip' for finger in (1, 2, 3)),
    }
    assert {frame.header.frame_id for frame in frames.values()} == {'bench'}
    assert all(frame.header.stamp == STAMP for frame in frames.values())
    for name, scale in (('object', 1.0), ('object_enlarged', 1e4)):
        transform = frames[f'left/{name}'].transform
        np.testing.assert_allclose(
            xyz(transform.translation), scale * np.array([1e-6, -2e-6, 3e-6])
        )
        q = transform.rotation
        off = Rotation.from_quat([q.x, q.y, q.z, q.w]).inv() * TURN
        assert off.magnitude() < 1e-9
    for finger in range(FINGERS):
        at = frames[f'left/finger_{finger + 1}_tip'].transform.translation
        np.testing.assert_allclose(xyz(at), 1e-6 * REPORT.tip_um[finger])


def test_arrows_show_the_forces_of_the_fingers_that_touch():
    """From the tip, along the force, as long as 1 µm for 1 µN enlarged; no contact, no arrow."""
    markers = finger_markers(STAMP, STATION, REPORT, 4.5).markers
    arrows = {marker.id: marker for marker in markers if marker.ns == 'forces'}
    assert [arrows[finger].action for finger in (1, 2, 3)] == [
        Marker.ADD,
        Marker.DELETE,
        Marker.ADD,
    ]
    for finger in (1, 3):
        begin, end = (xyz(point) for point in arrows[finger].points)
        np.testing.assert_allclose(begin, 1e4 * 1e-6 * REPORT.tip_um[finger - 1])
        np.testing.assert_allclose(end - begin, 1e4 * 1e-6 * REPORT.contacts.force_uN[finger - 1])


@pytest.mark.parametrize(
    'report',
    [dataclasses.replace(REPORT, contacts=None), dataclasses.replace(REPORT, lost_because='gone')],
    ids=['not there yet', 'lost'],
)
def test_tips_are_shown_whatever_became_of_the_object(report):
    """Three spheres of the tips' size; all of one colour when the object is lost."""
    spheres = [m for m in finger_markers(STAMP, STATION, report, 4.5).markers if m.ns == 'tips']
    assert [sphere.id for sphere in spheres] == [1, 2, 3]
    for sphere in spheres:
        np.testing.assert_allclose(xyz(sphere.scale), 0.09)
    assert (spheres[0].color == LOST_COLOR) == bool(report.lost_because)
