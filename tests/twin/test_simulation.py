# SPDX-License-Identifier: Apache-2.0
"""The physics of the twin against formulas: pull-off, slip, rolls. Needs no ROS."""

import numpy as np
import pytest

from microhand_planner.core.errors import InvalidNumber, InvalidParameter
from microhand_planner.core.parameters import ContactLaw
from microhand_planner.core.pose import Pose
from microhand_twin.simulation import Simulation
from microhand_twin.world import build_world
from tests.planner.solids import ellipsoid
from tests.twin.rolls import AWAY_UM, roll
from tests.twin.theory import Ellipse

Z = (0.0, 0.0, 1.0)
SHAPE = Ellipse(20.0, 12.0)
TIPS_UM = np.array([[24.5, 0.0, 0.0], [-24.5, 0.0, 0.0], AWAY_UM])


@pytest.fixture(scope='module')
def part():
    """Return an ellipsoid of 20 x 12 x 12 µm."""
    return ellipsoid((20.0, 12.0, 12.0))


def simulation_of(part, **options):
    """Return a new simulation of a part."""
    return Simulation(build_world(part, **options))


@pytest.mark.parametrize('pull_off_uN', [0.7, 1.5])
def test_a_tip_detaches_at_the_pull_off_force(part, pull_off_uN):
    """Pulled slowly, a tip holds until its spring pulls with the pull-off force, then lets go."""
    simulation = simulation_of(part, law=ContactLaw(pull_off_uN=pull_off_uN))
    simulation.place(Pose(), TIPS_UM, fixed=True)
    command_um = TIPS_UM.copy()
    strongest_uN = 0.0
    while simulation.contacts().touching[0]:
        command_um[0, 0] += 1e-4
        simulation.advance(command_um, 0.002)
        strongest_uN = max(strongest_uN, 100.0 * (command_um - simulation.tip_um)[0, 0])
    assert strongest_uN == pytest.approx(pull_off_uN, rel=1e-4)


def test_without_adhesion_a_tip_does_not_pull(part):
    """A law without adhesion lets a tip go at once, whatever pull-off force it names."""
    simulation = simulation_of(part, law=ContactLaw(adhesion=False))
    simulation.place(Pose(), TIPS_UM, fixed=True)
    command_um = TIPS_UM.copy()
    command_um[0, 0] += 0.02
    simulation.advance(command_um, 0.02)
    felt = simulation.contacts()
    assert not felt.touching[0]
    assert simulation.tip_um[0] == pytest.approx(command_um[0], abs=1e-6)


@pytest.mark.parametrize('grip_uN', [20.0, 10.0, 5.0])
def test_slip_begins_where_coulomb_says(part, grip_uN):
    """Rolled under a constant grip, tips slip where sin β F = µ (cos β F + f_po), within 0.5°."""
    expected_deg = SHAPE.slip_deg(grip_uN, 0.3, 1.5)
    rolled = roll(simulation_of(part), SHAPE.contacts, Z, 120.0, grip_uN)
    assert rolled.slipped_deg == pytest.approx(expected_deg, abs=0.5)
    before = rolled.angle_deg < expected_deg - 1.0
    assert np.all(rolled.error_deg[before] < 0.1)


def test_without_adhesion_the_object_is_lost_where_the_cones_are_left(part):
    """With nothing that sticks, the roll fails at tan β = µ, whatever the grip."""
    expected_deg = SHAPE.slip_deg(5.0, 0.3, 0.0)
    law = ContactLaw(adhesion=False)
    rolled = roll(simulation_of(part, law=law), SHAPE.contacts, Z, 120.0, 5.0)
    lost_deg = rolled.angle_deg[np.flatnonzero(rolled.error_deg > 1.0)[0]]
    assert rolled.slipped_deg == pytest.approx(expected_deg, abs=0.5)
    assert expected_deg < lost_deg < expected_deg + 3.0
    assert rolled.error_deg[-1] > 45.0


def test_a_roll_within_the_cones_is_exact(part):
    """An 80° roll under 2 µN ends within 0.01°, and moves the object by less than 2 nm."""
    rolled = roll(simulation_of(part), SHAPE.contacts, Z, 80.0, 2.0)
    assert rolled.error_deg.max() < 0.01
    assert rolled.offset_um < 2e-3
    assert rolled.friction_use.max() < 0.7


@pytest.mark.parametrize('stiffness', [10.0, 100.0, (10.0, 30.0, 100.0)])
def test_springs_make_the_forces(part, stiffness):
    """Commanded into the object by f/k, tips of stiffness k press with f, within 1 %."""
    simulation = simulation_of(part, stiffness_uN_per_um=stiffness)
    springs = np.broadcast_to(stiffness, 3)
    simulation.place(Pose(), TIPS_UM, fixed=True)
    command_um = TIPS_UM.copy()
    command_um[0, 0] -= 3.0 / springs[0]
    command_um[1, 0] += 3.0 / springs[1]
    simulation.advance(command_um, 0.1)
    simulation.release_object()
    simulation.advance(command_um, 0.1)
    felt = simulation.contacts()
    assert felt.normal_uN[:2] == pytest.approx([3.0, 3.0], rel=0.01)
    assert felt.force_uN[:2] == pytest.approx(
        np.array([[-3.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), rel=0.01, abs=1e-3
    )
    assert felt.touching.tolist() == [True, True, False]


def test_fingers_do_not_lag(part):
    """A tip in the air is on its command all along a steady motion, not only at its end."""
    simulation = simulation_of(part)
    tips_um = TIPS_UM * [9.0, 1.0, 1.0]
    simulation.place(Pose(), tips_um)
    behind_um = []
    for step in range(1, 101):
        command_um = tips_um + step * np.array([0.0, 0.8, 0.4])
        simulation.advance(command_um, 0.002)
        behind_um.append(np.abs(simulation.tip_um - command_um).max())
    assert max(behind_um[10:]) < 1e-6
    assert simulation.time_s == pytest.approx(0.2)


def test_a_fixed_object_stays(part):
    """Fixed, the object does not move under 30 µN from one side; released, it does."""
    simulation = simulation_of(part)
    pose = Pose((3.0, -2.0, 1.0), (0.8, 0.0, 0.6, 0.0))
    tips_um = TIPS_UM.copy()
    tips_um[1] += [-50.0, 0.0, 0.0]
    tips_um[0] = pose.position_um + pose.rotation.apply([24.5, 0.0, 0.0])
    simulation.place(pose, tips_um, fixed=True)
    command_um = tips_um.copy()
    command_um[0] -= pose.rotation.apply([0.3, 0.0, 0.0])
    simulation.advance(command_um, 0.5)
    assert simulation.contacts().normal_uN[0] == pytest.approx(30.0, rel=0.01)
    assert simulation.object_position_um == pytest.approx(pose.position_um, abs=1e-9)
    assert simulation.object_pose == pose
    simulation.release_object()
    simulation.advance(command_um, 0.1)
    assert simulation.object_position_um != pytest.approx(pose.position_um, abs=0.1)


@pytest.mark.parametrize('stiffness', [(100.0, 10.0), -1.0, float('nan')])
def test_impossible_stiffness_is_refused(part, stiffness):
    """A stiffness that is not positive, or not one or three numbers, is named."""
    with pytest.raises((InvalidNumber, InvalidParameter), match='stiffness'):
        build_world(part, stiffness_uN_per_um=stiffness)
