# SPDX-License-Identifier: Apache-2.0
"""Which grasps hold by pressing alone: closed forms against linear programs and hand cases."""

import math

import numpy as np
import pytest

from microhand_planner.core.grasp import pair_presses, tips_clear, triple_presses
from tests.planner.oracles import Ellipse, pairs_press, presses_lp, triples_press


def on_disc(*angles_deg, radius_um=10.0):
    """Return contacts and outward normals on a disc."""
    angle = np.radians(angles_deg)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return radius_um * normal, normal


def random_grasps(seed, fingers, count):
    """Return random grasps on random ellipses: contacts, normals, friction."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        shape = Ellipse(*rng.uniform(3.0, 40.0, 2), rng.uniform(1.0, 10.0))
        contact, normal, _ = shape.at(rng.uniform(0.0, shape.turn_rad, fingers))
        yield contact, normal, rng.uniform(0.05, 1.0)


def test_pairs_press_exactly_when_a_linear_program_is_feasible():
    """Two fingers hold if and only if forces in both cones balance with both pressing."""
    holding = 0
    for contact, normal, friction in random_grasps(1, 2, 400):
        expected = presses_lp(contact, normal, friction) > 1e-7
        assert pair_presses(contact, normal, friction) == expected, (contact, normal, friction)
        assert pairs_press(contact[None], normal[None], friction)[0] == expected
        holding += expected
    assert 40 < holding < 360, 'the cases do not try both answers'


def test_triples_press_exactly_when_a_linear_program_is_feasible():
    """Three fingers hold if and only if forces in all cones balance with each one pressing."""
    holding = 0
    for contact, normal, friction in random_grasps(2, 3, 500):
        expected = presses_lp(contact, normal, friction) > 1e-7
        assert triple_presses(contact, normal, friction) == expected, (contact, normal, friction)
        assert triples_press(contact[None], normal[None], friction)[0] == expected
        holding += expected
    assert 50 < holding < 450, 'the cases do not try both answers'


@pytest.mark.parametrize('friction', [0.1, 0.3, 0.6])
@pytest.mark.parametrize(('beyond_deg', 'holds'), [(-0.01, True), (0.01, False)])
def test_pair_on_a_disc_holds_up_to_twice_the_friction_angle(friction, beyond_deg, holds):
    """On a disc the line of two contacts leans by half of what they miss from opposite."""
    miss_deg = 2.0 * math.degrees(math.atan(friction)) + beyond_deg
    assert pair_presses(*on_disc(0.0, 180.0 - miss_deg), friction) == holds


def test_pair_on_one_side_does_not_hold():
    """Two fingers that push in the same direction do not hold, however large the friction."""
    contact_um = np.array([[-3.0, 5.0], [3.0, 5.0]])
    normal = np.array([[0.0, 1.0], [0.0, 1.0]])
    assert not pair_presses(contact_um, normal, 2.0)


@pytest.mark.parametrize(
    ('angles_deg', 'friction', 'holds'),
    [
        ((0.0, 120.0, 240.0), 0.0, True),  # normals meet in the centre and span the plane
        ((0.0, 120.0, 240.0), 0.3, True),
        ((0.0, 60.0, 120.0), 0.0, False),  # all push to one side
        ((0.0, 60.0, 120.0), 0.2, False),
        ((0.0, 90.0, 180.0), 0.0, False),  # nothing answers the one on top
        ((0.0, 90.0, 180.0), 0.3, True),  # friction of the two others does
        ((0.0, 10.0, 185.0), 0.0, True),
        ((0.0, 10.0, 195.0), 0.0, False),
    ],
)
def test_triples_on_a_disc(angles_deg, friction, holds):
    """Without friction the normals must surround the centre; friction widens that."""
    assert triple_presses(*on_disc(*angles_deg), friction) == holds


def test_more_friction_never_loses_a_grasp():
    """A grasp that holds at some friction holds at any larger one."""
    gained = 0
    for contact, normal, friction in random_grasps(4, 3, 300):
        less = triple_presses(contact, normal, friction)
        more = triple_presses(contact, normal, 1.5 * friction)
        assert more or not less
        gained += more and not less
    assert gained > 5


def test_triple_does_not_depend_on_order_and_size():
    """Naming the fingers differently, or scaling the object, does not change the answer."""
    for contact, normal, friction in random_grasps(5, 3, 150):
        holds = triple_presses(contact, normal, friction)
        for order in ([1, 2, 0], [0, 2, 1]):
            assert triple_presses(contact[order], normal[order], friction) == holds
        assert triple_presses(1e3 * contact, normal, friction) == holds
        assert triple_presses(1e-2 * contact, normal, friction) == holds


@pytest.mark.parametrize(
    ('distance_um', 'clear'), [(9.0, True), (9.001, True), (8.999, False), (0.0, False)]
)
def test_tips_may_touch_but_not_overlap(distance_um, clear):
    """Tips of diameter 9 um are clear from a centre distance of 9 um on."""
    offset_um = distance_um * np.array([0.6, -0.8])
    assert tips_clear(np.array([3.0, 4.0]), np.array([3.0, 4.0]) + offset_um, 9.0) == clear
