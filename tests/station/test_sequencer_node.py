# SPDX-License-Identifier: Apache-2.0
"""The sequencer node and what its callers can do, against real stage drivers and a real twin."""

import dataclasses
import math
import resource
import time

import numpy as np
import pytest
from microhand_msgs_py.msg import ErrorCode, RunEvent, SequencerState, StageState

from microhand_node.qos import EVENTS
from microhand_planner.core.errors import BadRequest
from microhand_planner.core.motions import motions
from microhand_planner.core.plan import Plan
from microhand_planner.core.pose import Pose
from microhand_planner.core.trajectory import time_steps
from microhand_planner.ros.conversions import plan_to_msg
from microhand_station import client
from microhand_station.analysis.run import Run
from microhand_station.bringup.processes import end_processes
from microhand_station.client import StationClient, StationError
from microhand_station.recording_config import RecordingConfig
from microhand_station.sequencer.approach_path import way_to_start
from tests.station.bench import CONFIG, sent_tips_um

DISK_BYTES = 1 << 20
ROLL = 2
"""Step of the plans in which two fingers roll."""


def pieces_of(plan):
    """Return the motions that the station makes of a plan."""
    pace = CONFIG.motion.pace(3500.0)
    return motions(plan, pace, CONFIG.stiffness_uN_per_um, CONFIG.touch)


