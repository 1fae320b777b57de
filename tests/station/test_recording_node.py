# SPDX-License-Identifier: Apache-2.0
"""The recorder as a station runs it: a process of its own, reached over DDS only."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
import rclpy
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from microhand_msgs_py.msg import (
    ErrorCode,
    Plan,
    RunEvent,
    SequencerState,
    SetpointChunk,
    StageState,
)
from microhand_msgs_py.srv import StartRun, StopRun
from rcl_interfaces.srv import ListParameters
from rclpy.executors import SingleThreadedExecutor
from rosbags.highlevel import AnyReader

from microhand_station.analysis.run import Run
from microhand_station.recording.recover import recover
from stage_driver_sim.qos import EVENTS, LATCHED, SETPOINTS, STATE

DEADLINE_S = 20.0
CODE = 'import sys; from microhand_station.recording.recorder_node import main; sys.exit(main())'


class Station:
    """The rest of a station, as far as the recorder sees it: publishers and a client."""

    def __init__(self, namespace):
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node('client', namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.events = []
        self.setpoints = self.publishers('finger_{}/setpoints', SetpointChunk, SETPOINTS)
        self.states = self.publishers('finger_{}/state', StageState, STATE)
        self.sequencer = self.node.create_publisher(SequencerState, 'sequencer/state', LATCHED)
        self.node.create_subscription(RunEvent, 'events', self.events.append, EVENTS)
        self.start = self.node.create_client(StartRun, 'recorder/start_run')
        self.stop = self.node.create_client(StopRun, 'recorder/stop_run')

    def publishers(self, topic, message_type, qos):
        """Create a publisher for each finger."""
        names = (topic.format(finger) for finger in (1, 2, 3))
        return [self.node.create_publisher(message_type, name, qos) for name in names]

    def spin_until(self, done):
        """Work until `done()`, but not longer than the deadline."""
        give_up_s = time.monotonic() + DEADLINE_S
        while not done():
            assert time.monotonic() < give_up_s, 'the deadline has passed'
            self.executor.spin_once(timeout_sec=0.05)

    def send(self, client, **fields):
        """Send a request; return the future of its answer."""
        return client.call_async(client.srv_type.Request(**fields))

    def call(self, client, **fields):
        """Send a request and return the answer."""
        future = self.send(client, **fields)
        self.spin_until(future.done)
        return future.result()

    def meet_recorder(self):
        """Ask something harmless until it is answered: a fresh node may lose its first answers."""
        client = self.node.create_client(ListParameters, 'recorder/list_parameters')
        self.spin_until(client.service_is_ready)
        while True:
            future = client.call_async(ListParameters.Request())
            ask_again_s = time.monotonic() + 1.0
            self.spin_until(lambda: future.done() or time.monotonic() > ask_again_s)  # noqa: B023
            if future.done():
                break
            client.remove_pending_request(future)
        self.node.destroy_client(client)

    def wait_for_recorder(self):
        """Wait until the recorder is there, listens to everything, and answers."""
        publishers = [*self.setpoints, *self.states, self.sequencer]
        self.spin_until(
            lambda: (
                self.start.service_is_ready()
                and self.stop.service_is_ready()
                and all(p.get_subscription_count() for p in publishers)
            )
        )
        self.meet_recorder()

    def close(self):
        """Leave the ROS graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.shutdown()


def make_chunk(sequence, size=25, stream=1):
    """Make a chunk whose positions tell the number of each setpoint."""
    positions = [1e-9 * (3 * sequence + k) for k in range(3 * size)]
    chunk = SetpointChunk(sequence=sequence, stream=stream, period=0.002, positions=positions)
    chunk.velocities = [0.0] * (3 * size)
    return chunk


@pytest.fixture
def station():
    """Stand in for the rest of the station."""
    station = Station('lab')
    yield station
    station.close()


@pytest.fixture
def start_recorder(tmp_path, station):
    """Start recorder processes; they must end by themselves, in order, when told to."""
    processes = []

    def start(run_dir=tmp_path, stop_timeout=5.0, before=''):
        command = [sys.executable, '-c', before + CODE, '--ros-args', '-r', '__ns:=/lab']
        parameters = ('-p', f'run_dir:={run_dir}', '-p', f'stop_timeout:={stop_timeout}')
        process = subprocess.Popen(
            [*command, *parameters], stderr=subprocess.PIPE, text=True, bufsize=1
        )
        processes.append(process)
        station.wait_for_recorder()
        return process

    yield start
    for process in processes:
        if process.poll() is None:
            try:
                assert end(process, signal.SIGTERM) == 0
            finally:
                process.kill()
                process.communicate()


def end(process, how):
    """Send a signal; return the exit status once the process is gone, without a traceback."""
    process.send_signal(how)
    _, errors = process.communicate(timeout=DEADLINE_S)
    assert 'Traceback' not in errors, errors
    return process.returncode


