# SPDX-License-Identifier: Apache-2.0
"""The answer of springs against their energy, minimised numerically, and against least squares."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from microhand_planner.core.removal import contact_lines
from microhand_planner.core.spring_response import spring_response_uN
from tests.planner.oracles import Ellipse, least_energy_answer


def random_plane(rng):
    """Return two axes and the normal of a plane in space, as rows."""
    return Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()


def forces_of_least_energy(contact_um, axes, load):
    """Return the springs' forces (k, 3) where their energy less the work of the load is least.

    The object moves by (u, v) and turns by w / size: the spring at p is stretched by
    (u, v) + w / size * e_z x p, and pulls it back with as much at stiffness one.
    """
    planar_um = contact_um @ axes[:2].T
    size = np.abs(planar_um).max()
    load_in_plane = np.array([axes[0] @ load[:3], axes[1] @ load[:3], axes[2] @ load[3:] / size])

    def stretched(freedom):
        turned = np.stack([-planar_um[:, 1], planar_um[:, 0]], axis=1) / size
        return freedom[:2] + freedom[2] * turned

    def energy(freedom):
        return 0.5 * np.sum(stretched(freedom) ** 2) - load_in_plane @ freedom

    found = minimize(energy, np.zeros(3), method='BFGS', options={'gtol': 1e-9})
    return -stretched(found.x) @ axes[:2]


@pytest.mark.parametrize('count', [2, 3, 4])
def test_forces_are_those_of_least_energy(count):
    """For contacts anywhere in any plane, and loads in it, the minimum of the energy agrees."""
    rng = np.random.default_rng(count)
    for _ in range(40):
        axes = random_plane(rng)
        contact_um = rng.uniform(-20.0, 20.0, (count, 2)) @ axes[:2]
        force_uN = rng.uniform(-3.0, 3.0, 2) @ axes[:2]
        at_um = rng.uniform(-20.0, 20.0, 2) @ axes[:2]
        load = np.concatenate([force_uN, np.cross(at_um, force_uN)])
        found = spring_response_uN(contact_um, axes[2], load)
        expected = forces_of_least_energy(contact_um, axes, load)
        assert found == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize('count', [2, 3, 5])
def test_forces_balance_the_load_with_the_least_sum_of_squares(count):
    """Forces and moments sum up to nothing with the load, and no smaller forces do that."""
    rng = np.random.default_rng(10 + count)
    for _ in range(60):
        axes = random_plane(rng)
        planar_um = rng.uniform(-20.0, 20.0, (count, 2))
        contact_um = planar_um @ axes[:2]
        force_uN = rng.uniform(-3.0, 3.0, 2)
        moment = rng.uniform(-30.0, 30.0)
        load = np.concatenate([force_uN @ axes[:2], moment * axes[2]])
        found = spring_response_uN(contact_um, axes[2], load)
        assert found.sum(axis=0) == pytest.approx(-load[:3], abs=1e-9)
        assert np.cross(contact_um, found).sum(axis=0) == pytest.approx(-load[3:], abs=1e-8)
        expected = least_energy_answer(planar_um, [*force_uN, moment])
        assert found @ axes[:2].T == pytest.approx(expected, abs=1e-8)


def test_two_fingers_answer_a_pull_as_the_planar_formula_says():
    """Normal and tangential parts of the answer are the lines from which windows are made."""
    rng = np.random.default_rng(4)
    for _ in range(60):
        shape = Ellipse(*rng.uniform(3.0, 40.0, 2), rng.uniform(1.0, 10.0))
        contact, normal, _ = shape.at(rng.uniform(0.0, shape.turn_rad, 3))
        if np.linalg.norm(contact[0] - contact[1]) < 1.0:
            continue
        pull_off_uN = rng.uniform(0.1, 4.0)
        lines = contact_lines(contact[:2], normal[:2], contact[2], normal[2], pull_off_uN)
        axes = random_plane(rng)
        contact_um, outward = contact @ axes[:2], normal @ axes[:2]
        pull = pull_off_uN * outward[2]
        load = np.concatenate([pull, np.cross(contact_um[2], pull)])
        found = spring_response_uN(contact_um[:2], axes[2], load)
        tangent = np.cross(axes[2], outward[:2])
        assert -np.sum(found * outward[:2], axis=1) == pytest.approx(lines[:, 0], abs=1e-9)
        assert np.sum(found * tangent, axis=1) == pytest.approx(lines[:, 1], abs=1e-9)


def test_grip_slopes_are_the_components_of_a_force_along_the_line():
    """The other two columns of the lines: one unit of grip, in normal and tangential parts."""
    angle = np.radians([20.0, 200.0, 90.0])
    contact = 10.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    lean = np.radians([30.0, 190.0, 90.0])
    normal = np.stack([np.cos(lean), np.sin(lean)], axis=-1)
    lines = contact_lines(contact[:2], normal[:2], contact[2], normal[2], 1.5)
    ten = math.radians(10.0)
    assert lines[:, 2] == pytest.approx([math.cos(ten), math.cos(ten)])
    assert np.abs(lines[:, 3]) == pytest.approx([math.sin(ten), math.sin(ten)])


def test_three_fingers_share_a_load_at_their_middle():
    """A force through the middle of an equilateral triangle is shared alike by all three."""
    angle = np.radians([90.0, 210.0, 330.0])
    contact_um = 12.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    load = np.array([0.6, -0.9, 0.0, 0.0, 0.0, 0.0])
    found = spring_response_uN(contact_um, np.array([0.0, 0.0, 1.0]), load)
    assert found == pytest.approx(np.tile([-0.2, 0.3, 0.0], (3, 1)))


def test_a_moment_is_borne_by_forces_around_the_middle():
    """36 µN·µm on three fingers at 12 µm: each pushes 1 µN along its circle."""
    angle = np.radians([90.0, 210.0, 330.0])
    contact_um = 12.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    load = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 36.0])
    found = spring_response_uN(contact_um, np.array([0.0, 0.0, 1.0]), load)
    around = np.stack([np.sin(angle), -np.cos(angle), 0 * angle], axis=-1)
    assert found == pytest.approx(around)
