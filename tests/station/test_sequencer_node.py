# SPDX-License-Identifier: Apache-2.0
"""The sequencer node in a context of its own, against three real stage drivers in processes."""

import contextlib
import dataclasses
import threading
import time

import numpy as np
import pytest
import rclpy
from microhand_msgs_py.msg import ErrorCode, SequencerState, SetpointChunk, StageState
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from microhand_planner.core.plan import Plan
from microhand_planner.core.trajectory import time_steps
from microhand_planner.ros.conversions import um_from_m, um_from_point
from microhand_station.bringup.lifecycle import activate
from microhand_station.bringup.node_commands import node_commands
from microhand_station.bringup.processes import NodeProcess, end_processes
from microhand_station.client import StationClient, StationError
from microhand_station.config import Motion, StationConfig, write_config
from microhand_station.sequencer.approach_path import way_to_start
from microhand_station.sequencer.node import SequencerNode
from stage_driver_sim.qos import LATCHED, SETPOINTS, STATE

CONFIG = StationConfig(namespace='bench', record=False, motion=Motion(speed=1.5))
DEADLINE_S = 20.0
BASE_UM = np.array(CONFIG.fingers[0].base_um)


class Watcher:
    """Keeps what the sequencer and the drivers publish; tests wait for conditions on it."""

    def __init__(self, node):
        self.states = []
        self.chunks = {1: [], 2: [], 3: []}
        self.stages = {}
        self._changed = threading.Condition()
        node.create_subscription(SequencerState, 'sequencer/state', self._on_state, LATCHED)
        for finger in (1, 2, 3):
            node.create_subscription(
                SetpointChunk, f'finger_{finger}/setpoints', self._on_chunk, SETPOINTS
            )
            node.create_subscription(StageState, f'finger_{finger}/state', self._on_stage, STATE)

    def _on_state(self, message):
        with self._changed:
            self.states.append(message)
            self._changed.notify_all()

    def _on_chunk(self, message):
        with self._changed:
            self.chunks[int(message.header.frame_id[7])].append(message)
            self._changed.notify_all()

    def _on_stage(self, message):
        with self._changed:
            self.stages[int(message.header.frame_id[7])] = message
            self._changed.notify_all()

    def wait(self, condition, deadline_s=DEADLINE_S):
        """Return when `condition` holds; fail after the deadline."""
        with self._changed:
            assert self._changed.wait_for(condition, deadline_s), 'waited in vain'

    def wait_state(self, state):
        """Return when the sequencer is in a state."""
        self.wait(lambda: self.states and self.states[-1].state == state)

    def tips_um(self):
        """Return where the drivers say that the tips are, station frame."""
        return np.stack([um_from_point(self.stages[f].position) + BASE_UM for f in (1, 2, 3)])

    def clear(self):
        """Forget setpoints and states."""
        with self._changed:
            self.states = self.states[-1:]
            for chunks in self.chunks.values():
                chunks.clear()


