# SPDX-License-Identifier: Apache-2.0
"""Forces of grasps: in balance, within the cones, and for three fingers as firm as can be."""

import itertools
import math

import numpy as np
import pytest

from microhand_planner.core.grip_forces import GripForces
from microhand_planner.core.parameters import ContactLaw, GripRules
from microhand_planner.core.preload import preload
from microhand_planner.core.rolling_grip import rolling_grips_uN
from tests.planner.oracles import Ellipse, coulomb_rows, grasp_rows, planar_cross

RULES = GripRules()


def random_grasps(rng, count, fingers):
    """Return contacts and normals (count, fingers, 2) on one random ellipse, tips apart."""
    shape = Ellipse(*rng.uniform(8.0, 20.0, 2), 4.5)
    contacts, normals = [], []
    while len(contacts) < count:
        contact, normal, centre = shape.at(rng.uniform(0.0, shape.turn_rad, fingers))
        apart = np.linalg.norm(centre[:, None] - centre, axis=-1)[np.triu_indices(fingers, k=1)]
        if np.all(apart > 9.0):
            contacts.append(contact)
            normals.append(normal)
    return np.array(contacts), np.array(normals)


def parts(normal, force_uN):
    """Return pressing and tangential forces."""
    return -np.sum(force_uN * normal, axis=-1), planar_cross(normal, force_uN)


def assert_balanced(contact_um, force_uN):
    """Check that forces and moments sum up to nothing."""
    assert np.abs(force_uN.sum(axis=-2)).max() < 1e-7
    assert np.abs(planar_cross(contact_um, force_uN).sum(axis=-1)).max() < 1e-6


@pytest.mark.parametrize('adhesion', [True, False])
@pytest.mark.parametrize('planned', [True, False])
@pytest.mark.parametrize('fingers', [2, 3])
def test_forces_of_a_grasp_are_in_balance(adhesion, planned, fingers):
    """Two or three fingers, with margins or without, with adhesion or without: nothing is left."""
    rng = np.random.default_rng(fingers)
    contact, normal = random_grasps(rng, 12, fingers)
    grip = GripForces(ContactLaw(adhesion=adhesion), RULES, planned=planned)
    force_uN, hold = grip.while_holding(contact, normal)
    assert force_uN.shape == contact.shape
    assert_balanced(contact, force_uN)
    assert (hold is not None) == (planned and fingers == 2)


def test_two_fingers_press_along_their_line_with_the_rolling_grip():
    """The force of each is the grip towards the other one, and the hold tells its worst."""
    rng = np.random.default_rng(9)
    contact, normal = random_grasps(rng, 40, 2)
    law = ContactLaw()
    force_uN, hold = GripForces(law, RULES, planned=True).while_holding(contact, normal)
    grip_uN, high_uN, margin_uN = rolling_grips_uN(contact, normal, law, RULES)
    line = contact[:, 1] - contact[:, 0]
    towards = line / np.linalg.norm(line, axis=1, keepdims=True)
    assert force_uN[:, 0] == pytest.approx(grip_uN[:, None] * towards)
    assert force_uN[:, 1] == pytest.approx(-force_uN[:, 0])
    assert hold.grip_uN == pytest.approx(grip_uN.min(), abs=1e-6)
    assert hold.high_uN == pytest.approx(high_uN.min(), abs=1e-6)
    assert hold.margin_uN == pytest.approx(margin_uN.min(), abs=1e-6)
    press, slide = parts(normal, force_uN)
    assert np.all(np.abs(slide) <= RULES.roll_factor * law.friction * (press + 1.5) + 1e-9)


def test_plans_of_the_paper_press_with_the_nominal_grip():
    """The paper leaves forces open: every pair presses alike, and no margin is stated."""
    rng = np.random.default_rng(10)
    contact, normal = random_grasps(rng, 5, 3)
    grip = GripForces(ContactLaw(), RULES, planned=False)
    for force_uN, hold in (
        grip.while_holding(contact[:, :2], normal[:, :2]),
        grip.while_releasing(contact[0, :2], normal[0, :2], contact[0, 2], normal[0, 2]),
    ):
        assert hold is None
        assert np.linalg.norm(force_uN, axis=-1) == pytest.approx(5.0)


def test_a_finger_is_let_go_with_the_preload():
    """Forces are the preload along the line of the two that stay; the hold is that of the rule."""
    rng = np.random.default_rng(11)
    contact, normal = random_grasps(rng, 20, 3)
    law = ContactLaw()
    for at, out in zip(contact, normal, strict=True):
        case = (at[:2], out[:2], at[2], out[2])
        force_uN, hold = GripForces(law, RULES, planned=True).while_releasing(*case)
        assert hold == preload(*case, law, RULES)
        line = (at[1] - at[0]) / np.linalg.norm(at[1] - at[0])
        assert force_uN == pytest.approx(hold.grip_uN * np.stack([line, -line]))
        assert_balanced(at[:2], force_uN)


