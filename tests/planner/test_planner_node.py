# SPDX-License-Identifier: Apache-2.0
"""The planner node in a context of its own: it plans, refuses in one sentence, and stays up."""

import math
import threading
from pathlib import Path

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Point, Quaternion
from microhand_msgs_py.msg import ErrorCode, PlanOptions
from microhand_msgs_py.srv import ListObjects, PlanRotation, ValidatePlan
from rclpy.executors import SingleThreadedExecutor
from scipy.spatial.transform import Rotation

from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose, angle_between_rad
from microhand_planner.ros import planner_node
from microhand_planner.ros.conversions import pose_from_msg, pose_to_msg
from microhand_planner.ros.planner_node import PlannerNode

DEADLINE_S = 30.0


@pytest.fixture(scope='module')
def ask(ros_domain):
    """Return a function that calls a service of a planner node and waits for the answer."""
    context = rclpy.Context()
    rclpy.init(context=context)
    planner = PlannerNode(context=context)
    client_node = rclpy.create_node('asker', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(planner)
    executor.add_node(client_node)
    stopping = threading.Event()

    def spin():
        while not stopping.is_set():
            executor.spin_once(timeout_sec=0.05)

    spinner = threading.Thread(target=spin)
    spinner.start()
    clients = {
        kind: client_node.create_client(kind, f'planner/{name}')
        for kind, name in (
            (PlanRotation, 'plan_rotation'),
            (ValidatePlan, 'validate_plan'),
            (ListObjects, 'list_objects'),
        )
    }

    def call(request):
        client = clients[next(kind for kind in clients if isinstance(request, kind.Request))]
        assert client.wait_for_service(DEADLINE_S)
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        assert answered.wait(DEADLINE_S), 'no answer'
        return future.result()

    yield call
    stopping.set()
    spinner.join()
    executor.shutdown()
    planner.destroy_node()
    client_node.destroy_node()
    rclpy.shutdown(context=context)


def turn(a, b, c, **fields):
    """Return the request to turn the ellipsoid by Rz(a) Ry(b) Rz(c), degrees."""
    rotation = Rotation.from_euler('ZYZ', [a, b, c], degrees=True)
    request = PlanRotation.Request(object='ellipsoid', **fields)
    request.goal_pose = pose_to_msg(Pose.of((0.0, 0.0, 0.0), rotation))
    return request


def test_a_plan_reaches_its_goal_and_passes_the_check(ask):
    """The last pose of the plan is the goal asked for, and validate_plan accepts the plan."""
    request = turn(80, 220, 100)
    answer = ask(request)
    assert (answer.error_code, answer.error_msg) == (ErrorCode.SUCCESS, '')
    last = answer.plan.steps[-1]
    x, y, z, w = last.object_orientations[-4:]
    goal = pose_from_msg(request.goal_pose).rotation
    assert angle_between_rad(Rotation.from_quat([x, y, z, w]), goal) < 1e-6
    assert answer.goal_error < 1e-6
    assert answer.planning_time > 0.0
    assert answer.plan.header.frame_id == 'station'
    assert answer.plan.options.friction == 0.3
    verdict = ask(ValidatePlan.Request(plan=answer.plan))
    assert (verdict.error_code, verdict.error_msg, verdict.step) == (0, '', -1)


def test_a_plan_continues_from_the_fingers_that_hold_the_object(ask):
    """With start_tips, the plan begins where the last one ended, with the same fingers."""
    first = ask(turn(0, 60, 0)).plan
    last = first.steps[-1]
    tips = np.reshape(last.tip_positions[-9:], (3, 3))
    tips[~np.array(last.in_contact)] = np.nan
    request = turn(40, 90, 10, start_pose=first.goal_pose)
    request.start_tips = [Point(x=x, y=y, z=z) for x, y, z in tips.tolist()]
    answer = ask(request)
    assert (answer.error_code, answer.error_msg) == (ErrorCode.SUCCESS, '')
    begin = answer.plan.steps[0]
    assert list(begin.in_contact) == list(last.in_contact)
    np.testing.assert_allclose(
        np.reshape(begin.tip_positions[:9], (3, 3))[np.array(last.in_contact)],
        tips[np.array(last.in_contact)],
        atol=1e-12,
    )
    verdict = ask(ValidatePlan.Request(plan=answer.plan))
    assert (verdict.error_code, verdict.error_msg) == (0, '')

    request.start_tips = request.start_tips[:2]
    assert ask(request).error_code == ErrorCode.BAD_REQUEST
    request.start_tips = [Point(x=1e-3), Point(x=-1e-3), Point(x=math.nan)]
    assert ask(request).error_code == ErrorCode.INADMISSIBLE_CONTACT


def test_equal_requests_give_equal_plans(ask):
    """Asked twice, the planner gives the same hash and the same steps."""
    first, second = ask(turn(0, 90, 0)), ask(turn(0, 90, 0))
    assert first.plan.plan_hash == second.plan.plan_hash
    assert len(first.plan.steps) == len(second.plan.steps)
    for ours, theirs in zip(first.plan.steps, second.plan.steps, strict=True):
        for field in ours.get_fields_and_field_types():
            np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))


def test_a_spoiled_plan_is_refused_with_its_step(ask):
    """validate_plan names the step at fault, by number and in words."""
    plan = ask(turn(0, 0, 60)).plan
    roll = next(i for i, step in enumerate(plan.steps) if step.kind == step.ROLL)
    plan.steps[roll].tip_positions[12] += 1e-7
    plan.plan_hash = ''
    verdict = ask(ValidatePlan.Request(plan=plan))
    assert verdict.error_code == ErrorCode.INVALID_PLAN
    assert verdict.step == roll
    assert f'step {roll} (roll)' in verdict.error_msg


