# SPDX-License-Identifier: Apache-2.0
"""Rolling grips against bisection with the friction cones written out, and against a hand case."""

import math

import numpy as np
import pytest

from microhand_planner.core.parameters import ContactLaw, GripRules
from microhand_planner.core.rolling_grip import largest_grip_uN, rolling_grips_uN
from tests.planner.oracles import Ellipse, planar_cross


def bears(contact_um, normal, law, friction, grip_uN):
    """Return whether both contacts bear a grip along the line between them."""
    line = contact_um[1] - contact_um[0]
    force_uN = grip_uN * np.stack([line, -line]) / np.linalg.norm(line)
    press = -np.sum(force_uN * normal, axis=1)
    slide = np.abs(planar_cross(normal, force_uN))
    return bool(
        np.all(press >= -law.pull_off_uN)
        and np.all(press <= law.max_force_uN)
        and np.all(slide <= friction * (press + law.pull_off_uN))
    )


def largest_by_bisection(contact_um, normal, law, friction):
    """Return the largest grip, up to the largest force, below which all grips are borne."""
    if bears(contact_um, normal, law, friction, law.max_force_uN):
        return law.max_force_uN
    low, high = 0.0, law.max_force_uN
    for _ in range(60):
        middle = 0.5 * (low + high)
        if bears(contact_um, normal, law, friction, middle):
            low = middle
        else:
            high = middle
    return low


def random_pairs(rng, count):
    """Return pairs on random ellipses, and such that belong to no smooth shape, with laws."""
    for number in range(count):
        if number % 2:
            shape = Ellipse(*rng.uniform(3.0, 40.0, 2), rng.uniform(1.0, 10.0))
            contact, normal, _ = shape.at(rng.uniform(0.0, shape.turn_rad, 2))
        else:
            angle = rng.uniform(0.0, 2 * math.pi, 2)
            contact = rng.uniform(-20.0, 20.0, (2, 2))
            normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        yield (
            contact,
            normal,
            ContactLaw(rng.uniform(0.02, 1.2), rng.uniform(0.1, 4.0), rng.uniform(1.0, 40.0)),
        )


def test_largest_grip_is_found_by_bisection():
    """The closed form is where the cones stop to bear the grip, pulling contacts included."""
    rng = np.random.default_rng(2)
    limited = 0
    for contact, normal, law in random_pairs(rng, 600):
        expected = largest_by_bisection(contact, normal, law, law.friction)
        found = largest_grip_uN(contact, normal, law.friction, law.pull_off_uN, law.max_force_uN)
        assert found == pytest.approx(expected, abs=1e-9), (contact, normal, law)
        limited += found < law.max_force_uN
    assert 100 < limited < 590, 'the cases do not try both answers'


@pytest.mark.parametrize(
    ('beta_deg', 'friction', 'largest_uN'),
    [
        # 0.3 * 1.5 / (sin b - 0.3 cos b)
        (28.0, 0.3, 2.199),
        (20.0, 0.3, 7.486),
        (28.0, 0.18, 0.870),
        (10.0, 0.3, 30.0),  # within the cone: tan 10 deg = 0.18
        (90.0, 0.3, 0.45),
    ],
)
def test_a_line_at_an_angle_to_both_normals(beta_deg, friction, largest_uN):
    """F_max = µ f_po / (sin β - µ cos β) by hand; a constant force does not suit all pairs."""
    s, c = math.sin(math.radians(beta_deg)), math.cos(math.radians(beta_deg))
    contact = np.array([[8.0, 0.0], [-8.0, 0.0]])
    normal = np.array([[c, s], [-c, s]])
    found = largest_grip_uN(contact, normal, friction, 1.5, 30.0)
    assert found == pytest.approx(largest_uN, abs=1e-3)


