# SPDX-License-Identifier: Apache-2.0
"""The equilibrium program: loads worked by hand, and a program in edges of cones for any load."""

import math

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from microhand_planner.core.equilibrium import can_balance, wrench_of
from microhand_planner.core.parameters import ContactLaw
from tests.planner.oracles import Ellipse, removable_from

X, Y, Z = np.eye(3)
SIDES = np.stack([10.0 * X, -10.0 * X])
NORMALS = np.stack([X, -X])
LAW = ContactLaw()


def load(force, moment=(0.0, 0.0, 0.0)):
    """Return a wrench on the object."""
    return np.concatenate([force, moment])


def test_wrench_is_force_and_moment_about_the_origin():
    """2 µN along Y at x = 3 µm turn about Z with 6 µN·µm."""
    found = wrench_of(2.0 * Y, 3.0 * X + 5.0 * Y)
    assert found.tolist() == [0.0, 2.0, 0.0, 0.0, 0.0, 6.0]


@pytest.mark.parametrize(
    ('wrench', 'most'),
    [
        # both contacts at full force: 2 * 0.3 (30 + 1.5)
        (load(Y), 18.9),
        (load(Z), 18.9),
        # the sum of both tangents is bounded, so less in between
        (load((Y + Z) / math.sqrt(2.0)), 18.9 / math.sqrt(2.0)),
        # along the line: one presses with 30, the other pulls with 1.5
        (load(X), 31.5),
        # about Z each contact bears 0.3 (30 + 1.5) at 10 µm
        (load(np.zeros(3), Z), 2 * 9.45 * 10.0),
    ],
)
def test_two_fingers_on_opposite_sides_bear_so_much(wrench, most):
    """Loads just below what is worked out by hand are borne, loads just above are not."""
    assert can_balance(SIDES, NORMALS, Z, LAW, 0.999 * most * wrench)
    assert not can_balance(SIDES, NORMALS, Z, LAW, 1.001 * most * wrench)


def test_two_points_do_not_resist_a_turn_about_their_line():
    """However small a moment about X is, two contacts on X cannot bear it."""
    assert can_balance(SIDES, NORMALS, Z, LAW)
    assert not can_balance(SIDES, NORMALS, Z, LAW, load(np.zeros(3), 0.01 * X))


def test_fingers_on_one_side_hold_by_pulling_only():
    """Two on top bear a load downwards up to their pull-off, and none if they must press."""
    contact = np.stack([3.0 * X + 8.0 * Y, -3.0 * X + 8.0 * Y])
    normal = np.stack([Y, Y])
    assert can_balance(contact, normal, Z, LAW, load(-2.99 * Y))
    assert not can_balance(contact, normal, Z, LAW, load(-3.01 * Y))
    assert not can_balance(contact, normal, Z, LAW, load(-0.5 * Y), least_normal_uN=0.0)
    assert can_balance(contact, normal, Z, LAW, load(0.5 * Y), least_normal_uN=0.0)


def test_without_adhesion_fingers_on_one_side_hold_nothing():
    """Nothing sticks: a load away from them is lost, one towards them is held."""
    contact = np.stack([3.0 * X + 8.0 * Y, -3.0 * X + 8.0 * Y])
    normal = np.stack([Y, Y])
    law = ContactLaw(adhesion=False)
    assert not can_balance(contact, normal, Z, law, load(-0.01 * Y))
    assert can_balance(contact, normal, Z, law, load(0.01 * Y))