def setpoints_by_mcap(path):
    """Positions of each finger in the order of the file, by mcap-ros2-support."""
    found = {1: [], 2: [], 3: []}
    with open(path, 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            if channel.topic.endswith('/setpoints'):
                found[int(channel.topic[-11])].extend(message.positions)
    return found


def setpoints_by_rosbags(path):
    """Positions of each finger in time order, by rosbags."""
    found = {1: [], 2: [], 3: []}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic.endswith('/setpoints'):
                found[int(connection.topic[-11])].extend(message.positions)
    return found


def test_every_setpoint_of_a_run_is_recorded_in_order(station, start_recorder, tmp_path):
    """3 fingers at 500 Hz for 2 s, with states at 200 Hz: complete in both readers."""
    start_recorder()
    station.sequencer.publish(SequencerState(state=SequencerState.STARTING, plan_hash='early'))
    metadata = json.dumps({'object': 'ellipsoid'})
    plan = Plan(plan_hash='abc', object_name='ellipsoid')
    started = station.call(station.start, name='run', metadata_json=metadata, plan=plan)
    assert (started.error_code, started.error_msg) == (0, '')
    begin_s, chunks = time.monotonic(), 40
    for number in range(chunks):
        for publisher in station.setpoints:
            publisher.publish(make_chunk(25 * number))
        for state in range(10):
            for publisher in station.states:
                publisher.publish(StageState(mode=StageState.STREAMING, received=state))
            due_s = begin_s + 0.05 * number + 0.005 * (state + 1)
            station.spin_until(lambda due_s=due_s: time.monotonic() >= due_s)
    sent = 25 * chunks
    stopped = station.call(station.stop, expected_setpoints=[sent] * 3)
    assert (stopped.error_code, stopped.error_msg) == (0, '')
    assert list(stopped.recorded_setpoints) == [sent] * 3
    assert stopped.file == started.file == str(tmp_path / 'run.mcap')
    path = tmp_path / 'run.mcap'
    expected = [1e-9 * k for k in range(3 * sent)]
    for found in (setpoints_by_mcap(path), setpoints_by_rosbags(path)):
        for finger in (1, 2, 3):
            assert found[finger] == pytest.approx(expected, rel=1e-12, abs=0)
    run = Run.open(path)
    assert run.finished
    assert run.end == 'complete'
    assert sum(run.counts.values()) == stopped.messages
    assert run.metadata['metadata_json'] == metadata
    with path.open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        plans = [found for *_, found in reader.iter_decoded_messages(topics=['/lab/plan'])]
    assert [found.object_name for found in plans] == ['ellipsoid']
    assert run.counts['/lab/sequencer/state'] == 1, 'latched before the run, kept in the record'
    assert [run.counts[f'/lab/finger_{finger}/state'] for finger in (1, 2, 3)] == [400] * 3
    assert any(event.text.startswith('recording ') for event in run.events)


def test_one_run_at_a_time_and_none_is_overwritten(station, start_recorder, tmp_path):
    """A second start is BUSY, stop without a run is NOT_ALLOWED, a used name gets a number."""
    start_recorder()
    assert station.call(station.stop).error_code == ErrorCode.NOT_ALLOWED
    first = station.call(station.start, name='run')
    busy = station.call(station.start, name='other')
    assert (busy.error_code, busy.file) == (ErrorCode.BUSY, '')
    assert 'run.mcap' in busy.error_msg
    assert station.call(station.stop).error_code == 0
    content = (tmp_path / 'run.mcap').read_bytes()
    second = station.call(station.start, name='run')
    assert station.call(station.stop).error_code == 0
    assert [first.file, second.file] == [str(tmp_path / n) for n in ('run.mcap', 'run_2.mcap')]
    assert (tmp_path / 'run.mcap').read_bytes() == content
    unnamed = station.call(station.start)
    assert unnamed.error_code == 0
    assert unnamed.file.startswith(str(tmp_path / 'run_20'))
    assert sorted(path.suffix for path in tmp_path.iterdir()) == ['.mcap'] * 3


def test_bad_requests_leave_no_file(station, start_recorder, tmp_path):
    """A name that leaves the folder and metadata that is no JSON object are refused."""
    start_recorder()
    for fields, says in (
        ({'name': '../run'}, "name is '../run'; allowed"),
        ({'name': '.hidden'}, "name is '.hidden'; allowed"),
        ({'name': 'n' * 101}, 'up to 100 letters'),
        ({'metadata_json': '[1]'}, 'allowed: a JSON object'),
        ({'metadata_json': '{'}, 'allowed: a JSON object'),
    ):
        answer = station.call(station.start, **fields)
        assert answer.error_code == ErrorCode.INVALID_PARAMETER
        assert says in answer.error_msg
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_named(station, start_recorder, tmp_path):
    """The answer names the folder; the recorder stays up and answers again."""
    (tmp_path / 'file').touch()
    start_recorder(run_dir=tmp_path / 'file' / 'runs')
    for _ in range(2):
        answer = station.call(station.start, name='run')
        assert answer.error_code == ErrorCode.RECORDER_MISSING
        assert answer.error_msg.startswith(
            f'run_dir is {tmp_path}/file/runs; it cannot be written'
        )


def test_what_is_missing_is_said(station, start_recorder):
    """Setpoints that never came and numbers that were skipped end in the answer and the file."""
    start_recorder(stop_timeout=0.3)
    started = station.call(station.start, name='run')
    station.setpoints[0].publish(make_chunk(0))
    station.setpoints[0].publish(make_chunk(50))
    station.setpoints[1].publish(make_chunk(0))
    answer = station.call(station.stop, expected_setpoints=[75, 25, 0])
    assert answer.error_code == ErrorCode.RECORDER_MISSING
    assert answer.error_msg == (
        'finger_1: 50 setpoints recorded, 75 sent; '
        'finger_1: 25 setpoints skipped, 0 repeated or late'
    )
    assert list(answer.recorded_setpoints) == [50, 25, 0]
    run = Run.open(started.file)
    assert (run.finished, run.end) == (True, answer.error_msg)
    assert run.fingers[1].missing == 25


def test_stop_waits_for_setpoints_under_way_and_blocks_nothing(station, start_recorder):
    """While a stop waits, other services answer and messages are recorded; then it completes."""
    start_recorder(stop_timeout=600.0)
    station.call(station.start, name='run')
    stopping = station.send(station.stop, expected_setpoints=[50, 0, 0])
    station.setpoints[0].publish(make_chunk(0))
    assert station.call(station.start, name='other').error_code == ErrorCode.BUSY
    assert station.call(station.stop).error_code == ErrorCode.NOT_ALLOWED
    assert not stopping.done()
    station.setpoints[0].publish(make_chunk(25))
    station.spin_until(stopping.done)
    assert stopping.result().error_code == 0
    assert list(stopping.result().recorded_setpoints) == [50, 0, 0]


@pytest.mark.parametrize('how', [signal.SIGTERM, signal.SIGINT])
def test_a_recorder_told_to_stop_finishes_its_file(station, start_recorder, how):
    """SIGTERM, SIGINT: exit status 0, no traceback, a well-formed file that says why it ends."""
    process = start_recorder()
    started = station.call(station.start, name='run')
    station.setpoints[0].publish(make_chunk(0))
    station.spin_until(lambda: len(setpoints_in(started.file)) == 25)
    assert end(process, how) == 0
    assert len(setpoints_by_mcap(started.file)[1]) == 75
    run = Run.open(started.file)
    assert run.finished
    assert run.end == 'the recorder ended before the run did'


def setpoints_in(path):
    """Setpoints of finger 1 in a file that is still being written."""
    record = Run.open(path).fingers.get(1)
    return [] if record is None else record.setpoint_time_s


def test_a_killed_recorder_leaves_what_it_had_received(station, start_recorder, tmp_path):
    """SIGKILL in a run: every setpoint sent more than 100 ms before is recovered."""
    process = start_recorder()
    started = station.call(station.start, name='run')
    sent_s = []
    while len(sent_s) < 60:
        sent_s.append(time.monotonic())
        station.setpoints[0].publish(make_chunk(25 * (len(sent_s) - 1)))
        station.spin_until(lambda: time.monotonic() >= sent_s[-1] + 0.02)
    killed_s = time.monotonic()
    process.kill()
    process.communicate(timeout=DEADLINE_S)
    recover(started.file, tmp_path / 'out.mcap')
    found = setpoints_by_mcap(tmp_path / 'out.mcap')[1]
    due = 25 * sum(killed_s - time_s > 0.1 for time_s in sent_s)
    assert len(found) // 3 >= due > 0
    assert found == pytest.approx([1e-9 * k for k in range(len(found))], rel=1e-12, abs=0)


def test_a_disk_that_is_full_ends_the_record_and_not_the_recorder(station, start_recorder):
    """At a limit of 4 MiB a file: an event and the answer say so; what was written is readable."""
    limit = 'import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 22, 1 << 22)); '
    start_recorder(before=limit)
    started = station.call(station.start, name='run')
    sent = 0
    while not any(event.error_code for event in station.events):
        assert sent < 200_000
        station.setpoints[0].publish(make_chunk(sent, size=2000))
        sent += 2000
        station.executor.spin_once(timeout_sec=0.02)
    answer = station.call(station.stop, expected_setpoints=[sent, 0, 0])
    assert answer.error_code == ErrorCode.RECORDER_MISSING
    assert 'ends early after' in answer.error_msg
    assert os.path.getsize(started.file) <= 1 << 22
    run = Run.open(started.file)
    assert not run.finished
    assert len(run.fingers[1].setpoint_um) == answer.recorded_setpoints[0] >= 40_000
    assert station.call(station.start, name='next').error_code == 0
