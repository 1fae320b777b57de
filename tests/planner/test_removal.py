# SPDX-License-Identifier: Apache-2.0
"""The closed form of a removal against linear programs, and against discs worked by hand."""

import math

import numpy as np
import pytest

from microhand_planner.core.parameters import ContactLaw
from microhand_planner.core.removal import can_remove, grip_window_uN
from tests.planner.oracles import Ellipse, removable_from, removal_window_lp

RIGHT, LEFT, TOP = (np.array(v, dtype=float) for v in ((1, 0), (-1, 0), (0, 1)))


def window(stay_um, stay_normal, leave_um, leave_normal, law):
    """Return the planner's window, or None if it is empty."""
    low, high = grip_window_uN(
        np.array(stay_um), np.array(stay_normal), np.array(leave_um), np.array(leave_normal),
        law.friction, law.pull_off_uN, law.max_force_uN,
    )  # fmt: skip
    return (low, high) if low <= high else None


def random_law(rng):
    """Return a contact law from slippery to rough, from weak to strong adhesion."""
    return ContactLaw(
        friction=rng.uniform(0.02, 1.2),
        pull_off_uN=rng.uniform(0.1, 4.0),
        max_force_uN=rng.uniform(1.0, 40.0),
    )


def removals_on_ellipses(rng, count):
    """Return random removals on random ellipses: contacts (3, 2), normals (3, 2), law."""
    for _ in range(count):
        shape = Ellipse(*rng.uniform(3.0, 40.0, 2), rng.uniform(1.0, 10.0))
        contact, normal, _ = shape.at(rng.uniform(0.0, shape.turn_rad, 3))
        yield contact, normal, random_law(rng)


def removals_anywhere(rng, count):
    """Return random removals with contacts and normals that belong to no smooth shape."""
    for _ in range(count):
        angle = rng.uniform(0.0, 2 * math.pi, 3)
        yield (
            rng.uniform(-20.0, 20.0, (3, 2)),
            np.stack([np.cos(angle), np.sin(angle)], axis=-1),
            random_law(rng),
        )


@pytest.mark.parametrize('source', [removals_on_ellipses, removals_anywhere])
def test_window_is_what_linear_programs_find(source):
    """The ends of the window are the least and largest grip force of the linear program."""
    rng = np.random.default_rng(20260301)
    possible = 0
    for contact, normal, law in source(rng, 250):
        case = (contact[:2], normal[:2], contact[2], normal[2], law)
        expected, found = removal_window_lp(*case), window(*case)
        assert (found is None) == (expected is None), case
        if found is not None:
            assert found == pytest.approx(expected, abs=1e-6), case
            possible += 1
    assert 25 < possible < 225, 'the cases do not try both answers'


def test_can_remove_is_a_window_that_is_not_empty():
    """`can_remove` agrees with the feasibility of the linear program, whatever holds its input."""
    rng = np.random.default_rng(7)
    for contact, normal, law in removals_on_ellipses(rng, 100):
        case = (contact[:2], normal[:2], contact[2], normal[2])
        possible = can_remove(
            *(part.tolist() for part in case), law.friction, law.pull_off_uN, law.max_force_uN
        )
        assert possible == (removal_window_lp(*case, law) is not None)


def test_null_space_oracle_is_what_linear_programs_find():
    """The other tests' fast oracle of removals is itself right."""
    rng = np.random.default_rng(11)
    for contact, normal, law in removals_on_ellipses(rng, 150):
        possible = removable_from(contact[:2], normal[:2], contact[2:], normal[2:], law)[0]
        case = (contact[:2], normal[:2], contact[2], normal[2], law)
        assert possible == (removal_window_lp(*case) is not None)