def test_without_adhesion_nothing_pulls_and_a_removal_is_a_rolling_grip():
    """The two that stay hold as they will roll."""
    rng = np.random.default_rng(12)
    contact, normal = random_grasps(rng, 10, 3)
    grip = GripForces(ContactLaw(friction=0.8, adhesion=False), RULES, planned=True)
    for at, out in zip(contact, normal, strict=True):
        force_uN, hold = grip.while_releasing(at[:2], out[:2], at[2], out[2])
        expected_uN, expected = grip.while_holding(at[None, :2], out[None, :2])
        assert force_uN == pytest.approx(expected_uN[0])
        assert hold == expected


def firmest_by_vertices(contact_um, normal, friction, stick_uN, most_uN):
    """Return the largest value of margin + 0.001 (sum of presses) over all corners.

    Forces in balance are combinations of three null vectors of the grasp matrix; with the margin
    that makes four unknowns. Wherever four of the constraints meet, and all others hold, is a
    corner of what is allowed; the best corner is the optimum.
    """
    size = np.abs(contact_um).max()
    free = np.linalg.svd(grasp_rows(contact_um / size, normal))[2][3:].T  # (6, 3)
    press, slide = free[0::2], free[1::2]
    one, none = np.ones((3, 1)), np.zeros((3, 1))
    rows = np.vstack(
        [
            np.hstack([sign * slide - friction * press, one])  # |t| + m <= friction (n + stick)
            for sign in (1.0, -1.0)
        ]
        + [np.hstack([press, none]), np.hstack([-press, none]), [[0.0, 0.0, 0.0, -1.0]]]
    )
    limits = np.array([friction * stick_uN] * 6 + [most_uN] * 3 + [stick_uN] * 3 + [0.0])
    weights = np.append(1e-3 * press.sum(axis=0), 1.0)
    best = -math.inf
    for four in itertools.combinations(range(len(rows)), 4):
        corner_rows = rows[list(four)]
        if abs(np.linalg.det(corner_rows)) < 1e-9:
            continue
        corner = np.linalg.solve(corner_rows, limits[list(four)])
        if np.all(rows @ corner <= limits + 1e-7):
            best = max(best, float(weights @ corner))
    return best


@pytest.mark.parametrize('adhesion', [True, False])
def test_three_fingers_are_as_firm_as_the_best_corner_of_all_that_is_allowed(adhesion):
    """The margin in all cones, with a little weight on pressing, is that of brute force."""
    rng = np.random.default_rng(13 + adhesion)
    law = ContactLaw(friction=0.4, adhesion=adhesion)
    grip = GripForces(law, RULES, planned=True)
    friction = RULES.margin_factor * law.friction
    contact, normal = random_grasps(rng, 25, 3)
    firm = 0
    for at, out in zip(contact, normal, strict=True):
        force_uN, hold = grip.while_holding(at[None], out[None])
        assert hold is None
        assert_balanced(at, force_uN[0])
        press, slide = parts(out, force_uN[0])
        margin_uN = np.min(friction * (press + law.stick_uN) - np.abs(slide))
        assert margin_uN >= -1e-9
        assert np.all(press <= RULES.nominal_grip_uN + 1e-9)
        assert np.all(press >= -law.stick_uN - 1e-9)
        value = margin_uN + 1e-3 * press.sum()
        best = firmest_by_vertices(at, out, friction, law.stick_uN, RULES.nominal_grip_uN)
        assert value == pytest.approx(best, abs=1e-7)
        firm += margin_uN > 0.1
    assert firm > 3


def test_three_fingers_on_a_disc_press_alike():
    """At 120° to each other all press with the nominal grip, and nothing slides."""
    angle = np.radians([90.0, 210.0, 330.0])
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    grip = GripForces(ContactLaw(), RULES, planned=True)
    force_uN, _ = grip.while_holding(10.0 * normal[None], normal[None])
    press, slide = parts(normal, force_uN[0])
    assert press == pytest.approx(np.full(3, 5.0))
    assert slide == pytest.approx(np.zeros(3), abs=1e-9)


def test_coulomb_rows_of_the_oracle_are_the_law():
    """|t| <= friction (n + pull-off), written as rows, for two contacts at once."""
    rows, limits = coulomb_rows(2, 0.3, 1.5)
    inside, outside = np.array([1.0, 0.74, 0.0, -0.44]), np.array([1.0, 0.74, 0.0, -0.46])
    assert np.all(rows @ inside <= limits)
    assert np.sum(rows @ outside > limits) == 1
