# SPDX-License-Identifier: Apache-2.0
"""Plans as messages: nothing is lost on the way through metres and CDR, and errors are named."""

import dataclasses
import math

import numpy as np
import pytest
from microhand_msgs_py.msg import Plan as PlanMsg
from microhand_msgs_py.msg import PlanOptions, PlanStep
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import (
    BadRequest,
    InvalidNumber,
    InvalidParameter,
    InvalidPlan,
    InvalidRotation,
)
from microhand_planner.core.parameters import (
    ROBUST_RULES,
    ContactLaw,
    Finger,
    GripRules,
    Mode,
    SearchOptions,
    firmest_first,
)
from microhand_planner.core.plan_file import plan_hash
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.ros.conversions import (
    options_from_msg,
    options_to_msg,
    plan_from_msg,
    plan_to_msg,
    pose_from_msg,
    pose_to_msg,
    rules_from_msg,
)


@pytest.fixture(scope='module')
def plan():
    """Return a plan whose numbers are not round."""
    start = Pose((1.234567, -0.1, 7.7), (0.9, 0.1, -0.3, 0.2))
    goal = Pose.of(
        (2.1, 0.3, 7.7), start.rotation * Rotation.from_euler('ZYZ', [31, 77, -12], degrees=True)
    )
    return plan_reorientation(
        find_part('ellipsoid'),
        start,
        goal,
        Finger(4.37, 0.123),
        ContactLaw(0.31, 1.37, 29.9),
        SearchOptions(math.radians(17.3), time_limit_s=60.0),
        GripRules(0.83, 0.57, 0.0613, 4.7, 0.37),
    )


def through_the_wire(message):
    """Serialise a plan message and read it back."""
    return deserialize_message(serialize_message(message), PlanMsg)


def test_a_plan_keeps_its_hash_and_every_number(plan):
    """From µm to m, through CDR, and back: the plan is the same to the last picometre."""
    message = through_the_wire(plan_to_msg(plan))
    back = plan_from_msg(message)
    assert plan_hash(back) == plan_hash(plan) == message.plan_hash
    assert len(back.steps) == len(plan.steps)
    for ours, theirs in zip(back.steps, plan.steps, strict=True):
        for field in dataclasses.fields(ours):
            np.testing.assert_array_equal(getattr(ours, field.name), getattr(theirs, field.name))
    assert any(step.hold is not None for step in plan.steps)
    assert any(np.any(step.force_uN) for step in plan.steps)
    for name in ('finger', 'law', 'rules'):
        assert getattr(back, name) == getattr(plan, name)
    for ours, theirs in zip(back.rotations, plan.rotations, strict=True):
        assert dataclasses.astuple(ours)[1:] == pytest.approx(dataclasses.astuple(theirs)[1:])
        assert ours.axis == theirs.axis


def test_messages_are_in_si_and_quaternions_in_ros_order(plan):
    """Lengths are metres, forces newtons, angles radians, quaternions x y z w; no grip is NaN."""
    message = plan_to_msg(plan)
    assert message.options.finger_radius == pytest.approx(4.37e-6)
    assert message.options.pull_off_force == pytest.approx(1.37e-6)
    assert message.options.step == pytest.approx(math.radians(17.3))
    assert message.start_pose.position.x == pytest.approx(1.234567e-6, abs=1e-15)
    w, x, y, z = plan.start.quaternion_wxyz
    q = message.start_pose.orientation
    assert (q.x, q.y, q.z, q.w) == (x, y, z, w)
    tip = np.array(message.steps[0].tip_positions).reshape(-1, 3, 3)
    np.testing.assert_allclose(tip * 1e6, plan.steps[0].tip_um, rtol=1e-12)
    assert message.cost == pytest.approx(math.radians(plan.cost_deg))
    number, hold = plan.tightest
    sent = message.steps[number]
    force_N = np.array(sent.contact_forces).reshape(-1, 3, 3)
    np.testing.assert_allclose(force_N * 1e6, plan.steps[number].force_uN, rtol=1e-12)
    in_newton = [sent.grip, sent.grip_low, sent.grip_high, sent.margin]
    assert in_newton == pytest.approx(1e-6 * np.array(list(vars(hold).values())))
    assert math.isnan(message.steps[0].grip)
    assert message.options.least_margin == pytest.approx(6.13e-8)


