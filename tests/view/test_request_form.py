# SPDX-License-Identifier: Apache-2.0
"""What the request form asks the planner for."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import BadRequest
from microhand_planner.core.pose import Pose, angle_between_rad
from microhand_station.view.request_form import FormValues, Held, check_start, to_request

SHA = 'a' * 64
HELD = Held(
    SHA,
    Pose.of((3.0, -2.0, 1.0), Rotation.from_rotvec([0.3, -0.2, 0.9])),
    np.array([[20.0, 0.0, 0.0], [-20.0, 0.0, 0.0], [np.nan] * 3]),
)


@given(st.tuples(*[st.floats(-360.0, 360.0)] * 3))
def test_euler_angles_turn_about_z_then_y_then_z_of_the_object(angles_deg):
    """The goal is R_start Rz(A) Ry(B) Rz(C), by matrices written out here."""
    a, b, c = np.radians(angles_deg)
    expected = HELD.pose.rotation.as_matrix() @ about_z(a) @ about_y(b) @ about_z(c)
    request = to_request(FormValues('part', euler_zyz_deg=angles_deg), SHA, HELD)
    np.testing.assert_allclose(request.goal.rotation.as_matrix(), expected, atol=1e-9)


def about_z(angle_rad):
    """Return the matrix of a rotation about z."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def about_y(angle_rad):
    """Return the matrix of a rotation about y."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])


def test_a_quaternion_counts_when_it_is_chosen():
    """Half a turn about x, of any length; the angles beside it do not matter."""
    values = FormValues(
        'part',
        by_quaternion=True,
        quaternion_wxyz=(0.0, 5.0, 0.0, 0.0),
        euler_zyz_deg=(1.0, 2.0, 3.0),
    )
    goal = to_request(values, SHA, None).goal
    assert angle_between_rad(goal.rotation, Rotation.from_rotvec([math.pi, 0, 0])) < 1e-9


def test_an_object_that_is_held_goes_on_from_where_it_is():
    """Start pose and tips are those of now, and the shift is in the station frame."""
    request = to_request(FormValues('part', translation_um=(1.0, 2.0, 3.0)), SHA, HELD)
    assert request.start == HELD.pose
    np.testing.assert_array_equal(request.start_tip_um, HELD.tip_um)
    np.testing.assert_allclose(request.goal.position_um, [4.0, 0.0, 4.0])


@pytest.mark.parametrize(
    ('sha256', 'held', 'afresh'),
    [(SHA, None, False), ('b' * 64, HELD, False), (SHA, HELD, True)],
    ids=['nothing held', 'another object held', 'put afresh'],
)
def test_otherwise_the_object_is_put_at_the_origin(sha256, held, afresh):
    """It starts at the origin of the station, with any grasp."""
    request = to_request(FormValues('part', afresh=afresh), sha256, held)
    assert request.start == Pose()
    assert request.start_tip_um is None


def test_an_object_between_three_fingers_must_be_put_afresh():
    """Plans begin with two fingers; after a stop there may be three."""
    three = Held(SHA, HELD.pose, np.diag([20.0, 20.0, 20.0]))
    with pytest.raises(BadRequest, match='object is held by 3 fingers; allowed: held by 2, or'):
        to_request(FormValues('part'), SHA, three)
    assert to_request(FormValues('part', afresh=True), SHA, three).start == Pose()


def test_a_plan_is_executed_only_where_it_begins():
    """The object may not have been moved, or lost; one that is put afresh is where it is put."""
    request = to_request(FormValues('part'), SHA, HELD)
    check_start(request, HELD)
    turned = Pose.of(HELD.pose.position_um, HELD.pose.rotation * Rotation.from_rotvec([0, 0, 0.1]))
    shifted = Pose.of(np.add(HELD.pose.position_um, [0, 0, 2.0]), HELD.pose.rotation)
    for now in (None, *(Held(SHA, pose, HELD.tip_um) for pose in (turned, shifted))):
        with pytest.raises(BadRequest, match='object is no longer held where the plan begins'):
            check_start(request, now)
        check_start(to_request(FormValues('part', afresh=True), SHA, HELD), now)


@pytest.mark.parametrize(
    ('field', 'values'),
    [
        ('object', FormValues('')),
        ('angles', FormValues('part', euler_zyz_deg=(0.0, math.nan, 0.0))),
        ('angles', FormValues('part', euler_zyz_deg=(math.inf, 0.0, 0.0))),
        ('translation', FormValues('part', translation_um=(0.0, 0.0, math.nan))),
        ('position', FormValues('part', translation_um=(0.0, 0.0, 1e9))),
        (
            'quaternion',
            FormValues('part', by_quaternion=True, quaternion_wxyz=(0.0, 0.0, 0.0, 0.0)),
        ),
        (
            'quaternion',
            FormValues('part', by_quaternion=True, quaternion_wxyz=(math.nan, 0.0, 0.0, 1.0)),
        ),
    ],
)
def test_what_cannot_be_asked_for_is_refused_by_name(field, values):
    """The error names the field."""
    with pytest.raises(BadRequest) as error:
        to_request(values, SHA, None)
    assert error.value.field == field
