# SPDX-License-Identifier: Apache-2.0
"""The twin as a process of its own; the test plays the stages, and so turns the clock."""

import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from microhand_msgs_py.msg import ErrorCode, ObjectState, StageState, TipContact
from microhand_msgs_py.srv import Command, LoadObject
from rclpy.executors import SingleThreadedExecutor
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker, MarkerArray

from microhand_node.qos import CONTACT, LATCHED, STATE
from microhand_planner.core.catalogue import find_part
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.section_curves import section_curves
from microhand_planner.ros.conversions import plan_to_msg, point_from_um, um_from_point
from microhand_station.service_call import call, greet

DEADLINE_S = 20.0
BASE_UM = np.array([-100.0, -100.0, -100.0])
STEP_S = 0.01


class Stages:
    """Three stages that are where they are told to be, and what the twin says about it."""

    def __init__(self, namespace):
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node('stages', namespace=namespace, context=self.context)
        self.contacts = {1: [], 2: [], 3: []}
        self.objects, self.markers = [], []
        self._changed = threading.Condition()
        self._states = []
        for finger in (1, 2, 3):
            name = f'finger_{finger}'
            self._states.append(self.node.create_publisher(StageState, f'{name}/state', STATE))
            self._listen(TipContact, f'{name}/contact', CONTACT, self.contacts[finger])
        self._listen(ObjectState, 'object_state', STATE, self.objects)
        self._listen(MarkerArray, 'twin/markers', STATE, self.markers)
        self._listen(MarkerArray, 'twin/object_marker', LATCHED, self.markers)
        self._clients = {
            'load': self.node.create_client(LoadObject, 'twin/load'),
            'release': self.node.create_client(Command, 'twin/release'),
        }
        self.time_ns = time.time_ns()
        self.stopping = threading.Event()
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.spinner = threading.Thread(target=self._spin)
        self.spinner.start()

    def _spin(self):
        while not self.stopping.is_set():
            self.executor.spin_once(timeout_sec=0.05)

    def _listen(self, kind, topic, qos, kept):
        def keep(message):
            with self._changed:
                kept.append(message)
                self._changed.notify_all()

        self.node.create_subscription(kind, topic, keep, qos)

    def wait(self, condition):
        """Return when a condition holds; fail after the deadline."""
        with self._changed:
            assert self._changed.wait_for(condition, DEADLINE_S), 'waited in vain'

    def meet(self):
        """Return when the twin listens to the stages and answers."""
        greet(self.node, 'twin', deadline_s=DEADLINE_S, who='twin', missing_code=900)
        give_up_s = time.monotonic() + DEADLINE_S
        while any(publisher.get_subscription_count() == 0 for publisher in self._states):
            assert time.monotonic() < give_up_s, 'the twin does not listen'
            time.sleep(0.01)

    def go(self, tips_um, duration_s=STEP_S):
        """Stand at tips (3, 3) for a while, and return when the twin has reported since."""
        for _ in range(max(1, round(duration_s / STEP_S))):
            self.time_ns += round(STEP_S * 1e9)
            stamp = Time(sec=self.time_ns // 10**9, nanosec=self.time_ns % 10**9)
            for publisher, tip_um in zip(self._states, tips_um, strict=True):
                state = StageState(position=point_from_um(np.asarray(tip_um) - BASE_UM))
                state.header.stamp = stamp
                publisher.publish(state)
        # contacts are reported at least every 50 ms of the stages' time
        before_ns = self.time_ns - 60_000_000
        self.wait(
            lambda: all(
                seen and stamp_ns(seen[-1]) >= before_ns for seen in self.contacts.values()
            )
        )

    def lead(self, from_um, to_um, duration_s):
        """Go evenly from tips to tips, and stand there until all has been reported."""
        count = round(duration_s / STEP_S)
        for share in np.arange(1, count + 1) / count:
            self.go(from_um + share * (to_um - from_um))
        self.go(to_um, 0.1)

    def load(self, plan, name='ellipsoid'):
        """Have the object of a plan loaded."""
        return self.ask('load', LoadObject.Request(plan=plan, object=name))

    def ask(self, name, request):
        """Ask the twin."""
        client = self._clients[name]
        return call(client, request, deadline_s=DEADLINE_S, who='twin', missing_code=900)

    def close(self):
        """Leave the graph."""
        self.stopping.set()
        self.spinner.join()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def stamp_ns(message):
    """Return the time to which a message refers [ns]."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def start(namespace, *arguments):
    """Start a twin."""
    return subprocess.Popen(
        [
            *(sys.executable, '-m', 'microhand_twin.ros.twin_node'),
            *('--ros-args', '-r', f'__ns:=/{namespace}', *arguments),
        ],
        env=dict(os.environ, RCUTILS_LOGGING_USE_STDOUT='1'),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope='module')
def stages(ros_domain):
    """Start a twin, and stages that it listens to."""
    process = start('lab', '-p', 'display_rate:=100')
    stages = Stages('lab')
    try:
        stages.meet()
        yield stages
    finally:
        stages.close()
        process.terminate()
        _, complaints = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, complaints) == (0, '')


@pytest.fixture(scope='module')
def plan():
    """Return a plan for the ellipsoid: two fingers, one roll."""
    finger = Finger(clearance_um=0.5)
    goal = Pose.of((0, 0, 0), Rotation.from_euler('ZYZ', [0, 30, 0], degrees=True))
    curves = section_curves(find_part('ellipsoid'), finger)
    return plan_reorientation(curves, Pose(), goal, finger, ContactLaw(), SearchOptions())


def grasp_of(plan):
    """Return tips (3, 3) away from the object, and touching it, as the plan begins."""
    return plan.steps[0].tip_um[0], plan.steps[0].tip_um[-1]


def test_a_run_as_the_twin_sees_it(stages, plan):
    """Fixed, touched, released, carried along, dropped: contacts and state say so, in SI units."""
    away, touching = grasp_of(plan)
    touched = [finger for finger in range(3) if plan.steps[1].in_contact[finger]]
    inward = np.where(np.isin(range(3), touched)[:, None], plan.steps[1].force_uN[-1] / 20.0, 0.0)
    stages.go(away, 0.1)
    assert not any(seen[-1].in_contact for seen in stages.contacts.values())
    assert stages.load(plan_to_msg(plan)).error_msg == ''
    stages.go(away, 0.1)
    stages.wait(lambda: stages.objects)
    state = stages.objects[-1]
    assert (state.held, state.released, state.lost_because) == (True, False, '')
    assert state.header.frame_id == 'station'

    refused = stages.ask('release', Command.Request())
    assert refused.error_code == ErrorCode.NOT_ALLOWED
    assert 'no finger touches the object' in refused.error_msg

    begun = {finger: len(seen) for finger, seen in stages.contacts.items()}
    stages.lead(away, touching + inward, 0.5)
    for finger in (1, 2, 3):
        news = stages.contacts[finger][begun[finger] :]
        assert any(contact.in_contact for contact in news) == (finger - 1 in touched)
    assert stages.ask('release', Command.Request()).error_msg == ''

    carried_um = np.array([1.0, -0.5, 0.8])
    stages.lead(touching + inward, touching + inward + carried_um, 0.5)
    stages.wait(lambda: stamp_ns(stages.objects[-1]) > stages.time_ns - 30_000_000)
    state = stages.objects[-1]
    assert (state.held, state.released) == (True, True)
    np.testing.assert_allclose(um_from_point(state.pose.position), carried_um, atol=0.03)
    for contact in state.contacts:
        assert contact.in_contact == (contact.finger - 1 in touched)
        if contact.in_contact:
            grip_uN = 20.0 * np.linalg.norm(inward[contact.finger - 1])
            assert 1e6 * contact.normal_force == pytest.approx(grip_uN, rel=0.05)
            centre_um = touching[contact.finger - 1] + carried_um
            off_um = np.linalg.norm(um_from_point(contact.position) - centre_um)
            assert off_um == pytest.approx(4.5, abs=0.02)

    apart = touching + carried_um
    apart[touched[0]] += 5.0 * (touching[touched[0]] / np.linalg.norm(touching[touched[0]]))
    stages.lead(touching + inward + carried_um, apart, 0.3)
    stages.wait(lambda: not stages.objects[-1].held)
    assert stages.objects[-1].lost_because
    stages.go(apart, 0.2)
    assert not any(state.held for state in stages.objects[-3:])


def test_the_stamp_of_a_contact_is_that_of_the_position_it_refers_to(stages, plan):
    """The first report of a touch carries the time at which the stage was where it touches."""
    away, touching = grasp_of(plan)
    touched = next(finger for finger in range(3) if plan.steps[1].in_contact[finger])
    stages.go(away, 0.1)
    assert stages.load(plan_to_msg(plan)).error_msg == ''
    stages.go(away, 0.1)
    begun, begin_ns = len(stages.contacts[touched + 1]), stages.time_ns
    stages.lead(away, touching, 1.0)
    news = stages.contacts[touched + 1][begun:]
    touch_ns = next(stamp_ns(contact) for contact in news if contact.in_contact)
    way_um = np.linalg.norm(touching[touched] - away[touched])
    at_um = way_um * (touch_ns - begin_ns) / 1e9
    # a tip feels the surface 5 nm before it, and the way is covered in steps of 10 ms
    assert way_um - 0.005 - 1e-6 <= at_um + way_um * STEP_S
    assert at_um <= way_um + 1e-6


def test_what_cannot_be_loaded_is_refused_with_code_and_reason(stages, plan):
    """Another object, an unknown one, NaN as unit: nothing changes."""
    stages.go(grasp_of(plan)[0], 0.1)
    message = plan_to_msg(plan)
    wrong = stages.load(message, 'convex')
    assert wrong.error_code == ErrorCode.INVALID_PLAN
    assert 'for convex' in wrong.error_msg
    assert stages.load(message, 'no_such_thing').error_code == ErrorCode.UNKNOWN_OBJECT
    request = LoadObject.Request(plan=message, object='ellipsoid', unit=float('nan'))
    assert stages.ask('load', request).error_code == ErrorCode.INVALID_NUMBER
    assert stages.load(message, '').error_msg == ''


def test_markers_show_tips_and_object_large_enough_for_rviz(stages, plan):
    """Spheres of the tips and the mesh of the object, ten thousand times as large."""
    away, _ = grasp_of(plan)
    stages.go(away, 0.1)
    stages.markers.clear()
    assert stages.load(plan_to_msg(plan)).error_msg == ''
    stages.go(away, 0.2)
    stages.wait(lambda: {'tips', 'object'} <= {m.ns for a in stages.markers for m in a.markers})
    markers = [marker for array in stages.markers for marker in array.markers]
    tips = [marker for marker in markers if marker.ns == 'tips' and marker.id == 2]
    np.testing.assert_allclose(tips[-1].scale.x, 9e-6 * 1e4)
    at_m = tips[-1].pose.position
    np.testing.assert_allclose(np.array([at_m.x, at_m.y, at_m.z]), away[1] * 1e-2, atol=1e-6)
    mesh = next(marker for marker in markers if marker.ns == 'object')
    corners_m = np.array([[p.x, p.y, p.z] for p in mesh.points])
    np.testing.assert_allclose(np.ptp(corners_m, axis=0), [0.324, 0.232, 0.232], rtol=1e-6)
    assert (mesh.type, mesh.frame_locked) == (Marker.TRIANGLE_LIST, True)


def test_a_parameter_out_of_range_ends_the_start_in_one_line(ros_domain):
    """Exit status 2, and what is allowed."""
    process = start('wrong', '-p', 'finger_2.stiffness:=0')
    _, complaints = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 2
    assert 'finger_2.stiffness is 0; allowed: a number from 0.1 to 10000 N/m' in complaints
    assert len(complaints.splitlines()) == 1


def test_without_stages_nothing_can_be_loaded(ros_domain, plan):
    """STAGE_MISSING names the fingers of which nothing was heard."""
    process = start('alone')
    stages = Stages('alone')
    try:
        stages.meet()
        answer = stages.load(plan_to_msg(plan))
        assert answer.error_code == ErrorCode.STAGE_MISSING
        assert answer.error_msg == 'finger 1, 2, 3: nothing heard of its stage'
    finally:
        stages.close()
        process.terminate()
        process.communicate(timeout=DEADLINE_S)