def test_contacts_of_the_papers_ellipse_bear_few_newtons_where_they_are_steepest():
    """On a 20 x 12 µm ellipse the line of opposite contacts is at up to 28° to the normals."""
    phases = np.linspace(0.0, 2 * math.pi, 721)
    contact = np.stack([10.0 * np.cos(phases), 6.0 * np.sin(phases)], axis=-1)
    normal = np.stack([6.0 * np.cos(phases), 10.0 * np.sin(phases)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    largest = [
        largest_grip_uN(np.stack([at, -at]), np.stack([out, -out]), 0.3, 1.5, 30.0)
        for at, out in zip(contact, normal, strict=True)
    ]
    beta = np.arccos(np.sum(contact * normal, axis=1) / np.linalg.norm(contact, axis=1))
    assert np.degrees(beta.max()) == pytest.approx(28.07, abs=0.05)
    assert min(largest) == pytest.approx(2.19, abs=0.01)
    assert max(largest) == 30.0


def test_two_fingers_at_one_point_hold_nothing():
    """There is no line to press along."""
    at = np.array([[5.0, 1.0], [5.0, 1.0]])
    assert largest_grip_uN(at, np.array([[1.0, 0.0], [1.0, 0.0]]), 0.3, 1.5, 30.0) < 0.0


@pytest.mark.parametrize('rules', [GripRules(), GripRules(0.9, 0.85, 0.1, 3.0)])
def test_rolling_grips_are_nominal_or_the_largest_with_less_friction(rules):
    """Each waypoint has min(nominal, F_max(roll factor · µ)), and the margin of its vectors."""
    rng = np.random.default_rng(8)
    cases = list(random_pairs(rng, 200))
    law = ContactLaw()
    contact = np.stack([case[0] for case in cases])
    normal = np.stack([case[1] for case in cases])
    grip_uN, high_uN, margin_uN = rolling_grips_uN(contact, normal, law, rules)
    assert np.any(grip_uN == rules.nominal_grip_uN)
    assert np.any(grip_uN < rules.nominal_grip_uN)
    friction = rules.margin_factor * law.friction
    for at, out, grip, high, margin in zip(
        contact, normal, grip_uN, high_uN, margin_uN, strict=True
    ):
        largest = largest_by_bisection(at, out, law, rules.roll_factor * law.friction)
        assert high == pytest.approx(largest, abs=1e-9)
        assert grip == min(rules.nominal_grip_uN, high)
        line = (at[1] - at[0]) / np.linalg.norm(at[1] - at[0])
        force_uN = grip * np.stack([line, -line])
        press = -np.sum(force_uN * out, axis=1)
        slide = np.abs(planar_cross(out, force_uN))
        by_hand = [
            friction * (press + law.pull_off_uN) - slide,
            press + law.pull_off_uN,
            friction * (law.max_force_uN - press),
        ]
        assert margin == pytest.approx(np.min(by_hand), abs=1e-9)
        assert margin >= -1e-9


def test_a_grip_near_the_largest_force_states_the_distance_to_overload():
    """Straight across a disc 29 µN are 0.24 (30 - 29) from what a finger can give."""
    contact = np.array([[[10.0, 0.0], [-10.0, 0.0]]])
    rules = GripRules(nominal_grip_uN=29.0)
    grip_uN, high_uN, margin_uN = rolling_grips_uN(contact, contact / 10.0, ContactLaw(), rules)
    assert (grip_uN[0], high_uN[0]) == (29.0, 30.0)
    assert margin_uN[0] == pytest.approx(0.24)


def test_without_adhesion_rolls_are_planned_with_the_friction_of_removals():
    """Nothing sticks: only lines within both cones hold, there with any force, else with none."""
    s, c = math.sin(math.radians(12.0)), math.cos(math.radians(12.0))
    contact = np.array([[[8.0, 0.0], [-8.0, 0.0]]])
    normal = np.array([[[c, s], [-c, s]]])
    law = ContactLaw(adhesion=False)
    # tan 12° = 0.213 is between 0.6 * 0.3 and 0.8 * 0.3
    grip_uN, high_uN, margin_uN = rolling_grips_uN(contact, normal, law, GripRules())
    assert (grip_uN[0], high_uN[0]) == (5.0, 30.0)
    assert margin_uN[0] == pytest.approx(5.0 * (0.24 * c - s))
    grip_uN, _, _ = rolling_grips_uN(contact, normal, law, GripRules(margin_factor=0.6))
    assert grip_uN[0] == pytest.approx(0.0)
