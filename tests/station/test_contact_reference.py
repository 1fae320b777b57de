# SPDX-License-Identifier: Apache-2.0
"""Where fingers touched, and what becomes of their commands: whole plans, without stages."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.motions import motions
from microhand_planner.core.trajectory import Pace
from microhand_station.sequencer.contact_reference import NO_CONTACT, ContactReference

SPEED_UM_S = 5.0
STIFFNESS = (20.0, 50.0, 100.0)
vector = st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3).map(np.array)


@pytest.fixture(scope='module')
def pieces(sphere_plan):
    """Return the motions of a small plan: fingers 1 and 2 meet the object, then finger 3."""
    return motions(sphere_plan(20.0), Pace(), STIFFNESS)


def guarded(pieces):
    """Return the motions in which fingers feel for the object."""
    return [motion for motion in pieces if any(motion.guarded)]


def test_the_plan_has_what_these_tests_need(pieces):
    """First both fingers of the grasp feel for the object, then the third."""
    assert [motion.guarded for motion in guarded(pieces)] == [
        (True, True, False),
        (False, False, True),
    ]


@settings(deadline=None, derandomize=True, max_examples=40)
@given(
    offsets=st.lists(vector, min_size=3, max_size=3),
    aside=st.lists(vector, min_size=3, max_size=3),
)
def test_commands_lead_from_where_fingers_stand_onto_the_shifted_way(pieces, offsets, aside):
    """They begin where the fingers stand, end on the plan plus offset, and never jump."""
    trajectory = pieces[-1].trajectory
    reference = ContactReference(np.array(offsets))
    standing_um = trajectory.tip_um[0] + np.array(aside)
    commands = reference.commands(trajectory, standing_um, SPEED_UM_S)
    np.testing.assert_allclose(commands.tip_um[0], standing_um, atol=1e-12)
    np.testing.assert_allclose(commands.tip_um[-1], trajectory.tip_um[-1] + offsets, atol=1e-12)
    np.testing.assert_allclose(commands.velocity_um_s[[0, -1]], 0.0, atol=1e-9)
    # velocities are the derivative: the trapezoidal rule leads from one setpoint to the next
    steps_um = np.diff(commands.tip_um - trajectory.tip_um, axis=0)
    extra_um_s = commands.velocity_um_s - trajectory.velocity_um_s
    mean_um_s = 0.5 * (extra_um_s[1:] + extra_um_s[:-1])
    np.testing.assert_allclose(steps_um, mean_um_s * trajectory.period_s, atol=1e-4)
    assert np.linalg.norm(extra_um_s, axis=2).max() <= SPEED_UM_S * (1 + 1e-9)
    np.testing.assert_array_equal(commands.step_of, trajectory.step_of)


def test_without_contact_and_offset_commands_are_the_plan(pieces):
    """A finger that stands where the motion begins is sent the motion as planned."""
    for motion in pieces:
        commands = ContactReference().commands(
            motion.trajectory, motion.trajectory.tip_um[0], SPEED_UM_S
        )
        np.testing.assert_array_equal(commands.tip_um, motion.trajectory.tip_um)
        np.testing.assert_array_equal(commands.velocity_um_s, motion.trajectory.velocity_um_s)


def test_a_reference_is_learned_finger_by_finger_and_forgotten_when_it_leaves(pieces):
    """What is met is kept for those who touch, and only for them."""
    first, second = guarded(pieces)
    met_um = first.contact_um + np.array([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.0]])
    reference = ContactReference().learn(first, met_um, 0.4)
    np.testing.assert_allclose(reference.offset_um, [[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0]])
    reference = reference.learn(second, second.contact_um + 0.05, 0.4)
    np.testing.assert_allclose(reference.offset_um[2], 0.05)
    np.testing.assert_allclose(reference.offset_um[:2], [[0.1, 0, 0], [0, 0.2, 0]])
    reference = reference.forget((False, True, True))
    np.testing.assert_allclose(reference.offset_um, [[0, 0, 0], [0, 0.2, 0], [0.05] * 3])


def test_a_press_is_as_hard_as_planned_wherever_the_object_was_met(sphere_plan, pieces):
    """On springs that rest where the tips touched, the commands make the planned forces."""
    plan = sphere_plan(20.0)
    first = guarded(pieces)[0]
    met_um = first.contact_um + np.array([[0.3, 0, 0], [-0.25, 0, 0], [0, 0, 0]])
    reference = ContactReference().learn(first, met_um, 0.4)
    roll = next(motion for motion in pieces if 2 in motion.trajectory.step_of)
    at = int(np.flatnonzero(roll.trajectory.step_of == 2)[-1])
    commands = reference.commands(roll.trajectory, met_um, SPEED_UM_S)
    moved_um = plan.steps[2].tip_um[-1] - plan.steps[2].tip_um[0]  # of the contacts, by the plan
    for finger in (0, 1):
        rest_um = met_um[finger] + moved_um[finger]
        force_uN = (commands.tip_um[at, finger] - rest_um) * STIFFNESS[finger]
        np.testing.assert_allclose(force_uN, plan.steps[2].force_uN[-1, finger], atol=1e-3)


@pytest.mark.parametrize(
    ('along_um', 'message'),
    [
        (np.nan, 'finger 3 met nothing'),
        (-0.45, 'finger 3 met the object 0.45 µm too early; allowed: 0.4 µm'),
        (0.41, 'finger 3 met the object 0.41 µm too late; allowed: 0.4 µm'),
    ],
)
def test_what_is_met_too_far_away_ends_the_run(pieces, along_um, message):
    """NO_CONTACT names the finger, how far off, and what is allowed."""
    motion = guarded(pieces)[1]
    way = motion.contact_um[2] - motion.trajectory.tip_um[0, 2]
    met_um = np.full((3, 3), np.nan)
    met_um[2] = motion.contact_um[2] + along_um * way / np.linalg.norm(way)
    with pytest.raises(RunFailed) as error:
        ContactReference().learn(motion, met_um, 0.4)
    assert (error.value.code, str(error.value)) == (NO_CONTACT, message)
