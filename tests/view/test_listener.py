# SPDX-License-Identifier: Apache-2.0
"""Messages in SI units → what is known of the station, in µm and µN."""

import math
import threading
import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from microhand_msgs_py.msg import (
    ContactForce,
    ErrorCode,
    ObjectDeviation,
    ObjectState,
    RunEvent,
    SequencerState,
    StageState,
)
from rclpy.executors import SingleThreadedExecutor

from microhand_node.qos import EVENTS, LATCHED, STATE
from microhand_planner.ros.conversions import plan_to_msg
from microhand_station.client import StationClient
from microhand_station.config import FingerConfig, StationConfig
from microhand_station.sequencer.stage_watch import Mode
from microhand_station.sequencer.states import State
from microhand_station.view.listener import SILENCE_S, Listener

DEADLINE_S = 20.0
PERIOD_S = 0.02
CONFIG = StationConfig(
    fingers=(
        FingerConfig(base_um=(-100.0, -90.0, -80.0), stiffness_n_per_m=10.0),
        FingerConfig(stiffness_n_per_m=20.0),
        FingerConfig(stiffness_n_per_m=40.0),
    )
)


class Clock:
    """A steady clock that can be put forward."""

    def __init__(self):
        self.ahead_s = 0.0

    def __call__(self):
        """Return the time [s]."""
        return time.monotonic() + self.ahead_s