@pytest.mark.parametrize(('friction', 'least_uN'), [(0.1, 6.0), (0.3, 1.0), (0.5, 0.0)])
def test_opposite_fingers_on_a_disc_let_the_one_at_right_angles_go(friction, least_uN):
    """Each takes half the pull as friction: least F with 0.75 = mu (F + 1.5), not below zero."""
    law = ContactLaw(friction=friction)
    found = window([10 * RIGHT, 10 * LEFT], [RIGHT, LEFT], 10 * TOP, TOP, law)
    assert found == pytest.approx((least_uN, 30.0))


def test_force_that_is_too_small_to_grip_forbids_the_removal():
    """If friction needs 6 uN and fingers can give 5 uN, there is no window."""
    law = ContactLaw(friction=0.1, max_force_uN=5.0)
    assert window([10 * RIGHT, 10 * LEFT], [RIGHT, LEFT], 10 * TOP, TOP, law) is None


def test_finger_pushes_against_the_pull_but_never_pulls():
    """A finger leaving on top pulls up; fingers at +-120 deg can only push, one below cannot.

    On a disc with fingers at 210 and 330 deg, whose pushes have an upward part, the pull adds to
    them: they would have to pull. With fingers at 30 and 150 deg the pushes balance it:
    2 (F sin 30) = 1.5 without friction.
    """
    law = ContactLaw(friction=0.0)
    below = [np.array([math.cos(a), math.sin(a)]) for a in np.radians([210.0, 330.0])]
    above = [np.array([math.cos(a), math.sin(a)]) for a in np.radians([30.0, 150.0])]
    assert window([10 * n for n in below], below, 10 * TOP, TOP, law) is None
    low, high = window([10 * n for n in above], above, 10 * TOP, TOP, law)
    # each pushes 1.5 uN along its own normal: 1.5 cos 30 deg of that along the line between them
    assert low == pytest.approx(1.5 * math.cos(math.radians(30.0)))
    assert high == pytest.approx(low)


def test_finger_beside_the_leaving_one_decides_by_the_lever():
    """Fingers left and right, one leaving beside the left on top: friction must carry a couple."""
    law = ContactLaw(friction=0.3)
    on_top = np.array([-8.0, 10.0])
    found = window([10 * RIGHT, 10 * LEFT], [RIGHT, LEFT], on_top, TOP, law)
    # lever rule: the left finger takes 0.9 of 1.5 uN as friction: mu (F + 1.5) >= 1.35
    assert found == pytest.approx((3.0, 30.0))


def test_without_pull_off_opposite_fingers_may_grip_at_any_force():
    """Nothing pulls, so zero force up to the largest is allowed."""
    law = ContactLaw(pull_off_uN=0.0)
    found = window([10 * RIGHT, 10 * LEFT], [RIGHT, LEFT], 10 * TOP, TOP, law)
    assert found == pytest.approx((0.0, 30.0))


def test_two_fingers_at_one_point_let_nothing_go():
    """A pair without a line between its contacts has no window."""
    law = ContactLaw()
    assert window([10 * RIGHT, 10 * RIGHT], [RIGHT, RIGHT], 10 * TOP, TOP, law) is None


def test_window_does_not_depend_on_the_order_or_the_frame():
    """Swapping the fingers that stay, or turning and shifting all of it, changes nothing."""
    rng = np.random.default_rng(3)
    checked = 0
    for contact, normal, law in removals_on_ellipses(rng, 200):
        plain = window(contact[:2], normal[:2], contact[2], normal[2], law)
        swapped = window(contact[1::-1], normal[1::-1], contact[2], normal[2], law)
        angle = rng.uniform(0.0, 2 * math.pi)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        moved = contact @ turn.T + rng.uniform(-50.0, 50.0, 2)
        turned = window(moved[:2], normal[:2] @ turn.T, moved[2], normal[2] @ turn.T, law)
        assert (plain is None) == (swapped is None) == (turned is None)
        if plain is not None:
            assert swapped == pytest.approx(plain, abs=1e-7)
            assert turned == pytest.approx(plain, abs=1e-7)
            checked += 1
    assert checked > 20