def test_zero_in_options_means_the_default():
    """An empty options message plans with the paper's numbers."""
    assert options_from_msg(PlanOptions()) == (Finger(), ContactLaw(), SearchOptions())
    assert rules_from_msg(PlanOptions()) == ROBUST_RULES
    paper = SearchOptions(mode=Mode.PAPER)
    law = ContactLaw(adhesion=False)
    rules = GripRules(0.7, 0.5, 0.01, 2.5, 0.1)
    message = options_to_msg(Finger(), law, paper, rules)
    assert options_from_msg(message) == (Finger(), law, paper)
    assert rules_from_msg(message) == (rules,)
    by_default = options_to_msg(Finger(), law, paper, firmest_first(rules))
    assert rules_from_msg(by_default) == firmest_first(rules)


@pytest.mark.parametrize(
    ('changes', 'error'),
    [
        ({'friction': float('nan')}, InvalidNumber),
        ({'friction': -0.1}, InvalidParameter),
        ({'finger_radius': 1.0}, InvalidParameter),
        ({'time_limit': -1.0}, InvalidParameter),
        ({'mode': 7}, BadRequest),
    ],
)
def test_impossible_options_are_refused(changes, error):
    """NaN, negative, absurd: each has its error."""
    with pytest.raises(error):
        options_from_msg(PlanOptions(**changes))


@pytest.mark.parametrize(
    ('changes', 'error', 'field'),
    [
        ({'margin_factor': 1.01}, InvalidParameter, 'margin'),
        ({'margin_factor': -0.5}, InvalidParameter, 'margin'),
        ({'roll_factor': float('nan')}, InvalidNumber, 'roll-margin'),
        ({'least_margin': -1e-9}, InvalidParameter, 'least-margin'),
        ({'nominal_grip': 1.0}, InvalidParameter, 'grip'),
        ({'grip_tolerance': float('inf')}, InvalidNumber, 'grip-tolerance'),
    ],
)
def test_impossible_margins_are_refused(changes, error, field):
    """Shares above one, negative forces, NaN: the margin at fault is named."""
    with pytest.raises(error, match=f'^{field} is '):
        rules_from_msg(PlanOptions(**changes))


def test_poses_that_are_no_poses_are_refused():
    """A quaternion of zero length or with NaN, a position with NaN."""
    message = pose_to_msg(Pose())
    message.orientation.w = 0.0
    with pytest.raises(InvalidRotation):
        pose_from_msg(message)
    message.orientation.w = float('nan')
    with pytest.raises(InvalidRotation):
        pose_from_msg(message)
    message = pose_to_msg(Pose())
    message.position.y = float('inf')
    with pytest.raises(InvalidNumber):
        pose_from_msg(message)


def test_a_changed_plan_does_not_fit_its_hash(plan):
    """One tip moved by a nanometre, and the plan is refused; without a hash it is read."""
    message = plan_to_msg(plan)
    message.steps[1].tip_positions[3] += 1e-9
    with pytest.raises(InvalidPlan, match='plan_hash is '):
        plan_from_msg(message)
    message.plan_hash = ''
    assert plan_hash(plan_from_msg(message)) != plan_hash(plan)


@pytest.mark.parametrize(
    ('spoil', 'text'),
    [
        (lambda step: setattr(step, 'kind', 99), 'step 1: kind is 99; allowed: 0 to'),
        (lambda step: step.tip_positions.append(0.0), 'step 1: tip_positions is of length'),
        (lambda step: step.object_positions.pop(), 'step 1: object_positions is of length'),
        (lambda step: step.tip_positions.__setitem__(0, math.nan), 'tip_um is not finite'),
        (lambda step: step.contact_forces.pop(), 'step 1: contact_forces is of length'),
        (lambda step: step.contact_forces.__setitem__(0, math.nan), 'force_uN is not finite'),
        (lambda step: setattr(step, 'grip', 1e-6), 'hold: low_uN is nan'),
    ],
)
def test_malformed_steps_are_named(plan, spoil, text):
    """Wrong kinds, lengths and numbers end in one sentence, not in an exception of numpy."""
    message = plan_to_msg(plan)
    spoil(message.steps[1])
    with pytest.raises(InvalidPlan, match=text):
        plan_from_msg(message)


def test_another_format_is_refused(plan):
    """A plan of another major version is not guessed at, nor one of none."""
    message = plan_to_msg(plan)
    for version in ('1.0', '3.0'):
        message.format_version = version
        with pytest.raises(InvalidPlan, match=rf"format_version is '{version}'; allowed: 2\.x"):
            plan_from_msg(message)
    with pytest.raises(InvalidPlan, match='format_version'):
        plan_from_msg(PlanMsg())


def test_kinds_of_steps_are_those_of_the_message(plan):
    """Every kind that a plan has is written as the constant of the same name."""
    message = plan_to_msg(plan)
    for step, sent in zip(plan.steps, message.steps, strict=True):
        assert getattr(PlanStep, step.kind.name) == sent.kind