def test_spoiled_forces_are_refused_with_their_step(ask):
    """A grip that is too firm, and a finger in the air that presses: code, step and reason."""
    plan = ask(turn(0, 0, 60)).plan
    plan.plan_hash = ''
    roll = next(i for i, step in enumerate(plan.steps) if step.kind == step.ROLL)
    step = plan.steps[roll]
    assert step.margin > 0.0
    planned = list(step.contact_forces)
    step.contact_forces = [*planned[:9], *(20.0 * force for force in planned[9:])]
    verdict = ask(ValidatePlan.Request(plan=plan))
    assert (verdict.error_code, verdict.step) == (ErrorCode.INVALID_PLAN, roll)
    assert 'outside what contacts bear' in verdict.error_msg
    free = list(step.in_contact).index(False)
    step.contact_forces = planned
    step.contact_forces[3 * free] = 1e-7
    verdict = ask(ValidatePlan.Request(plan=plan))
    assert verdict.error_code == ErrorCode.INVALID_PLAN
    assert 'force_uN is not zero for a finger in the air' in verdict.error_msg


def test_margins_of_a_request_are_kept_and_bounded(ask):
    """A plan carries the margins that it was asked for; impossible ones have no plan."""
    request = turn(40, 110, 30)
    request.object = 'convex'
    request.options = PlanOptions(margin_factor=0.6, least_margin=6e-8)
    answer = ask(request)
    assert answer.error_code == ErrorCode.SUCCESS
    assert answer.plan.options.margin_factor == 0.6
    removals = [step for step in answer.plan.steps if step.kind == step.REMOVE]
    assert removals
    assert min(step.margin for step in removals) >= 6e-8 - 1e-12
    request.options.margin_factor = 0.1
    assert ask(request).error_code == ErrorCode.NO_PLAN_EXISTS
    request.options.margin_factor = 1.5
    answer = ask(request)
    assert answer.error_code == ErrorCode.INVALID_PARAMETER
    assert 'margin is 1.5' in answer.error_msg


BAD = [
    ({'object': 'no_such_thing'}, ErrorCode.UNKNOWN_OBJECT, 'ellipsoid'),
    ({'goal': Quaternion(w=math.nan)}, ErrorCode.INVALID_ROTATION, 'quaternion'),
    ({'goal': Quaternion(w=0.0)}, ErrorCode.INVALID_ROTATION, 'quaternion'),
    ({'options': PlanOptions(friction=math.nan)}, ErrorCode.INVALID_NUMBER, 'friction'),
    ({'options': PlanOptions(step=math.radians(500))}, ErrorCode.INVALID_PARAMETER, 'step-deg'),
    ({'unit': -1.0}, ErrorCode.INVALID_PARAMETER, 'unit'),
]


@pytest.mark.parametrize(('fields', 'code', 'word'), BAD)
def test_bad_requests_are_answered_and_the_node_stays_up(ask, fields, code, word):
    """Each mistake has its code and names its field; the next request is served."""
    request = turn(0, 0, 40)
    for name, value in fields.items():
        if name == 'goal':
            request.goal_pose.orientation = value
        else:
            setattr(request, name, value)
    answer = ask(request)
    assert answer.error_code == code
    assert word in answer.error_msg
    assert '\n' not in answer.error_msg
    assert math.isnan(answer.goal_error)
    assert not answer.plan.steps
    assert ask(turn(0, 0, 20)).error_code == ErrorCode.SUCCESS


def test_a_mesh_that_is_not_closed_is_refused(ask, tmp_path):
    """A mesh with a hole bounds no solid."""
    path = tmp_path / 'open.obj'
    corners = '\n'.join(
        f'v {9 * x} {9 * y} {9 * z}' for x in (0, 1) for y in (0, 1) for z in (0, 1)
    )
    path.write_text(f'{corners}\nf 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\n')
    request = turn(0, 0, 40)
    request.object = str(path)
    answer = ask(request)
    assert answer.error_code == ErrorCode.INVALID_MESH
    assert 'watertight' in answer.error_msg


def test_the_catalogue_is_listed_with_sizes_in_metres(ask):
    """The ellipsoid is there, 32.4 x 23.2 x 23.2 µm large, with a mesh file that exists."""
    answer = ask(ListObjects.Request())
    assert answer.error_code == ErrorCode.SUCCESS
    objects = {entry.name: entry for entry in answer.objects}
    assert {'ellipsoid', 'convex', 'concave'} <= objects.keys()
    ellipsoid = objects['ellipsoid']
    size = ellipsoid.size
    assert [size.x, size.y, size.z] == pytest.approx([32.4e-6, 23.2e-6, 23.2e-6], rel=0.02)
    assert Path(ellipsoid.mesh_file).is_file()
    assert len(ellipsoid.object_hash) == 64


def test_short_requests_are_answered_during_a_long_one(ask, monkeypatch):
    """While a search runs, the catalogue is listed: the node never waits for the search."""
    searching, listed = threading.Event(), threading.Event()

    def search(*args, **kwargs):
        searching.set()
        assert listed.wait(DEADLINE_S)
        return plan_reorientation(*args, **kwargs)

    monkeypatch.setattr(planner_node, 'plan_reorientation', search)
    answers = []
    thread = threading.Thread(target=lambda: answers.append(ask(turn(0, 0, 40))))
    thread.start()
    assert searching.wait(DEADLINE_S)
    assert ask(ListObjects.Request()).error_code == ErrorCode.SUCCESS
    listed.set()
    thread.join(DEADLINE_S)
    assert answers[0].error_code == ErrorCode.SUCCESS