class Bench:
    """Three drivers in processes, a sequencer in this one, and a client."""

    def __init__(self, folder):
        self.folder = folder
        write_config(CONFIG, folder / 'station.yaml')
        self.commands = {command.name: command for command in node_commands(CONFIG, folder)}
        self.drivers = {finger: self.start_driver(finger) for finger in (1, 2, 3)}
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        parameter = Parameter('config', value=str(folder / 'station.yaml'))
        self.node = SequencerNode(
            context=self.context, namespace='bench', parameter_overrides=[parameter]
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.stopping = threading.Event()
        self.spinner = threading.Thread(target=self._spin)
        self.spinner.start()
        self.client = StationClient('bench')
        self.watcher = Watcher(self.client.node)
        for finger in (1, 2, 3):
            self.activate(finger)

    def _spin(self):
        while not self.stopping.is_set():
            self.executor.spin_once(timeout_sec=0.05)

    def start_driver(self, finger):
        """Start the process of one driver."""
        command = self.commands[f'finger_{finger}']
        log = self.folder / f'{command.name}.log'
        return NodeProcess(command.name, command.module, command.arguments, log, {})

    def activate(self, finger):
        """Bring a driver to work, and wait for its first state."""
        self.watcher.stages.pop(finger, None)
        activate(
            self.client.node,
            f'finger_{finger}/stage_driver',
            who=f'finger {finger}',
            deadline_s=DEADLINE_S,
        )
        self.watcher.wait(lambda: finger in self.watcher.stages)

    def close(self):
        """End everything."""
        self.client.close()
        self.stopping.set()
        self.spinner.join()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        assert end_processes(self.drivers.values()) == []

    @contextlib.contextmanager
    def executing(self, plan):
        """Execute a plan in another thread; gives a list that will hold the error, if any."""
        errors, ended = [], threading.Event()

        def execute():
            try:
                self.client.execute(plan)
            except StationError as error:
                errors.append(error)
            ended.set()

        thread = threading.Thread(target=execute)
        thread.start()
        yield errors
        thread.join(DEADLINE_S)
        assert not thread.is_alive(), 'the action did not end'


@pytest.fixture(scope='module')
def started(ros_domain, tmp_path_factory):
    """Start the bench once for all tests of this file."""
    bench = Bench(tmp_path_factory.mktemp('bench'))
    yield bench
    bench.close()


@pytest.fixture
def bench(started):
    """Return the bench, idle, without faults, and with nothing remembered."""
    started.watcher.wait_state(SequencerState.IDLE)
    if any(state.mode == StageState.FAULT for state in started.watcher.stages.values()):
        started.client.command('reset')  # one test that failed must not make the others fail
    started.watcher.clear()
    return started


def sent_tips_um(watcher, stream_from=0):
    """Return all setpoints that were sent, station frame, after checking their order."""
    tips = []
    for finger in (1, 2, 3):
        rows, expected = [], None
        for chunk in watcher.chunks[finger]:
            key = (chunk.stream, chunk.sequence)
            assert expected is None or key == expected or chunk.sequence == 0
            rows.append(um_from_m(chunk.positions).reshape(-1, 3) + BASE_UM)
            expected = (chunk.stream, chunk.sequence + len(rows[-1]))
        tips.append(np.concatenate(rows))
    return np.stack(tips, axis=1)


def test_every_setpoint_of_the_plan_is_sent_and_reached(bench, sphere_plan):
    """The setpoints on the wire are those of the plan, and the stages end on its last waypoint."""
    plan = sphere_plan(20.0)
    here = np.stack([um_from_point(bench.watcher.stages[f].command) for f in (1, 2, 3)]) + BASE_UM
    told = []
    result = bench.client.execute(plan, on_progress=told.append)
    stages = bench.watcher.stages
    bench.watcher.wait(lambda: all(stages[f].on_target for f in (1, 2, 3)))
    pace = CONFIG.motion.pace(3500.0)
    expected = [time_steps(plan.steps, pace).tip_um]
    way = way_to_start(here, plan)
    if way:
        expected.insert(0, time_steps(way, CONFIG.motion.transit_pace(3500.0)).tip_um)
    count = sum(map(len, expected))
    bench.watcher.wait(
        lambda: sum(len(c.positions) // 3 for c in bench.watcher.chunks[3]) == count
    )
    assert result.setpoints_sent == count
    np.testing.assert_allclose(sent_tips_um(bench.watcher), np.concatenate(expected), atol=2e-6)
    np.testing.assert_allclose(bench.watcher.tips_um(), plan.steps[-1].tip_um[-1], atol=0.03)
    assert (result.held, result.final_error_rad, result.record_file) == (None, None, None)
    shares = [progress.share for progress in told]
    assert shares == sorted(shares)
    assert told[-1].share > 0.9
    assert {progress.steps for progress in told} == {5}


def test_setpoints_are_sent_ahead_and_of_all_fingers_with_one_clock(bench, sphere_plan):
    """Chunks of the three fingers carry the same stamps; streams start with sequence 0."""
    bench.client.execute(sphere_plan(10.0))
    watcher = bench.watcher
    watcher.wait(lambda: all(chunks and chunks[-1].last for chunks in watcher.chunks.values()))
    stamps = [[chunk.header.stamp for chunk in watcher.chunks[f]] for f in (1, 2, 3)]
    assert stamps[0] == stamps[1] == stamps[2]
    streams = {chunk.stream for chunk in watcher.chunks[1]}
    for stream in streams:
        chunks = [chunk for chunk in watcher.chunks[1] if chunk.stream == stream]
        assert chunks[0].sequence == 0
        assert [chunk.last for chunk in chunks] == [False] * (len(chunks) - 1) + [True]
        assert all(len(chunk.positions) == 3 * 25 for chunk in chunks[:-1])
    assert watcher.stages[1].underruns == 0


def test_cancel_brakes_on_the_path_and_leaves_the_station_ready(bench, sphere_plan):
    """A cancelled run ends with CANCELLED, at rest on the planned path; the next run works."""
    plan = sphere_plan(120.0)
    with bench.executing(plan) as errors:
        bench.watcher.wait(
            lambda: (
                bench.watcher.states[-1].state == SequencerState.RUNNING
                and bench.watcher.states[-1].step == 1
                and bench.watcher.states[-1].progress > 0.25
            )
        )
        began_s = time.monotonic()
        bench.client.cancel()
    assert time.monotonic() - began_s < 2.0
    assert errors[0].code == ErrorCode.CANCELLED
    bench.watcher.wait_state(SequencerState.IDLE)
    states = [message.state for message in bench.watcher.states]
    assert SequencerState.STOPPING in states
    bench.watcher.wait(lambda: all(s.on_target for s in bench.watcher.stages.values()))
    tips = bench.watcher.tips_um()
    roll = time_steps(plan.steps, CONFIG.motion.pace(3500.0)).tip_um
    assert np.abs(roll - tips).max(axis=(1, 2)).min() < 0.05
    assert np.abs(tips - plan.steps[1].tip_um[-1]).max() > 1.0
    bench.client.execute(sphere_plan(10.0))


def test_pause_stands_at_the_end_of_a_step_and_resume_goes_on(bench, sphere_plan):
    """Paused, the tips are where a step of the plan ends; resumed, the plan is completed."""
    plan = sphere_plan(20.0)
    with bench.executing(plan) as errors:
        bench.watcher.wait(lambda: bench.watcher.states[-1].progress > 0.05)
        bench.client.command('pause')
        bench.watcher.wait_state(SequencerState.PAUSED)
        tips = bench.watcher.tips_um()
        ends = [step.tip_um[-1] for step in plan.steps]
        assert min(np.abs(tips - end).max() for end in ends[:-1]) < 0.05
        with pytest.raises(StationError) as busy:
            bench.client.command('pause')
        assert busy.value.code == ErrorCode.NOT_ALLOWED
        bench.client.command('resume')
    assert errors == []
    bench.watcher.wait_state(SequencerState.IDLE)
    np.testing.assert_allclose(bench.watcher.tips_um(), plan.steps[-1].tip_um[-1], atol=0.05)


def test_a_second_run_is_refused_while_one_is_under_way(bench, sphere_plan):
    """BUSY for the second caller; the first run is not disturbed."""
    with bench.executing(sphere_plan(60.0)) as errors:
        bench.watcher.wait_state(SequencerState.RUNNING)
        with StationClient('bench') as other, pytest.raises(StationError) as refused:
            other.execute(sphere_plan(10.0))
        assert refused.value.code == ErrorCode.BUSY
    assert errors == []


def test_emergency_stop_is_latched_until_reset(bench, sphere_plan):
    """All stages stop; nothing runs until the reset, then everything does."""
    with bench.executing(sphere_plan(120.0)) as errors:
        bench.watcher.wait(lambda: bench.watcher.states[-1].progress > 0.2)
        bench.client.command('emergency_stop')
        bench.watcher.wait(
            lambda: all(s.mode == StageState.STOPPED for s in bench.watcher.stages.values())
        )
    assert errors[0].code == ErrorCode.EMERGENCY_STOP
    bench.watcher.wait_state(SequencerState.EMERGENCY)
    with pytest.raises(StationError) as latched:
        bench.client.execute(sphere_plan(10.0))
    assert latched.value.code == ErrorCode.EMERGENCY_STOP
    bench.client.command('reset')
    bench.watcher.wait_state(SequencerState.IDLE)
    bench.client.execute(sphere_plan(10.0))


def test_a_plan_beyond_the_travel_is_refused_and_nothing_moves(bench, sphere_plan):
    """The error names finger, axis, demand and travel; no setpoint is sent."""
    with pytest.raises(StationError) as error:
        bench.client.execute(sphere_plan(10.0, wait_um=120.0))
    assert error.value.code == ErrorCode.TRAVEL_EXCEEDED
    assert 'finger 1 x is at 220.000 µm of its stage; allowed: 0.000 to 200.000 µm' in str(
        error.value
    )
    assert not any(bench.watcher.chunks.values())


def test_a_plan_that_contradicts_itself_is_refused(bench, sphere_plan):
    """A roll that slips is found before anything moves."""
    plan: Plan = sphere_plan(20.0)
    roll = plan.steps[1]
    slipping = np.array(roll.tip_um)
    slipping[10:, 0] += [0.0, 0.0, 0.5]
    steps = (plan.steps[0], dataclasses.replace(roll, tip_um=slipping), *plan.steps[2:])
    with pytest.raises(StationError, match=r'step 1 \(roll\): slip of finger 1') as error:
        bench.client.execute(dataclasses.replace(plan, steps=steps))
    assert error.value.code == ErrorCode.INVALID_PLAN
    assert not any(bench.watcher.chunks.values())


def test_a_driver_that_dies_ends_the_run_within_a_second(bench, sphere_plan):
    """STAGE_MISSING names the finger, the others come to rest; a new driver cures it."""
    with bench.executing(sphere_plan(150.0)) as errors:
        bench.watcher.wait(
            lambda: bench.watcher.states[-1].step == 1 and bench.watcher.states[-1].progress > 0.3
        )
        bench.drivers[2].kill()
        began_s = time.monotonic()
    assert time.monotonic() - began_s < 2.0
    assert errors[0].code == ErrorCode.STAGE_MISSING
    assert 'finger 2' in str(errors[0])
    bench.watcher.wait_state(SequencerState.IDLE)
    stages = bench.watcher.stages
    bench.watcher.wait(lambda: all(stages[f].mode == StageState.HOLDING for f in (1, 3)))
    with pytest.raises(StationError, match='finger 2: its stage driver') as missing:
        bench.client.execute(sphere_plan(10.0))
    assert missing.value.code == ErrorCode.STAGE_MISSING
    bench.drivers[2] = bench.start_driver(2)
    bench.activate(2)
    bench.client.execute(sphere_plan(10.0))
