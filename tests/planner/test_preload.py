# SPDX-License-Identifier: Apache-2.0
"""Preloads against linear programs over grip, margin and both states of the pull; and by hand."""

import itertools
import math

import numpy as np
import pytest

from microhand_planner.core.parameters import ContactLaw, GripRules
from microhand_planner.core.preload import contact_margin_uN, preload, preload_window_uN
from microhand_planner.core.removal import contact_lines, grip_window_uN
from tests.planner.oracles import (
    Ellipse,
    best_margin_lp,
    least_energy_answer,
    planar_cross,
    preload_window_lp,
)

RIGHT, LEFT, TOP = (np.array(v, dtype=float) for v in ((1, 0), (-1, 0), (0, 1)))


def window(stay_um, stay_normal, leave_um, leave_normal, law, friction=None, margin_uN=0.0):
    """Return the planner's window, or None if it is empty."""
    low, high = preload_window_uN(
        np.array(stay_um), np.array(stay_normal), np.array(leave_um), np.array(leave_normal),
        law.friction if friction is None else friction, law.pull_off_uN, law.max_force_uN,
        margin_uN,
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


def parts(contact, normal):
    """Return a removal as the functions take it: two contacts stay, the third goes."""
    return contact[:2], normal[:2], contact[2], normal[2]


def margin_by_hand_uN(contact, normal, law, friction, grip_uN, share):
    """Return the margin of both contacts for grips (...) and a share of the pull, from vectors."""
    stay_um = contact[:2]
    line = (stay_um[1] - stay_um[0]) / np.linalg.norm(stay_um[1] - stay_um[0])
    pull = law.pull_off_uN * normal[2]
    answer = least_energy_answer(stay_um, [*pull, planar_cross(contact[2], pull)])
    force_uN = np.multiply.outer(grip_uN, np.array([line, -line])) + share * answer
    press = -np.sum(force_uN * normal[:2], axis=-1)
    slide = np.abs(planar_cross(normal[:2], force_uN))
    margins = [
        friction * (press + law.pull_off_uN) - slide,
        press + law.pull_off_uN,
        friction * (law.max_force_uN - press),
    ]
    return np.min(margins, axis=(0, -1))


@pytest.mark.parametrize('source', [removals_on_ellipses, removals_anywhere])
def test_window_is_what_linear_programs_find(source):
    """The ends of the window are the least and the largest grip that keep the margin."""
    rng = np.random.default_rng(20261124)
    possible = 0
    for contact, normal, law in source(rng, 250):
        margin_uN = rng.choice([0.0, 0.05, 0.3]) * law.pull_off_uN
        friction = rng.uniform(0.5, 1.0) * law.friction
        removal = parts(contact, normal)
        expected = preload_window_lp(*removal, law, friction, margin_uN=margin_uN)
        found = window(*removal, law, friction, margin_uN)
        assert (found is None) == (expected is None), (removal, law, margin_uN)
        if found is not None:
            assert found == pytest.approx(expected, abs=1e-6), (removal, law, margin_uN)
            possible += 1
    assert 25 < possible < 225, 'the cases do not try both answers'


@pytest.mark.parametrize('source', [removals_on_ellipses, removals_anywhere])
def test_the_largest_margin_is_the_one_of_the_max_min_program(source):
    """Windows exist for every margin up to m*, the optimum of one program, and for none above."""
    rng = np.random.default_rng(5)
    positive = 0
    for contact, normal, law in source(rng, 250):
        removal = parts(contact, normal)
        best_uN = best_margin_lp(*removal, law, law.friction)
        assert window(*removal, law, margin_uN=best_uN - 1e-6) is not None
        assert window(*removal, law, margin_uN=best_uN + 1e-6) is None
        positive += best_uN > 0.0
    assert 25 < positive < 225, 'the cases do not try both signs'


def test_every_grip_in_the_window_holds_whatever_the_pull_is_and_none_outside_does():
    """Grips and shares of the pull at random: margins from the vectors of the forces decide."""
    rng = np.random.default_rng(17)
    inside = outside = 0
    for contact, normal, law in removals_on_ellipses(rng, 200):
        friction = 0.8 * law.friction
        found = window(*parts(contact, normal), law, friction, 0.05)
        if found is None:
            continue
        low, high = found
        for grip_uN in rng.uniform(low, high, 3):
            shares = [0.0, 1.0, *rng.uniform(0.0, 1.0, 3)]
            margins = [
                margin_by_hand_uN(contact, normal, law, friction, grip_uN, share)
                for share in shares
            ]
            assert min(margins) >= 0.05 - 1e-9
            inside += 1
        for grip_uN in (low - 1e-4, high + 1e-4):
            margins = [
                margin_by_hand_uN(contact, normal, law, friction, grip_uN, share)
                for share in (0.0, 1.0)
            ]
            assert min(margins) < 0.05
            outside += 1
    assert inside > 200
    assert outside > 100


def test_the_same_grip_must_do_before_and_during_the_pull():
    """The window is what both states have in common: Eq. 4 alone asks less, and asks otherwise.

    Each state has its own window, from the vectors at densely spaced grips. There are removals
    that either state allows, but no one grip for both; and removals that Eq. 4 forbids, because a
    finger would have to pull a little, though contacts bear it.
    """
    rng = np.random.default_rng(23)
    grips_uN = np.linspace(-6.0, 30.0, 721)
    only_apart = only_robust = both = 0
    for contact, normal, law in removals_on_ellipses(rng, 300):
        law = ContactLaw(law.friction, 1.5, 30.0)
        removal = parts(contact, normal)
        holds = np.stack(
            [
                margin_by_hand_uN(contact, normal, law, law.friction, grips_uN, share) >= 0.0
                for share in (0.0, 1.0)
            ],
            axis=1,
        )
        together = np.all(holds, axis=1)
        found = window(*removal, law)
        if found is None:
            assert not together.any()
        else:
            within = (grips_uN >= found[0] - 1e-9) & (grips_uN <= found[1] + 1e-9)
            assert np.array_equal(within, together)
        low, high = grip_window_uN(*removal, law.friction, law.pull_off_uN, law.max_force_uN)
        only_apart += found is None and bool(holds.any(axis=0).all())
        only_robust += found is not None and low > high
        both += found is not None and low <= high
    assert only_apart > 3
    assert only_robust > 3
    assert both > 30


def test_more_margin_never_widens_the_window_and_more_friction_never_narrows_it():
    """Windows are nested: by margin from the smallest inwards, by friction outwards."""
    rng = np.random.default_rng(3)
    nested = 0
    for contact, normal, law in removals_on_ellipses(rng, 150):
        removal = parts(contact, normal)
        for windows in (
            [window(*removal, law, margin_uN=m) for m in (0.0, 0.02, 0.05, 0.2, 0.5, 1.0)],
            [window(*removal, law, f * law.friction, 0.05) for f in (1.0, 0.9, 0.8, 0.6, 0.3)],
        ):
            for wide, narrow in itertools.pairwise(windows):
                if narrow is None:
                    continue
                assert wide is not None
                assert wide[0] <= narrow[0] + 1e-9
                assert wide[1] >= narrow[1] - 1e-9
                nested += 1
    assert nested > 100


@pytest.mark.parametrize(
    ('friction', 'margin_uN', 'low', 'high'),
    [
        (0.3, 0.0, 1.0, 30.0),
        (0.3, 0.06, 1.2, 29.8),
        (0.25, 0.25, 2.5, 29.0),
        (0.1, 0.3, 9.0, 27.0),
    ],
)
def test_opposite_fingers_on_a_disc_share_a_pull_across(friction, margin_uN, low, high):
    """Each takes 0.75 of 1.5 µN by friction: µ (F + 1.5) - 0.75 >= m, and µ (30 - F) >= m."""
    law = ContactLaw(friction=friction)
    found = window([10 * RIGHT, 10 * LEFT], [RIGHT, LEFT], 10 * TOP, TOP, law, None, margin_uN)
    assert found == pytest.approx((low, high))


def test_opposite_fingers_share_a_pull_along_their_line():
    """One is pressed by 0.75 µN more, the other by as much less: F - 0.75 + 1.5 >= m / µ."""
    law = ContactLaw(friction=0.3)
    found = window([10 * RIGHT, 10 * LEFT], [RIGHT, LEFT], 8 * RIGHT, RIGHT, law, None, 0.3)
    assert found == pytest.approx((1.0 - 1.5 + 0.75, 30.0 - 1.0 - 0.75))


def test_two_fingers_at_one_point_let_nothing_go():
    """A pair without a line between its contacts has no window, and its preload is none."""
    case = (np.array([10 * RIGHT, 10 * RIGHT]), np.array([RIGHT, RIGHT]), 10 * TOP, TOP)
    assert window(*case, ContactLaw()) is None
    assert np.all(np.isnan(contact_lines(*case, 1.5)))


def test_window_does_not_depend_on_the_order_or_the_frame():
    """Swapping the fingers that stay, or turning and shifting all of it, changes nothing."""
    rng = np.random.default_rng(31)
    checked = 0
    for contact, normal, law in removals_on_ellipses(rng, 200):
        plain = window(*parts(contact, normal), law, None, 0.05)
        swapped = window(contact[1::-1], normal[1::-1], contact[2], normal[2], law, None, 0.05)
        angle = rng.uniform(0.0, 2 * math.pi)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        moved = contact @ turn.T + rng.uniform(-50.0, 50.0, 2)
        turned = window(*parts(moved, normal @ turn.T), law, None, 0.05)
        assert (plain is None) == (swapped is None) == (turned is None)
        if plain is not None:
            assert swapped == pytest.approx(plain, abs=1e-7)
            assert turned == pytest.approx(plain, abs=1e-7)
            checked += 1
    assert checked > 20


# ---------------------------------------------------------------- the grip that is chosen


def test_the_preload_is_the_smallest_grip_that_may_be_off_by_the_tolerance():
    """Nearest to zero with the tolerance to spare on both sides, or the middle where it is tight.

    Planned with the share of the friction; the margin that is stated is the one of the vectors.
    """
    rng = np.random.default_rng(41)
    rules = GripRules()
    spared = tight = 0
    for contact, normal, law in removals_on_ellipses(rng, 300):
        hold = preload(*parts(contact, normal), law, rules)
        friction = rules.margin_factor * law.friction
        found = window(*parts(contact, normal), law, friction, rules.least_margin_uN)
        if found is None:
            assert hold.low_uN > hold.high_uN
            continue
        assert (hold.low_uN, hold.high_uN) == pytest.approx(found, abs=1e-6)
        margins = [
            margin_by_hand_uN(contact, normal, law, friction, hold.grip_uN, share)
            for share in (0.0, 1.0)
        ]
        assert hold.margin_uN == pytest.approx(min(margins), abs=2e-6)
        assert hold.margin_uN >= rules.least_margin_uN - 2e-6
        low, high = found
        if high - low >= 2 * rules.grip_tolerance_uN:
            assert low + 0.5 - 1e-6 <= hold.grip_uN <= high - 0.5 + 1e-6
            at_edge = min(abs(hold.grip_uN - low - 0.5), abs(high - hold.grip_uN - 0.5)) < 1e-5
            assert hold.grip_uN == 0.0 or at_edge
            for off_uN in (-0.5, 0.5):
                assert (
                    min(
                        margin_by_hand_uN(
                            contact, normal, law, friction, hold.grip_uN + off_uN, share
                        )
                        for share in (0.0, 1.0)
                    )
                    >= rules.least_margin_uN - 1e-5
                )
            spared += 1
        else:
            assert hold.grip_uN == pytest.approx(0.5 * (low + high), abs=1e-6)
            tight += 1
    assert spared > 30
    assert tight > 3


def test_a_removal_that_no_grip_allows_has_an_empty_window():
    """Friction needs 6 µN of grip and fingers can give 5: low is above high."""
    law = ContactLaw(friction=0.1, max_force_uN=5.0)
    hold = preload(
        np.array([10 * RIGHT, 10 * LEFT]), np.array([RIGHT, LEFT]), 10 * TOP, TOP, law, GripRules()
    )
    assert hold.low_uN > hold.high_uN


@pytest.mark.parametrize(
    ('normal_uN', 'tangent_uN', 'margin_uN'),
    [
        (0.0, 0.0, 0.45),  # 0.3 (0 + 1.5)
        (5.0, 1.0, 0.95),  # 0.3 (5 + 1.5) - 1
        (5.0, -1.0, 0.95),
        (-1.2, 0.0, 0.09),  # 0.3 (-1.2 + 1.5), less than the 0.3 to detaching
        (29.0, 0.0, 0.3),  # 0.3 (30 - 29)
        (-2.0, 0.0, -0.5),  # pulls 0.5 more than a contact bears
    ],
)
def test_margin_of_a_contact_by_hand(normal_uN, tangent_uN, margin_uN):
    """The least of the distances to slipping, detaching and overload at friction 0.3."""
    found = contact_margin_uN(normal_uN, tangent_uN, 0.3, ContactLaw())
    assert found == pytest.approx(margin_uN)