class Station:
    """Says what it is told to say, again and again, on the topics of a station."""

    def __init__(self, namespace):
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node('stand_in', namespace=namespace, context=self.context)
        self.publishers, self.said = {}, {}
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.node.create_timer(PERIOD_S, self.repeat)
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self.spin)
        self.thread.start()

    def say(self, topic, message, qos):
        """Publish a message, and go on publishing it."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(type(message), topic, qos)
        self.said[topic] = message
        if qos is not STATE:
            self.publishers[topic].publish(self.said.pop(topic))

    def repeat(self):
        """Publish all that was said."""
        for topic, message in list(self.said.items()):
            self.publishers[topic].publish(message)

    def spin(self):
        """Spin until the end."""
        while not self.stopping.is_set():
            self.executor.spin_once(timeout_sec=0.05)

    def close(self):
        """End."""
        self.stopping.set()
        self.thread.join()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def station(ros_domain):
    """Return a station that says what it is told."""
    station = Station('heard')
    yield station
    station.close()


@pytest.fixture
def clock():
    """Return a clock for the listener."""
    return Clock()


@pytest.fixture
def listener(ros_domain, clock):
    """Return a listener to that station."""
    with StationClient('heard', name='view', pace_s=0.001) as client:
        yield Listener(client.node, CONFIG, clock)


def wait_for(listener, condition):
    """Return the first snapshot that meets a condition; fail after the deadline."""
    give_up_s = time.monotonic() + DEADLINE_S
    while not condition(snapshot := listener.snapshot()):
        assert time.monotonic() < give_up_s, snapshot
        threading.Event().wait(PERIOD_S)
    return snapshot


def stage_state(**changes):
    """Return the state of a stage that is 30 nm behind its command."""
    return StageState(
        mode=StageState.STREAMING,
        position=Point(x=110e-6, y=20e-6, z=30e-6),
        command=Point(x=110.03e-6, y=20e-6, z=30e-6),
        **changes,
    )


def test_stages_are_in_the_station_frame_and_silence_is_noticed(station, clock, listener):
    """Base plus position, in µm; a stage that says nothing for a second is not shown."""
    state = stage_state(error_code=ErrorCode.STAGE_FAULT, error_msg='too hot')
    station.say('finger_1/state', state, STATE)
    first, second, third = wait_for(listener, lambda s: s.stages[0]).stages
    np.testing.assert_allclose(first.tip_um, [10.0, -70.0, -50.0], atol=1e-9)
    assert first.lag_um == pytest.approx(0.03, abs=1e-9)
    assert (first.mode, first.on_target, first.error) == (Mode.STREAMING, False, 'too hot')
    assert (second, third) == (None, None)
    station.said.clear()
    clock.ahead_s = SILENCE_S + DEADLINE_S
    assert wait_for(listener, lambda s: s.stages[0] is None).stages == (None,) * 3


def test_the_object_its_forces_and_its_grasp_are_in_micro_units(station, listener):
    """Tips are bent by force over stiffness; a grasp are the tips that touch."""
    for finger in (1, 2, 3):
        station.say(f'finger_{finger}/state', stage_state(), STATE)
    contacts = [
        ContactForce(
            finger=finger,
            in_contact=True,
            position=Point(x=1e-6, y=2e-6, z=3e-6),
            force=Vector3(x=sign * 4e-6),
            normal_force=4e-6,
            friction_use=0.25,
        )
        for finger, sign in ((3, 1.0), (1, -1.0))  # in any order, and not of every finger
    ]
    pose = Pose(position=Point(x=1e-6), orientation=Quaternion(x=1.0, w=0.0))
    station.say(
        'object_state', ObjectState(pose=pose, held=True, released=True, contacts=contacts), STATE
    )
    station.say('sequencer/object_deviation', ObjectDeviation(angle=0.1, distance=2e-7), STATE)
    snapshot = wait_for(listener, lambda s: s.thing and s.off_plan and all(s.stages))
    thing = snapshot.thing
    np.testing.assert_allclose(thing.pose.position_um, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(thing.pose.quaternion_wxyz, [0.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(thing.contacts[0].force_uN, [-4.0, 0.0, 0.0])
    assert [contact.touching for contact in thing.contacts] == [True, False, True]
    assert thing.contacts[2].friction_use == 0.25
    assert snapshot.off_plan == pytest.approx((0.1, 0.2))
    stands_um = np.array([[10.0, -70.0, -50.0], [10.0, -80.0, -70.0], [10.0, -80.0, -70.0]])
    bent_um = stands_um + np.array([[4.0 / 10.0, 0, 0], [0, 0, 0], [-4.0 / 40.0, 0, 0]])
    np.testing.assert_allclose(snapshot.tip_um, bent_um, atol=1e-9)
    np.testing.assert_allclose(snapshot.grasp_um[[0, 2]], bent_um[[0, 2]], atol=1e-9)
    assert np.all(np.isnan(snapshot.grasp_um[1]))


def test_what_the_sequencer_does_is_known_to_who_comes_late_and_gone_with_it(
    station, clock, listener, sphere_plan
):
    """State and plan are latched; a sequencer that ended does nothing."""
    plan = sphere_plan(30.0)
    station.say('plan', plan_to_msg(plan, 'station'), LATCHED)
    state = SequencerState(
        state=SequencerState.PAUSED, step=2, steps=6, progress=0.25, time_left=7.5
    )
    station.say('sequencer/state', state, LATCHED)
    snapshot = wait_for(listener, lambda s: s.state is not None and s.plan is not None)
    assert (snapshot.state, snapshot.running) == (State.PAUSED, True)
    assert (snapshot.progress.step, snapshot.progress.steps) == (2, 6)
    assert (snapshot.progress.share, snapshot.progress.time_left_s) == (0.25, 7.5)
    assert snapshot.plan.object_sha256 == plan.object_sha256
    assert listener.snapshot().plan is snapshot.plan  # converted once
    station.node.destroy_publisher(station.publishers.pop('sequencer/state'))
    clock.ahead_s = DEADLINE_S
    assert wait_for(listener, lambda s: s.state is None).progress.steps == 0


def test_a_plan_that_contradicts_itself_is_not_shown(station, listener, sphere_plan):
    """The sequencer refuses it; the page goes on."""
    message = plan_to_msg(sphere_plan(30.0), 'station')
    message.steps[0].tip_positions = [math.nan] * len(message.steps[0].tip_positions)
    station.say('plan', message, LATCHED)
    event = RunEvent(source='/x', error_code=ErrorCode.INVALID_PLAN, text='no')
    event.header.stamp.sec = 1_000
    event.header.stamp.nanosec = 500_000_000
    station.say('events', event, EVENTS)
    snapshot = wait_for(listener, lambda s: s.notes)
    assert snapshot.plan is None
    (note,) = snapshot.notes
    assert (note.time_s, note.code, note.text) == (1_000.5, ErrorCode.INVALID_PLAN, 'no')
