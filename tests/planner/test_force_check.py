# SPDX-License-Identifier: Apache-2.0
"""Checking forces: what the planner makes passes, and every way to spoil a grip is found."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from microhand_msgs_py.msg import ErrorCode
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import InvalidPlan, NoPlanExists
from microhand_planner.core.force_check import check_forces
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, Mode, SearchOptions
from microhand_planner.core.plan import StepKind
from microhand_planner.core.plan_check import InvalidStep, check_plan
from microhand_planner.core.plan_file import plan_from_dict, plan_hash, plan_to_dict
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.section_curves import section_curves

FINGER = Finger(clearance_um=0.5)
START = Pose((3.0, -2.0, 1.0), (0.9, 0.1, -0.3, 0.2))


def planned(name, turn, law=None, rules=None, mode=Mode.ROBUST):
    """Return a plan for an object of the catalogue."""
    return plan_reorientation(
        section_curves(find_part(name), FINGER),
        START,
        Pose.of((4.0, -2.0, 1.0), START.rotation * turn),
        FINGER,
        law or ContactLaw(),
        SearchOptions(math.radians(20.0), mode),
        rules or GripRules(),
    )


@pytest.fixture(scope='module')
def plan():
    """Return a plan with rolls, regrasps, grips and a translation."""
    return planned('ellipsoid', Rotation.from_euler('ZYZ', [40.0, 110.0, 30.0], degrees=True))


@pytest.fixture(scope='module')
def pressing():
    """Return a plan without adhesion."""
    turn = Rotation.from_euler('ZYZ', [40.0, 110.0, 30.0], degrees=True)
    return planned('convex', turn, ContactLaw(friction=0.5, adhesion=False))


def numbers(plan, kind):
    """Return the indices of the steps of a kind."""
    return [number for number, step in enumerate(plan.steps) if step.kind is kind]


def with_steps(plan, changes):
    """Return a plan with other values in some steps, by their numbers."""
    steps = [
        dataclasses.replace(step, **changes.get(number, {}))
        for number, step in enumerate(plan.steps)
    ]
    return dataclasses.replace(plan, steps=tuple(steps))


def refused(plan):
    """Return the error with which a plan is refused, and check what every such error owes."""
    with pytest.raises(InvalidStep) as caught:
        check_forces(plan)
    error = caught.value
    assert error.code == ErrorCode.INVALID_PLAN
    kind = plan.steps[error.step].kind.value
    assert str(error).startswith(f'step {error.step} ({kind}): ')
    assert '; allowed: ' in str(error)
    return error


# ---------------------------------------------------------------- what the planner makes


@pytest.mark.parametrize('name', ['ellipsoid', 'convex', 'concave'])
@pytest.mark.parametrize('adhesion', [True, False])
def test_plans_of_the_planner_pass(name, adhesion):
    """Random goals for three objects, with adhesion and without: each plan keeps its margins."""
    # without adhesion the ellipsoid needs friction, or the search takes seconds
    law = ContactLaw(friction=0.3 if adhesion else 0.7, adhesion=adhesion)
    found = 0
    for seed in range(4):
        try:
            plan = planned(name, Rotation.random(random_state=seed), law)
        except NoPlanExists:
            continue
        check_plan(plan)
        check_forces(plan)
        assert plan.tightest is not None
        found += 1
    assert found >= 3


@pytest.mark.parametrize(
    'rules',
    [
        GripRules(margin_factor=1.0, least_margin_uN=0.001, grip_tolerance_uN=0.01),
        GripRules(roll_factor=0.3, nominal_grip_uN=1.0),
        GripRules(margin_factor=0.7, grip_tolerance_uN=0.2),
    ],
)
def test_plans_by_other_rules_pass(rules):
    """Whatever the margins are, the plan keeps those that it states."""
    plan = planned('convex', Rotation.random(random_state=7), rules=rules)
    assert plan.rules == rules
    check_forces(plan)


def test_plans_of_the_paper_are_checked_by_its_own_conditions():
    """Paper mode leaves forces open: Eq. 4 counts, by linear programs."""
    turn = Rotation.from_euler('ZYZ', [40.0, 120.0, 20.0], degrees=True)
    plan = planned('ellipsoid', turn, mode=Mode.PAPER)
    assert plan.reconfigurations > 0
    assert plan.tightest is None
    check_forces(plan)
    slippery = dataclasses.replace(plan, law=ContactLaw(friction=0.02))
    error = refused(slippery)
    assert plan.steps[error.step].kind is StepKind.REMOVE
    assert 'which the others cannot balance' in str(error)


# ---------------------------------------------------------------- what others make of it


def test_a_plan_for_less_friction_than_it_was_made_for_is_refused(plan):
    """The same forces with half the friction leave the cones, or their margins."""
    slippery = dataclasses.replace(plan, law=ContactLaw(friction=0.15))
    assert plan.steps[refused(slippery).step].kind in (
        StepKind.GRIP, StepKind.ROLL, StepKind.REMOVE,
    )  # fmt: skip


def test_forces_of_a_roll_above_the_largest_grip_are_refused(plan):
    """Three times what rolling allows, at one place of a roll, is outside the cones there."""
    tight = [
        number
        for number in numbers(plan, StepKind.ROLL)
        if plan.steps[number].hold.high_uN < plan.rules.nominal_grip_uN
    ]
    number = tight[0]
    step = plan.steps[number]
    force_uN = np.array(step.force_uN)
    grip_uN = np.linalg.norm(force_uN, axis=2).max(axis=1)
    weakest = 1 + int(np.argmin(grip_uN[1:-1]))
    force_uN[weakest] *= 3.0
    error = refused(with_steps(plan, {number: {'force_uN': force_uN}}))
    assert error.step == number
    assert f'forces at waypoint {weakest} is ' in str(error)
    assert 'outside what contacts bear; allowed: forces inside the friction cones at 0.8' in str(
        error
    )


def test_all_forces_scaled_are_refused(plan):
    """Fingers that press seven times harder everywhere hold without a jump, but not in cones."""
    changes = {
        number: {'force_uN': 7.0 * step.force_uN, 'hold': None}
        for number, step in enumerate(plan.steps)
    }
    assert 'outside what contacts bear' in str(refused(with_steps(plan, changes)))


def gripped(plan, number, factor):
    """Return a plan whose removal has another preload, with the ramps that belong to it."""
    before, step, after = plan.steps[number - 1 : number + 2]
    assert before.kind is after.kind is StepKind.GRIP
    ramp_in, ramp_out = np.array(before.force_uN), np.array(after.force_uN)
    ramp_in[-1] *= factor
    ramp_out[0] *= factor
    hold = dataclasses.replace(step.hold, grip_uN=factor * step.hold.grip_uN, margin_uN=-9.0)
    return with_steps(
        plan,
        {
            number - 1: {'force_uN': ramp_in},
            number: {'force_uN': factor * step.force_uN, 'hold': hold},
            number + 1: {'force_uN': ramp_out},
        },
    )


def test_preloads_moved_out_of_their_windows_are_refused(plan):
    """Inside either end of its window a removal passes, a micronewton outside it is refused."""
    ends = 0
    for number in numbers(plan, StepKind.REMOVE):
        hold = plan.steps[number].hold
        for inside, outside in (
            (hold.low_uN + 0.02, hold.low_uN - 1.0),
            (hold.high_uN - 0.02, hold.high_uN + 1.0),
        ):
            if outside < 0.0 or plan.steps[number - 1].kind is not StepKind.GRIP:
                continue
            check_forces(gripped(plan, number, inside / hold.grip_uN))
            error = refused(gripped(plan, number, outside / hold.grip_uN))
            # before the finger pulls the cones alone may be left, in the ramp to the preload
            assert error.step in (number - 1, number)
            if error.step == number:
                assert 'margin of the grip, with' in str(error)
                assert f'the pull of finger {plan.steps[number].finger} is ' in str(error)
                assert 'allowed: at least 0.05 µN' in str(error)
            ends += 1
    assert ends >= 2


def test_a_jump_of_forces_between_steps_is_refused(plan):
    """A roll that begins with 1 % more force than the ramp before it ended with."""
    number = numbers(plan, StepKind.ROLL)[0]
    force_uN = np.array(plan.steps[number].force_uN)
    force_uN[0] *= 1.01
    error = refused(with_steps(plan, {number: {'force_uN': force_uN}}))
    assert error.step == number
    assert 'jump of a force is 0.0' in str(error)


@pytest.mark.parametrize('kind', [StepKind.ROLL, StepKind.TRANSLATE, StepKind.GRIP])
def test_a_finger_that_presses_alone_is_refused(plan, kind):
    """Forces that do not sum up to nothing are named with their waypoint."""
    number = numbers(plan, kind)[-1]
    step = plan.steps[number]
    force_uN = np.array(step.force_uN)
    force_uN[-1, step.in_contact.index(True)] *= 0.5
    changes = {number: {'force_uN': force_uN}}
    error = refused(with_steps(plan, changes))
    assert error.step == number
    assert f'sum of forces and torques at waypoint {len(step) - 1} is' in str(error)


def test_a_couple_is_refused(plan):
    """Opposite forces across the line of two fingers sum up to nothing, but turn the object."""
    number = numbers(plan, StepKind.ROLL)[-1]
    step = plan.steps[number]
    held = np.flatnonzero(step.in_contact)
    normal = step.normal[3, held[0]]
    axis = Rotation.from_quat(step.object_quaternion_wxyz[3, [1, 2, 3, 0]]).apply(
        {'z': [0.0, 0.0, 1.0], 'y': [0.0, 1.0, 0.0]}[plan.rotations[step.rotation].axis]
    )
    force_uN = np.array(step.force_uN)
    force_uN[3, held] += 0.1 * np.stack([np.cross(axis, normal), -np.cross(axis, normal)])
    error = refused(with_steps(plan, {number: {'force_uN': force_uN}}))
    assert error.step == number
    assert 'sum of forces and torques at waypoint 3 is' in str(error)


def test_a_finger_in_the_air_with_a_force_is_no_step(plan):
    """Files that state one are refused when the step is built, with code and reason."""
    number, step = next((i, s) for i, s in enumerate(plan.steps) if not all(s.in_contact))
    content = plan_to_dict(plan)
    content['steps'][number]['force_uN'][0][step.in_contact.index(False)] = [0.0, 0.1, 0.0]
    with pytest.raises(InvalidPlan, match='force_uN is not zero for a finger in the air') as error:
        plan_from_dict(content)
    assert error.value.code == ErrorCode.INVALID_PLAN


@pytest.mark.parametrize(('name', 'by'), [('grip_uN', 1.0), ('grip_uN', -1.0), ('margin_uN', 0.1)])
@pytest.mark.parametrize('kind', [StepKind.ROLL, StepKind.REMOVE])
def test_holds_that_are_not_those_of_the_forces_are_refused(plan, kind, name, by):
    """A step that claims another grip than it has, or more margin, is found."""
    number = numbers(plan, kind)[0]
    hold = plan.steps[number].hold
    hold = dataclasses.replace(hold, **{name: getattr(hold, name) + by})
    error = refused(with_steps(plan, {number: {'hold': hold}}))
    assert error.step == number
    assert f'hold: {name} is {getattr(hold, name):.4f} µN; allowed: ' in str(error)


def test_a_removal_of_a_finger_that_was_not_there_is_refused(plan):
    """The pull of a finger that did not touch before cannot be known."""
    step = plan.steps[numbers(plan, StepKind.REMOVE)[0]]
    error = refused(dataclasses.replace(plan, steps=(step,)))
    assert error.step == 0
    assert f'finger {step.finger} is not in contact before' in str(error)


# ---------------------------------------------------------------- without adhesion


def test_without_adhesion_fingers_that_do_not_press_are_refused(pressing):
    """Zero force is in balance and in every cone, but where nothing sticks it holds nothing."""
    roll = numbers(pressing, StepKind.ROLL)[0]
    changes = {
        number: {'force_uN': np.zeros_like(step.force_uN), 'hold': None}
        for number, step in enumerate(pressing.steps)
    }
    loose = with_steps(pressing, changes)
    error = refused(loose)
    assert error.step <= roll
    assert 'grip at waypoint ' in str(error)
    assert '0.0000 µN; allowed: at least 0.03 µN where nothing sticks' in str(error)


def test_adhesion_that_is_switched_off_is_noticed(plan):
    """A plan that relies on adhesion does not hold without it."""
    dry = dataclasses.replace(plan, law=dataclasses.replace(plan.law, adhesion=False))
    refused(dry)


def test_the_first_step_that_fails_is_the_one_that_is_named(plan):
    """Two spoiled steps: the earlier one is reported."""
    rolls = numbers(plan, StepKind.ROLL)
    changes = {}
    for number in rolls[:2]:
        force_uN = np.array(plan.steps[number].force_uN)
        force_uN[2, plan.steps[number].in_contact.index(True)] *= 0.5
        changes[number] = {'force_uN': force_uN}
    assert refused(with_steps(plan, changes)).step == rolls[0]


def test_an_edited_file_with_its_own_hash_is_still_refused(plan):
    """Who recomputes the hash after an edit gets past the file, but not past the check."""
    number = numbers(plan, StepKind.ROLL)[0]
    content = plan_to_dict(plan)
    for row, finger in itertools.product(content['steps'][number]['force_uN'], range(3)):
        row[finger] = [20.0 * value for value in row[finger]]
    with pytest.raises(InvalidPlan, match='plan_hash is'):
        plan_from_dict(content)
    force_uN = 20.0 * plan.steps[number].force_uN
    edited = with_steps(plan, {number: {'force_uN': force_uN}})
    content['plan_hash'] = plan_hash(edited)
    assert refused(plan_from_dict(content)).step == number
