# SPDX-License-Identifier: Apache-2.0
"""Checking plans: what the planner makes passes, and every way to spoil a plan is found."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import InvalidPlan
from microhand_planner.core.parameters import ContactLaw, Finger, Mode, SearchOptions
from microhand_planner.core.plan import StepKind
from microhand_planner.core.plan_check import InvalidStep, check_plan
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose

START = Pose((3.0, -2.0, 1.0), (0.9, 0.1, -0.3, 0.2))
TURN = Rotation.from_euler('ZYZ', [40.0, 110.0, 30.0], degrees=True)
GOAL = Pose.of((6.0, -2.0, -1.0), START.rotation * TURN)


@pytest.fixture(scope='module')
def plan():
    """Return a plan with rolls, regrasps and a translation."""
    return plan_reorientation(
        find_part('ellipsoid'), START, GOAL, Finger(), ContactLaw(), SearchOptions()
    )


def first(plan, kind):
    """Return the index of the first step of a kind."""
    return next(i for i, step in enumerate(plan.steps) if step.kind is kind)


def spoiled(plan, number, **changes):
    """Return a plan with other values in one step."""
    steps = list(plan.steps)
    steps[number] = dataclasses.replace(steps[number], **changes)
    return dataclasses.replace(plan, steps=tuple(steps))


def moved(array, where, by):
    """Return a copy of an array with something added at one place."""
    copy = np.array(array)
    copy[where] += by
    return copy


def test_plans_of_the_planner_pass(plan):
    """What the search makes is accepted by a check that knows nothing of the search."""
    kinds = {step.kind for step in plan.steps}
    assert kinds == set(StepKind)
    check_plan(plan)


@pytest.mark.parametrize('name', ['convex', 'concave'])
def test_plans_for_meshes_of_other_shapes_pass(name):
    """Rolling without slip is found for hollows and corners as well."""
    goal = Pose.of((0, 0, 0), Rotation.from_euler('ZYZ', [20.0, 60.0, -40.0], degrees=True))
    check_plan(
        plan_reorientation(find_part(name), Pose(), goal, Finger(), ContactLaw(), SearchOptions())
    )


def test_a_tip_of_another_radius_slips(plan):
    """The same motions with a radius that is 1 % smaller do not roll."""
    smaller = dataclasses.replace(plan, finger=Finger(plan.finger.radius_um * 0.99))
    with pytest.raises(InvalidStep, match='slip of finger'):
        check_plan(smaller)


def test_a_nudge_of_a_rolling_tip_is_found(plan):
    """One waypoint of one rolling finger, 20 nm off, is named with step, finger and waypoint."""
    number = first(plan, StepKind.ROLL)
    step = plan.steps[number]
    finger = step.in_contact.index(True)
    tip = moved(step.tip_um, (4, finger), [0.0, 0.0, 0.02])
    with pytest.raises(InvalidStep) as error:
        check_plan(spoiled(plan, number, tip_um=tip))
    assert error.value.step == number
    assert f'step {number} (roll): slip of finger {finger + 1} at waypoint 4 is 0.02' in str(
        error.value
    )


def test_a_gap_between_steps_is_found(plan):
    """A step that begins 5 nm beside the end of the one before it is named."""
    number = first(plan, StepKind.REMOVE)
    step = plan.steps[number]
    with pytest.raises(InvalidStep, match=r'jump of a tip is 0\.0050 µm') as error:
        check_plan(
            spoiled(plan, number, tip_um=moved(step.tip_um, (0, step.finger - 1, 0), 0.005))
        )
    assert error.value.step == number


def test_an_object_that_moves_by_itself_is_found(plan):
    """In a step that places a finger the object must not move or turn."""
    number = first(plan, StepKind.PLACE)
    step = plan.steps[number]
    with pytest.raises(InvalidStep, match=r'motion of the object is 1\.0000 µm; allowed: 0 µm'):
        check_plan(
            spoiled(plan, number, object_position_um=moved(step.object_position_um, (1, 0), 1.0))
        )
    turned = np.array(step.object_quaternion_wxyz)
    turned[1] = (
        Rotation.from_quat(turned[1][[1, 2, 3, 0]]) * Rotation.from_rotvec([0, 0, 0.01])
    ).as_quat()[[3, 0, 1, 2]]
    with pytest.raises(InvalidStep, match=r'turn of the object is 0\.5730°; allowed: 0°'):
        check_plan(spoiled(plan, number, object_quaternion_wxyz=turned))


def test_a_finger_that_holds_must_stand_still(plan):
    """While one finger is placed, the ones that hold the object do not move."""
    number = first(plan, StepKind.PLACE)
    step = plan.steps[number]
    holding = step.in_contact.index(True)
    tip = moved(step.tip_um, (1, holding), [0.02, 0, 0])
    with pytest.raises(InvalidStep, match=f'motion of finger {holding + 1} in contact is 0.0200'):
        check_plan(spoiled(plan, number, tip_um=tip))


def test_overlapping_tips_are_found_between_waypoints(plan):
    """Two tips that pass through each other between two waypoints are named."""
    number = first(plan, StepKind.APPROACH)
    step = plan.steps[number]
    tip = np.array(step.tip_um[:2])
    tip[0], tip[1] = step.tip_um[0], step.tip_um[0]
    tip[0, 0], tip[1, 0] = tip[0, 1] + [20.0, 0, 0], tip[0, 1] - [20.0, 0, 0]
    alone = dataclasses.replace(
        plan,
        steps=(
            dataclasses.replace(
                step,
                tip_um=tip,
                object_position_um=step.object_position_um[:2],
                object_quaternion_wxyz=step.object_quaternion_wxyz[:2],
                normal=step.normal[:2],
                force_uN=step.force_uN[:2],
            ),
        ),
    )
    with pytest.raises(InvalidStep, match=r'distance of fingers 1 and 2 is 0\.0000 µm; .* >= 9'):
        check_plan(alone)


def test_fingers_come_and_go_by_their_own_steps_only(plan):
    """A contact that appears without a placement, or ends without a removal, is found."""
    place, remove = first(plan, StepKind.PLACE), first(plan, StepKind.REMOVE)
    without_place = dataclasses.replace(plan, steps=plan.steps[:place] + plan.steps[place + 1 :])
    with pytest.raises(InvalidStep):
        check_plan(without_place)
    relabelled = spoiled(plan, place, finger=plan.steps[place].finger % 3 + 1)
    with pytest.raises(InvalidStep, match='in contact; allowed: only after it was placed'):
        check_plan(relabelled)
    relabelled = spoiled(plan, remove, finger=plan.steps[remove].finger % 3 + 1)
    with pytest.raises(InvalidStep, match='not in contact; allowed: only by removing it'):
        check_plan(relabelled)


def test_the_angle_of_a_roll_is_compared_with_its_waypoints(plan):
    """A roll that states another angle than its object turns is found."""
    number = first(plan, StepKind.ROLL)
    wrong = plan.steps[number].angle_rad + math.radians(1.0)
    with pytest.raises(InvalidStep, match=r'\(roll\): turn of the object is'):
        check_plan(spoiled(plan, number, angle_rad=wrong))


def test_start_and_goal_are_compared_with_the_steps(plan):
    """A plan must begin at its start pose and, except in paper mode, end at its goal pose."""
    with pytest.raises(InvalidPlan, match=r'start pose is .*allowed: the same pose'):
        check_plan(dataclasses.replace(plan, start=Pose()))
    other = dataclasses.replace(plan, goal=Pose())
    with pytest.raises(InvalidPlan, match='goal pose'):
        check_plan(other)
    check_plan(dataclasses.replace(other, options=SearchOptions(mode=Mode.PAPER)))


def test_an_empty_plan_is_refused(plan):
    """A plan without steps holds nothing."""
    with pytest.raises(InvalidPlan, match='steps is empty'):
        check_plan(dataclasses.replace(plan, steps=()))
