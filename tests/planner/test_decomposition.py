# SPDX-License-Identifier: Apache-2.0
"""Decompositions of a rotation: every one makes up the rotation, and none is missing."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from microhand_planner.core.decomposition import PlanarRotation, decompositions

AXIS = {'z': [0.0, 0.0, 1.0], 'y': [0.0, 1.0, 0.0]}
TURN = 2 * math.pi

any_angle = st.floats(-360.0, 360.0)
special_angle = st.sampled_from([0.0, 90.0, 180.0, -180.0, 270.0, 360.0, -360.0])
tiny = st.sampled_from([0.0, 1e-14, -1e-12, 1e-10, -1e-8, 1e-6, 1e-3])


def matrix_of(parts):
    """Return the product of rotation matrices, written out: each about the frame turned so far."""
    product = np.eye(3)
    for part in parts:
        c, s = math.cos(part.angle_rad), math.sin(part.angle_rad)
        if part.axis == 'z':
            product = product @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        else:
            product = product @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return product


def by_davenport(angles_deg):
    """Return Rz Ry Rz about the current frame, by scipy's general axes."""
    axes = [AXIS['z'], AXIS['y'], AXIS['z']]
    return Rotation.from_davenport(axes, 'intrinsic', np.radians(angles_deg))


def check(rotation):
    """Check what holds for the decompositions of any rotation, and return them."""
    found = decompositions(rotation)
    assert len(set(found)) == len(found)
    for parts in found:
        assert ''.join(part.axis for part in parts) in {'', 'z', 'y', 'zy', 'yz', 'zyz'}
        assert all(0.0 < abs(part.angle_rad) < TURN for part in parts)
        assert np.allclose(matrix_of(parts), rotation.as_matrix(), atol=1e-9)
    return found


@settings(derandomize=True, max_examples=150, deadline=None)
@given(st.tuples(any_angle, any_angle, any_angle))
def test_every_decomposition_makes_up_the_rotation(angles_deg):
    """Multiplied up, each is the rotation, by matrices; all angles lie within one turn."""
    assert check(by_davenport(angles_deg))


@settings(derandomize=True, max_examples=150, deadline=None)
@given(st.tuples(special_angle, special_angle, special_angle), st.tuples(tiny, tiny, tiny))
def test_degenerate_rotations_lose_no_accuracy(angles_deg, offset_deg):
    """At and next to theta2 = 0 and 180 deg too, each decomposition makes up the rotation."""
    assert check(by_davenport(np.add(angles_deg, offset_deg)))


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.tuples(any_angle, st.floats(1.0, 179.0), any_angle), st.sampled_from([1.0, -1.0]))
def test_all_triples_within_one_turn_are_there(angles_deg, sign):
    """Both Euler solutions, each angle either way round: sixteen triples."""
    first, middle, last = np.radians(angles_deg)
    middle *= sign
    wanted = set()
    for triple in ((first, middle, last), (first + math.pi, -middle, last + math.pi)):
        ways = [(angle % TURN, angle % TURN - TURN) for angle in triple]
        wanted |= {tuple(np.round(np.degrees(way), 5)) for way in itertools.product(*ways)}
    found = {
        tuple(np.round([math.degrees(part.angle_rad) for part in parts], 5))
        for parts in check(by_davenport(np.degrees([first, middle, last])))
        if len(parts) == 3
    }
    assert {f for f in found if 0.0 not in f} <= wanted
    # a first or last angle of zero is left out, so only then there may be fewer
    if all(abs(math.remainder(angle, math.pi)) > 1e-6 for angle in (first, last)):
        assert len(found) == 16
        assert found == wanted


def test_the_papers_rotation_is_there():
    """80, 220, 100 deg is one of the decompositions of itself, as far as numbers go."""
    found = decompositions(by_davenport([80.0, 220.0, 100.0]))
    angles = np.degrees([[part.angle_rad for part in parts] for parts in found])
    assert np.min(np.max(np.abs(angles - [80.0, 220.0, 100.0]), axis=1)) < 1e-9


def test_no_rotation_needs_nothing():
    """The identity has one decomposition, and it is empty."""
    assert decompositions(Rotation.identity()) == ((),)


@pytest.mark.parametrize('angle_deg', [-250.0, -90.0, 1e-3, 10.0, 180.0, 359.0])
def test_rotation_about_z_is_one_planar_rotation(angle_deg):
    """With theta2 = 0 one planar rotation does it, either way round."""
    found = decompositions(Rotation.from_rotvec([0.0, 0.0, math.radians(angle_deg)]))
    positive_deg = angle_deg % 360.0
    wanted = sorted([positive_deg, positive_deg - 360.0])
    assert all([part.axis for part in parts] == ['z'] for parts in found)
    angles_deg = sorted(math.degrees(parts[0].angle_rad) for parts in found)
    assert angles_deg == pytest.approx(wanted)


@pytest.mark.parametrize('angle_deg', [-250.0, -90.0, 10.0, 270.0])
def test_rotation_about_y_may_be_one_planar_rotation(angle_deg):
    """A rotation about y alone is among the decompositions of itself, and the gentlest."""
    found = decompositions(Rotation.from_rotvec([0.0, math.radians(angle_deg), 0.0]))
    short_deg = math.remainder(angle_deg, 360.0)
    assert len(found[0]) == 1
    assert found[0][0].axis == 'y'
    assert math.degrees(found[0][0].angle_rad) == pytest.approx(short_deg)


def test_half_turn_about_y_leaves_the_difference_of_the_outer_angles():
    """With theta2 = 180 deg one outer rotation takes the whole difference: 30 - 70 = -40 deg."""
    found = check(by_davenport([30.0, 180.0, 70.0]))
    assert all(len(parts) == 2 for parts in found)
    firsts = {round(math.degrees(p[0].angle_rad)) for p in found if p[0].axis == 'z'}
    lasts = {round(math.degrees(p[1].angle_rad)) for p in found if p[1].axis == 'z'}
    assert firsts == {-40, 320}
    assert lasts == {40, -320}


def test_the_gentlest_comes_first():
    """The sum of the angles never falls along the list."""
    found = decompositions(by_davenport([33.0, 111.0, -222.0]))
    sums = [sum(abs(part.angle_rad) for part in parts) for parts in found]
    assert np.all(np.diff(sums) > -1e-9)


def test_equal_rotations_have_equal_decompositions():
    """The quaternions q and -q are one rotation, and give the same list but for rounding."""
    quaternion = by_davenport([12.0, 34.0, 56.0]).as_quat()
    plus, minus = (decompositions(Rotation.from_quat(q)) for q in (quaternion, -quaternion))
    for one, other in zip(plus, minus, strict=True):
        assert [part.axis for part in one] == [part.axis for part in other]
        assert [part.angle_rad for part in one] == pytest.approx([p.angle_rad for p in other])


def test_planar_rotation_is_right_handed():
    """+90 deg about z turns x to y, and about y turns z to x."""
    assert PlanarRotation('z', math.pi / 2).rotation.apply([1, 0, 0]) == pytest.approx([0, 1, 0])
    assert PlanarRotation('y', math.pi / 2).rotation.apply([0, 0, 1]) == pytest.approx([1, 0, 0])