def balances_by_edges(contact_um, normal, plane_normal, law, wrench, least_uN):
    """Return whether edges of the friction pyramids, with weights >= 0, add up against a load.

    Each contact's forces are the apex, a pull of f_po, plus the four edges with weights whose sum
    is the normal force above the apex. The program makes the rest of the balance as small as it
    can be; a load is borne if nothing is left.
    """
    stick_uN = law.pull_off_uN if law.adhesion else 0.0
    columns, apex = [], np.asarray(wrench, dtype=float)
    for at_um, outward in zip(contact_um, normal, strict=True):
        along = np.cross(plane_normal, outward)
        for edge in (along, -along, plane_normal, -plane_normal):
            force = -outward + law.friction * edge
            columns.append([*force, *np.cross(at_um, force)])
        pull = stick_uN * outward
        apex = apex + np.array([*pull, *np.cross(at_um, pull)])
    count = len(columns)
    scale = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
    balance = np.hstack([scale[:, None] * np.array(columns).T, np.eye(6), -np.eye(6)])
    sums = np.kron(np.eye(len(contact_um)), np.ones(4))
    sums = np.hstack([sums, np.zeros((len(contact_um), 12))])
    answer = linprog(
        [*np.zeros(count), *np.ones(12)],
        A_ub=np.vstack([sums, -sums]),
        b_ub=[
            *np.full(len(contact_um), law.max_force_uN + stick_uN),
            *np.full(len(contact_um), -least_uN - stick_uN),
        ],
        A_eq=balance,
        b_eq=-scale * apex,
        bounds=[(0.0, None)] * (count + 12),
        method='highs-ipm',
    )
    return answer.status == 0 and answer.fun < 1e-6


@pytest.mark.parametrize('fingers', [2, 3, 4])
@pytest.mark.parametrize('adhesion', [True, False])
def test_any_load_is_judged_as_by_a_program_in_edges(fingers, adhesion):
    """Random contacts in space, laws, loads, and least normal forces: the two programs agree."""
    rng = np.random.default_rng(100 * fingers + adhesion)
    borne = 0
    for _ in range(80):
        law = ContactLaw(
            rng.uniform(0.1, 1.5), rng.uniform(0.5, 4.0), rng.uniform(2.0, 30.0), adhesion
        )
        turn = Rotation.random(random_state=int(rng.integers(1 << 30)))
        angle = rng.uniform(0.0, 2 * math.pi, fingers)
        circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
        lean = 0.3 * rng.normal(size=(fingers, 1)) * np.cross(Z, circle)
        normal = circle + lean
        normal = turn.apply(normal / np.linalg.norm(normal, axis=1, keepdims=True))
        contact_um = turn.apply(rng.uniform(5.0, 15.0) * circle)
        plane_normal = turn.apply(Z)
        force = turn.apply(rng.normal(size=3) * [1.0, 1.0, 0.3])
        at_um = turn.apply(rng.uniform(-8.0, 8.0, 3) * [1.0, 1.0, 0.0])
        # two points bear no moment about their line: loads without one are the interesting ones
        if fingers == 2:
            at_um = contact_um.mean(axis=0)
        wrench = rng.uniform(0.0, 6.0) * np.array([*force, *np.cross(at_um, force)])
        least_uN = float(rng.choice([0.0, -law.stick_uN, 0.03]))
        found = can_balance(
            contact_um, normal, plane_normal, law, wrench, least_normal_uN=least_uN
        )
        expected = balances_by_edges(contact_um, normal, plane_normal, law, wrench, least_uN)
        assert found == expected, (contact_um, normal, law, wrench, least_uN)
        borne += found
    assert 4 < borne < 76, 'the cases do not try both answers'


def test_removals_in_the_plane_are_judged_as_by_the_null_space_of_the_grasp():
    """The pull of a third finger on two that must not pull: another method, the same answer."""
    rng = np.random.default_rng(6)
    possible = 0
    for _ in range(120):
        shape = Ellipse(*rng.uniform(5.0, 30.0, 2), 4.5)
        contact, normal, _ = shape.at(rng.uniform(0.0, shape.turn_rad, 3))
        law = ContactLaw(rng.uniform(0.05, 1.0), rng.uniform(0.2, 3.0), rng.uniform(2.0, 40.0))
        expected = removable_from(contact[:2], normal[:2], contact[2:], normal[2:], law)[0]
        in_space = np.column_stack([contact, np.zeros(3)])
        outward = np.column_stack([normal, np.zeros(3)])
        pull = wrench_of(law.pull_off_uN * outward[2], in_space[2])
        found = can_balance(in_space[:2], outward[:2], Z, law, pull, least_normal_uN=0.0)
        assert found == expected
        possible += found
    assert 12 < possible < 108