def test_every_setpoint_of_the_plan_is_sent_and_reached(first_run):
    """Setpoints on the wire are those of the plan, led by contact, and the stages get there."""
    plan = first_run.plan
    expected = [piece.trajectory.tip_um for piece in pieces_of(plan)]
    way = way_to_start(first_run.begin_um, plan)
    if way:
        expected.insert(0, time_steps(way, CONFIG.motion.transit_pace(3500.0)).tip_um)
    assert first_run.result.setpoints_sent == sum(map(len, expected))
    sent_um = sent_tips_um(first_run.chunks)
    off_um = np.abs(sent_um - np.concatenate(expected)).max(axis=(1, 2))
    # what the stages overshoot until contact is reported, and the noise of where they met it
    assert np.median(off_um) < 0.02
    assert off_um.max() < CONFIG.contact.overtravel_um + CONFIG.contact.tolerance_um
    np.testing.assert_allclose(first_run.end_um, sent_um[-1], atol=0.02)
    assert first_run.result.record_file is None
    shares = [progress.share for progress in first_run.told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert {progress.steps for progress in first_run.told} == {6}


def test_setpoints_are_sent_ahead_and_of_all_fingers_with_one_clock(first_run):
    """Chunks of the three fingers carry the same stamps; streams start with sequence 0."""
    stamps = [[chunk.header.stamp for chunk in first_run.chunks[f]] for f in (1, 2, 3)]
    assert stamps[0] == stamps[1] == stamps[2]
    for stream in {chunk.stream for chunk in first_run.chunks[1]}:
        chunks = [chunk for chunk in first_run.chunks[1] if chunk.stream == stream]
        assert chunks[0].sequence == 0
        assert [chunk.last for chunk in chunks] == [False] * (len(chunks) - 1) + [True]
        assert all(len(chunk.positions) == 3 * 25 for chunk in chunks[:-1])
    assert first_run.underruns == 0


def test_cancel_brakes_on_the_path_and_leaves_the_station_ready(bench, sphere_plan):
    """A cancelled run ends with CANCELLED, at rest on the planned path; the next run works."""
    plan = sphere_plan(300.0)
    with bench.executing(plan) as errors:
        bench.watcher.wait(
            lambda: (
                bench.watcher.states[-1].state == SequencerState.RUNNING
                and bench.watcher.states[-1].step == ROLL
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
    way = np.concatenate([piece.trajectory.tip_um for piece in pieces_of(plan)])
    assert np.abs(way - tips).max(axis=(1, 2)).min() < 0.1
    assert np.abs(tips - plan.steps[ROLL].tip_um[-1]).max() > 1.0
    assert errors[0].execution.held
    bench.execute(sphere_plan(10.0))


def test_pause_stands_at_the_end_of_a_step_and_resume_goes_on(bench, sphere_plan):
    """Paused, the tips are where a step of the plan ends; resumed, the plan is completed."""
    plan = sphere_plan(20.0)
    with bench.executing(plan) as errors:
        bench.watcher.wait(lambda: bench.watcher.states[-1].progress > 0.05)
        bench.client.command('pause')
        bench.watcher.wait_state(SequencerState.PAUSED)
        tips = bench.watcher.tips_um()
        ends = [
            piece.trajectory.tip_um[end]
            for piece in pieces_of(plan)
            for end in piece.trajectory.step_end
        ]
        ends += [step.tip_um[-1] for step in plan.steps]  # where guarded fingers stop
        assert min(np.abs(tips - end).max() for end in ends) < 0.1
        with pytest.raises(StationError) as busy:
            bench.client.command('pause')
        assert busy.value.code == ErrorCode.NOT_ALLOWED
        bench.client.command('resume')
    assert errors == []
    bench.watcher.wait_state(SequencerState.IDLE)
    assert bench.watcher.object.held
    end = pieces_of(plan)[-1].trajectory.tip_um[-1]
    np.testing.assert_allclose(bench.watcher.tips_um(), end, atol=0.1)


def test_a_second_run_is_refused_while_one_is_under_way(bench, sphere_plan):
    """BUSY for the second caller; the first run is not disturbed."""
    with bench.executing(sphere_plan(60.0)) as errors:
        bench.watcher.wait_state(SequencerState.RUNNING)
        with StationClient('bench') as other, pytest.raises(StationError) as refused:
            other.execute(sphere_plan(10.0), object_name=bench.mesh)
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
        bench.execute(sphere_plan(10.0))
    assert latched.value.code == ErrorCode.EMERGENCY_STOP
    bench.client.command('reset')
    bench.watcher.wait_state(SequencerState.IDLE)
    bench.execute(sphere_plan(10.0))


def test_a_command_that_there_is_not_is_refused(bench):
    """In words that say which there are, before anything is sent."""
    with pytest.raises(BadRequest, match="command is 'halt'; allowed: pause, resume, emergency"):
        bench.client.command('halt')


def test_a_plan_beyond_the_travel_is_refused_and_nothing_moves(bench, sphere_plan):
    """The error names finger, axis, demand and travel; no setpoint is sent."""
    with pytest.raises(StationError) as error:
        bench.execute(sphere_plan(10.0, wait_um=120.0))
    assert error.value.code == ErrorCode.TRAVEL_EXCEEDED
    assert 'finger 1 x is at 220.000 µm of its stage; allowed: 0.000 to 200.000 µm' in str(
        error.value
    )
    assert not any(bench.watcher.chunks.values())


def test_a_plan_that_contradicts_itself_is_refused(bench, sphere_plan):
    """A roll that slips is found before anything moves."""
    plan: Plan = sphere_plan(20.0)
    roll = plan.steps[ROLL]
    slipping = np.array(roll.tip_um)
    slipping[10:, 0] += [0.0, 0.0, 0.5]
    steps = list(plan.steps)
    steps[ROLL] = dataclasses.replace(roll, tip_um=slipping)
    with pytest.raises(StationError, match=r'step 2 \(roll\): slip of finger 1') as error:
        bench.execute(dataclasses.replace(plan, steps=tuple(steps)))
    assert error.value.code == ErrorCode.INVALID_PLAN
    assert not any(bench.watcher.chunks.values())


@pytest.mark.parametrize(
    ('spoil', 'sentence'),
    [
        (lambda steps: steps[ROLL].tip_positions.__setitem__(4, math.nan), 'tip_um is not finite'),
        (
            lambda steps: setattr(steps[ROLL + 1], 'finger', 4),
            'finger is 4; allowed: 0, 1, 2',
        ),
    ],
    ids=['nan', 'finger'],
)
def test_a_plan_that_cannot_be_meant_is_refused(bench, sphere_plan, monkeypatch, spoil, sentence):
    """NaN in a tip, a finger that does not exist: INVALID_PLAN, nothing moves."""

    def spoilt(plan):
        message = plan_to_msg(plan)
        spoil(message.steps)
        return message

    monkeypatch.setattr(client, 'plan_to_msg', spoilt)
    with pytest.raises(StationError, match=sentence) as error:
        bench.execute(sphere_plan(10.0))
    assert error.value.code == ErrorCode.INVALID_PLAN
    assert not any(bench.watcher.chunks.values())


def test_a_plan_from_another_start_is_refused(bench, sphere_plan):
    """It begins with fingers at the object that are not there now: NOT_ALLOWED, nothing moves."""
    plan = sphere_plan(10.0)
    held = plan.steps[4]
    begin = Pose(held.object_position_um[0], held.object_quaternion_wxyz[0])
    later = dataclasses.replace(plan, start=begin, steps=plan.steps[4:])
    with pytest.raises(
        StationError,
        match=r'finger [123], [xyz]: \d+\.\d\d µm from where the plan has it hold .* allowed 2 µm',
    ) as error:
        bench.execute(later)
    assert error.value.code == ErrorCode.NOT_ALLOWED
    assert not any(bench.watcher.chunks.values())


@pytest.mark.parametrize('fault', [{'fault': 'stuck'}, {'fault_drift': 5e-6, 'fault': 'drifting'}])
def test_a_stage_that_does_not_follow_ends_the_run(bench, sphere_plan, fault):
    """PATH_TOLERANCE names finger, axis, amount and what is allowed; the others stop and hold."""
    driver = 'finger_3/stage_driver'
    bench.tell(driver, **fault)
    sentence = r'finger 3, [xyz]: \d+\.\d\d µm from its setpoint for 0\.1 s, allowed [\d.]+ µm'
    try:
        with pytest.raises(StationError, match=sentence) as error:
            bench.execute(sphere_plan(20.0))
    finally:
        bench.tell(driver, fault='none')
    assert error.value.code == ErrorCode.PATH_TOLERANCE
    bench.watcher.wait_state(SequencerState.IDLE)
    bench.watcher.wait(
        lambda: all(
            stage.mode == StageState.HOLDING and stage.on_target
            for stage in bench.watcher.stages.values()
        )
    )


@pytest.fixture
def recorder(bench):
    """Add a recorder that can write no file larger than `DISK_BYTES`: what a full disk is like."""
    process = bench.start('recorder')
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (DISK_BYTES, DISK_BYTES))
    yield process
    bench.node._config = CONFIG
    assert end_processes([process]) == []


def test_a_run_whose_record_fails_stops_or_goes_on_as_the_station_file_says(
    bench, recorder, sphere_plan
):
    """No folder, then a full disk: told in the result, and what was written is readable."""

    def set_policy(on_failure):
        recording = RecordingConfig(on_failure=on_failure)
        bench.node._config = dataclasses.replace(CONFIG, recording=recording)

    def execute(run_name):
        """Execute; the disk is full when a tenth is done."""
        events = bench.client.node.create_publisher(RunEvent, 'events', EVENTS)
        huge = [RunEvent(text='x' * 2 * DISK_BYTES)]

        def fill(progress):
            if progress.share > 0.1 and huge:
                events.publish(huge.pop())

        try:
            return bench.client.execute(sphere_plan(5.0), run_name, fill, object_name=bench.mesh)
        finally:
            bench.client.node.destroy_publisher(events)

    set_policy('go_on')
    result = execute('goes_on')
    assert result.held
    assert 'ends early after' in result.record_error
    assert any(text.startswith('the run goes on, but ') for text in bench.watcher.events)
    run = Run.open(result.record_file)
    assert (run.mesh.proven, run.note.request['run_name']) == (True, 'goes_on')
    assert 0 < len(run.fingers[1].setpoint_um) < result.setpoints_sent
    set_policy('stop')
    with pytest.raises(StationError, match='ends early after') as error:
        execute('stops')
    assert error.value.code == ErrorCode.RECORDER_MISSING
    assert error.value.execution.setpoints_sent < result.setpoints_sent
    assert Run.open(error.value.execution.record_file).fingers.keys() == {1, 2, 3}
    bench.watcher.wait(lambda: all(stage.on_target for stage in bench.watcher.stages.values()))
    (bench.folder / 'nowhere').touch()
    bench.tell('recorder', run_dir=str(bench.folder / 'nowhere'))
    with pytest.raises(StationError, match='it cannot be written') as error:
        bench.execute(sphere_plan(5.0))
    assert error.value.code == ErrorCode.RECORDER_MISSING
    assert error.value.execution.setpoints_sent == 0
    set_policy('go_on')
    result = bench.execute(sphere_plan(5.0))
    assert (result.held, result.record_file) == (True, None)
    assert 'it cannot be written' in result.record_error
