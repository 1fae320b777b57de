# SPDX-License-Identifier: Apache-2.0
"""Discrete rotations: tracks roll without slip, and both ends are met exactly."""

import math

import numpy as np
import pytest

from microhand_planner.core.analytic_sections import ellipse_section, polygon_section
from microhand_planner.core.errors import InvalidParameter
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import Mode, SearchOptions
from microhand_planner.core.rotation_lattice import rotation_lattice
from microhand_planner.core.section import XY_PLANE
from tests.planner.oracles import Ellipse

SHAPE = Ellipse(16.22, 11.586, 4.5)
ROBUST = SearchOptions(math.radians(20.0), Mode.ROBUST)
PAPER = SearchOptions(math.radians(20.0), Mode.PAPER)


@pytest.fixture(scope='module')
def curve():
    """Return the curve of a tip around the paper's ellipse."""
    return offset_curve(ellipse_section(SHAPE.a_um, SHAPE.b_um, XY_PLANE), SHAPE.tip_um)


def turn_gap(phase_rad, turn_rad):
    """Return how far phases are from zero, modulo one turn."""
    return np.abs((phase_rad + turn_rad / 2) % turn_rad - turn_rad / 2)


@pytest.mark.parametrize('angle_deg', [0.0, 13.7, 220.0, -359.0])
@pytest.mark.parametrize('step_deg', [3.3, 20.0, 71.0])
def test_tracks_roll_without_slip(curve, angle_deg, step_deg):
    """At every orientation a track's contact phase is its phase at the start less the angle."""
    options = SearchOptions(math.radians(step_deg))
    lattice = rotation_lattice(curve, math.radians(angle_deg), options, (0.4, 9.87), (0.0, 7.77))
    phases = lattice.phase_rad[lattice.sample_of]
    slip = phases - (phases[:, [lattice.start]] - lattice.theta_rad[None, :])
    assert np.max(turn_gap(slip, SHAPE.turn_rad)) < 1e-8


@pytest.mark.parametrize('angle_deg', [0.0, 1e-6, 13.7, 220.0, -359.0, 360.0])
def test_both_ends_are_met_exactly(curve, angle_deg):
    """The goal angle is an orientation, and given phases have tracks at their end."""
    angle_rad = math.radians(angle_deg)
    lattice = rotation_lattice(curve, angle_rad, ROBUST, (0.4, 9.87), (0.0, 7.77))
    assert lattice.theta_rad[lattice.start] == 0.0
    assert lattice.theta_rad[lattice.goal] == pytest.approx(angle_rad, abs=1e-15)
    for phases, at in (((0.4, 9.87), lattice.start), ((0.0, 7.77), lattice.goal)):
        for phase in phases:
            track = lattice.track_at(phase, at)
            found = lattice.phase_rad[lattice.sample_of[track, at]]
            assert turn_gap(found - phase, SHAPE.turn_rad) < 1e-8


@pytest.mark.parametrize('step_deg', [2.0, 17.3, 20.0, 90.0])
def test_the_step_is_never_longer_than_asked(curve, step_deg):
    """Orientations ascend by at most the step, and reach within one step of a turn either way."""
    options = SearchOptions(math.radians(step_deg))
    lattice = rotation_lattice(curve, math.radians(100.0), options)
    gaps = np.diff(lattice.theta_rad)
    assert np.all(gaps > 0.0)
    assert np.max(gaps) <= options.step_rad + 1e-12
    assert lattice.theta_rad[0] < -2 * math.pi + options.step_rad
    assert lattice.theta_rad[-1] > 2 * math.pi - options.step_rad
    assert lattice.theta_rad[0] >= -2 * math.pi - 1e-9
    assert lattice.theta_rad[-1] <= 2 * math.pi + 1e-9


@pytest.mark.parametrize('options', [ROBUST, PAPER])
def test_samples_are_contacts_of_the_ellipse(curve, options):
    """Centres, contacts and normals are those of an independent calculation."""
    lattice = rotation_lattice(curve, math.radians(220.0), options, (0.0,), (0.0,))
    contact, normal, centre = SHAPE.at(lattice.phase_rad)
    assert lattice.contact_um == pytest.approx(contact, abs=1e-4)
    assert lattice.normal == pytest.approx(normal, abs=1e-4)
    assert lattice.centre_um == pytest.approx(centre, abs=1e-4)
    assert np.all(lattice.usable)


def test_rolls_are_looked_at_every_two_degrees(curve):
    """Between two orientations a roll passes samples that are at most 2 deg apart."""
    options = SearchOptions(math.radians(45.0))
    lattice = rotation_lattice(curve, math.radians(101.0), options)
    gaps_deg = np.degrees(np.diff(lattice.theta_rad)) / (lattice.interior + 1)
    assert np.max(gaps_deg) <= 2.0 + 1e-9
    # rolling forward counts samples down, from the lower orientation on
    for back in range(1, lattice.interior[0] + 1):
        here = lattice.sample_of[3, 0]
        base = here - here % lattice.block
        rolled = base + (here - base - back) % lattice.block
        gone_rad = turn_gap(lattice.phase_rad[here] - lattice.phase_rad[rolled], SHAPE.turn_rad)
        assert math.degrees(gone_rad) == pytest.approx(back * gaps_deg[0])


def test_paper_mode_has_the_papers_lattice(curve):
    """74 contacts, 19 orientations of 20 deg to 360 deg, joint J on contact 38."""
    lattice = rotation_lattice(curve, math.radians(220.0), PAPER, (0.0, curve.phase_of_joint_j))
    assert lattice.contacts == 74
    assert np.degrees(lattice.theta_rad) == pytest.approx(20.0 * np.arange(19))
    assert len(lattice.track_unit) == 74
    assert lattice.track_at(curve.phase_of_joint_j, lattice.start) == 37


def test_paper_mode_takes_multiples_of_the_step_only(curve):
    """An angle between two multiples is refused, and the message names the other mode."""
    with pytest.raises(InvalidParameter, match=r'angle is 210 deg.*multiple.*robust mode'):
        rotation_lattice(curve, math.radians(210.0), PAPER)


def test_nobody_stands_across_a_kink():
    """In a notch the tip touches two walls: no usable sample lies within its step of the kink."""
    corners = [[10, 10], [0, 2], [-10, 10], [-10, -10], [10, -10]]
    notched = offset_curve(polygon_section(np.array(corners, dtype=float), XY_PLANE), 1.0)
    assert len(notched.kinks_rad) == 1
    lattice = rotation_lattice(notched, 1.0, SearchOptions(math.radians(45.0)))
    sampling_rad = lattice.spacing_rad * lattice.contacts / lattice.block
    kink = notched.kinks_rad[0] % notched.length_rad
    near = turn_gap(lattice.phase_rad - kink, notched.length_rad) <= sampling_rad
    assert np.any(near)
    assert not np.any(lattice.usable[near])
    assert np.mean(lattice.usable) > 0.9


def test_arrays_are_read_only(curve):
    """A lattice is a value: nobody changes it behind another's back."""
    lattice = rotation_lattice(curve, 1.0, ROBUST)
    with pytest.raises(ValueError, match='read-only'):
        lattice.centre_um[0] = 0.0
