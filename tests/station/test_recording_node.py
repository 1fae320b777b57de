# SPDX-License-Identifier: Apache-2.0
"""The recorder as a station runs it: a process of its own, reached over DDS only."""

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
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
from rcl_interfaces.srv import ListParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from microhand_node.qos import DIAGNOSTICS, EVENTS, LATCHED, SETPOINTS, STATE
from microhand_station.analysis.run import Run
from microhand_station.recording.recover import recover
from microhand_station.recording.run_writer import PARAMETERS_METADATA, VERSIONS_METADATA

DEADLINE_S = 20.0
NUMBERS = itertools.count()
BAG_KEYS = {
    'version', 'storage_identifier', 'duration', 'starting_time', 'message_count',
    'topics_with_message_count', 'compression_format', 'compression_mode', 'relative_file_paths',
    'files', 'custom_data', 'ros_distro',
}  # fmt: skip
"""What rosbag2 of Jazzy writes and reads: `rosbag2_storage/yaml.hpp`."""
TOPIC_KEYS = {
    'name', 'type', 'serialization_format', 'offered_qos_profiles', 'type_description_hash',
}  # fmt: skip
CODE = 'import sys; from microhand_station.recording.recorder_node import main; sys.exit(main())'


class Station:
    """The rest of a station, as far as the recorder sees it: publishers and a client."""

    def __init__(self, namespace):
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node('client', namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.events, self.statuses = [], []
        self.setpoints = self.publishers('finger_{}/setpoints', SetpointChunk, SETPOINTS)
        self.states = self.publishers('finger_{}/state', StageState, STATE)
        self.sequencer = self.node.create_publisher(SequencerState, 'sequencer/state', LATCHED)
        self.node.create_subscription(RunEvent, 'events', self.events.append, EVENTS)
        self.node.create_subscription(
            DiagnosticArray,
            '/diagnostics',
            lambda array: self.statuses.extend(array.status),
            DIAGNOSTICS,
        )
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

    def set_parameters(self, **values):
        """Set parameters of the recorder."""
        client = self.node.create_client(SetParameters, 'recorder/set_parameters')
        self.spin_until(client.service_is_ready)
        parameters = [Parameter(name, value=v).to_parameter_msg() for name, v in values.items()]
        answer = self.call(client, parameters=parameters)
        assert [result.successful for result in answer.results] == [True] * len(values)
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
    """Stand in for the rest of a station; of its own name, as killed ones are seen for a while."""
    station = Station(f'lab_{next(NUMBERS)}')
    yield station
    station.close()


def recorder_process(run_dir, namespace, before='', **parameters):
    """Start the process of a recorder."""
    parameters = {'run_dir': run_dir, **parameters}
    told = [part for name, value in parameters.items() for part in ('-p', f'{name}:={value}')]
    command = [
        sys.executable,
        '-c',
        before + CODE,
        '--ros-args',
        '-r',
        f'__ns:={namespace}',
        *told,
    ]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, bufsize=1)


@pytest.fixture
def start_recorder(tmp_path, station):
    """Start recorder processes; they must end by themselves, in order, when told to."""
    processes = []

    def start(before='', **parameters):
        process = recorder_process(tmp_path, station.node.get_namespace(), before, **parameters)
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


@pytest.fixture(scope='module')
def kept_recorder(tmp_path_factory):
    """Start a station and a recorder for several tests: faster than one for each."""
    station = Station('kept')
    process = recorder_process(tmp_path_factory.mktemp('kept'), '/kept', stop_timeout=600.0)
    try:
        station.wait_for_recorder()
        yield station
        assert end(process, signal.SIGTERM) == 0
    finally:
        process.kill()
        process.communicate()
        station.close()


@pytest.fixture
def kept(kept_recorder, tmp_path):
    """Return the kept station; its recorder writes into the folder of the test."""
    kept_recorder.events.clear()
    kept_recorder.statuses.clear()
    kept_recorder.set_parameters(run_dir=str(tmp_path))
    return kept_recorder


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


def stream(station, begin_s, number):
    """Send 50 ms of a run: setpoints at 500 Hz and states at 100 Hz of all fingers; then wait."""
    for publisher in station.setpoints:
        publisher.publish(make_chunk(25 * number))
    for state in range(5):
        for publisher in station.states:
            publisher.publish(StageState(mode=StageState.STREAMING, received=state))
        due_s = begin_s + 0.05 * number + 0.01 * (state + 1)
        station.spin_until(lambda due_s=due_s: time.monotonic() >= due_s)


def test_every_setpoint_of_a_run_is_recorded_in_order(kept, tmp_path):
    """3 fingers at 500 Hz for 2 s: complete in both readers, with all that explains the run."""
    kept.sequencer.publish(SequencerState(state=SequencerState.STARTING, plan_hash='early'))
    metadata = json.dumps({'object': 'ellipsoid'})
    plan = Plan(plan_hash='abc', object_name='ellipsoid')
    mesh = tmp_path / 'part.stl'
    mesh.write_bytes(b'solid' * 20_000)
    started = kept.call(
        kept.start, name='run', metadata_json=metadata, plan=plan, mesh_file=str(mesh)
    )
    assert (started.error_code, started.error_msg) == (0, '')
    begin_s, chunks = time.monotonic(), 40
    for number in range(chunks):
        stream(kept, begin_s, number)
    sent = 25 * chunks
    stopped = kept.call(kept.stop, expected_setpoints=[sent] * 3)
    assert (stopped.error_code, stopped.error_msg) == (0, '')
    assert list(stopped.recorded_setpoints) == [sent] * 3
    path = tmp_path / 'run' / 'run.mcap'
    assert stopped.file == started.file == str(path)
    expected = [1e-9 * k for k in range(3 * sent)]
    for found in (setpoints_by_mcap(path), setpoints_by_rosbags(path.parent)):
        for finger in (1, 2, 3):
            assert found[finger] == pytest.approx(expected, rel=1e-12, abs=0)
    run = Run.open(path)
    assert run.finished
    assert run.end == 'complete'
    assert sum(run.counts.values()) == stopped.messages
    assert run.metadata['metadata_json'] == metadata
    assert run.counts['/kept/sequencer/state'] == 1, 'latched before the run, kept in the record'
    assert [run.counts[f'/kept/finger_{finger}/state'] for finger in (1, 2, 3)] == [200] * 3
    assert any(event.text.startswith('recording ') for event in run.events)
    with path.open('rb') as stream_of_file:
        reader = make_reader(stream_of_file, decoder_factories=[DecoderFactory()])
        plans = [found for *_, found in reader.iter_decoded_messages(topics=['/kept/plan'])]
        notes = {record.name: record.metadata for record in reader.iter_metadata()}
        attached = [(found.name, found.data) for found in reader.iter_attachments()]
        chunk_indexes = reader.get_summary().chunk_indexes
    assert [found.object_name for found in plans] == ['ellipsoid']
    assert attached == [('part.stl', mesh.read_bytes())]
    assert {'microhand_station', 'numpy', 'python'} <= notes[VERSIONS_METADATA].keys()
    of_recorder = json.loads(notes[PARAMETERS_METADATA]['/kept/recorder'])
    assert (of_recorder['run_dir'], of_recorder['stop_timeout']) == (str(tmp_path), 600.0)
    assert json.loads(notes[PARAMETERS_METADATA]['/kept/client']).keys() >= {'use_sim_time'}
    assert {index.compression for index in chunk_indexes} == {'zstd'}
    assert sum(map(len, expected_files(path.parent))) == 0


def expected_files(folder):
    """Return what is in the folder of a run and should not be, and what is not and should."""
    found, due = {path.name for path in folder.iterdir()}, {'metadata.yaml', f'{folder.name}.mcap'}
    return found - due, due - found


def test_the_folder_of_a_run_is_a_bag_of_rosbag2(kept, tmp_path):
    """`metadata.yaml` has the fields of version 9, and says what is in the file."""
    started = kept.call(kept.start, name='run')
    kept.setpoints[0].publish(make_chunk(0))
    kept.setpoints[0].publish(make_chunk(25))
    stopped = kept.call(kept.stop, expected_setpoints=[50, 0, 0])
    text = (tmp_path / 'run' / 'metadata.yaml').read_text(encoding='utf-8')
    assert '&' not in text, 'written out, as rosbag2 does'
    told = yaml.safe_load(text)
    information = told['rosbag2_bagfile_information']
    assert information.keys() == BAG_KEYS
    assert information['version'] == 9
    assert information['message_count'] == stopped.messages
    (file,) = information['files']
    assert file['path'] == os.path.basename(started.file) == information['relative_file_paths'][0]
    topics = {
        each['topic_metadata']['name']: (each['topic_metadata'], each['message_count'])
        for each in information['topics_with_message_count']
    }
    details, count = topics['/kept/finger_1/setpoints']
    assert count == 2
    assert details.keys() == TOPIC_KEYS
    assert re.fullmatch('RIHS01_[0-9a-f]{64}', details['type_description_hash'])
    assert [q['reliability'] for q in details['offered_qos_profiles']] == ['reliable']
    with Reader(tmp_path / 'run') as reader:
        assert reader.message_count == stopped.messages == sum(1 for _ in reader.messages())
        times = [time_ns for _, time_ns, _ in reader.messages()]
        assert (reader.start_time, reader.duration) == (times[0], times[-1] - times[0] + 1)
        assert reader.ros_distro == 'jazzy'
        by_name = {connection.topic: connection for connection in reader.connections}
        (qos,) = by_name['/kept/plan'].ext.offered_qos_profiles
        assert qos.durability.name == 'TRANSIENT_LOCAL'


def test_one_run_at_a_time_and_none_is_overwritten(kept, tmp_path):
    """A second start is BUSY, stop without a run is NOT_ALLOWED, a used name gets a number."""
    assert kept.call(kept.stop).error_code == ErrorCode.NOT_ALLOWED
    first = kept.call(kept.start, name='run')
    busy = kept.call(kept.start, name='other')
    assert (busy.error_code, busy.file) == (ErrorCode.BUSY, '')
    assert 'run.mcap' in busy.error_msg
    assert kept.call(kept.stop).error_code == 0
    content = (tmp_path / 'run' / 'run.mcap').read_bytes()
    second = kept.call(kept.start, name='run')
    assert kept.call(kept.stop).error_code == 0
    expected = [tmp_path / name / f'{name}.mcap' for name in ('run', 'run_2')]
    assert [first.file, second.file] == [str(path) for path in expected]
    assert expected[0].read_bytes() == content
    unnamed = kept.call(kept.start)
    assert unnamed.error_code == 0
    assert unnamed.file.startswith(str(tmp_path / 'run_20'))
    assert kept.call(kept.stop).error_code == 0
    assert all(expected_files(folder) == (set(), set()) for folder in tmp_path.iterdir())


def test_bad_requests_leave_no_file(kept, tmp_path):
    """A name that leaves the folder and metadata that is no JSON object are refused."""
    for fields, says in (
        ({'name': '../run'}, "name is '../run'; allowed"),
        ({'name': '.hidden'}, "name is '.hidden'; allowed"),
        ({'name': 'n' * 101}, 'up to 100 letters'),
        ({'metadata_json': '[1]'}, 'allowed: a JSON object'),
        ({'metadata_json': '{'}, 'allowed: a JSON object'),
    ):
        answer = kept.call(kept.start, **fields)
        assert answer.error_code == ErrorCode.INVALID_PARAMETER
        assert says in answer.error_msg
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_named(kept, tmp_path):
    """The answer names the folder; the recorder stays up and answers again."""
    (tmp_path / 'file').touch()
    kept.set_parameters(run_dir=str(tmp_path / 'file' / 'runs'))
    for _ in range(2):
        answer = kept.call(kept.start, name='run')
        assert answer.error_code == ErrorCode.RECORDER_MISSING
        assert answer.error_msg.startswith(
            f'run_dir is {tmp_path}/file/runs; it cannot be written'
        )


def test_a_mesh_that_cannot_be_read_is_told_and_the_run_recorded(kept, tmp_path):
    """An event names the file; everything else is as ever."""
    started = kept.call(kept.start, name='run', mesh_file=f'{tmp_path}/none.stl')
    assert started.error_code == 0
    kept.spin_until(lambda: any('none.stl' in event.text for event in kept.events))
    assert kept.call(kept.stop).error_code == 0
    texts = [event.text for event in Run.open(started.file).events]
    assert any('cannot be kept in the record: No such file' in text for text in texts)


def test_a_huge_message_is_left_out_and_told(kept):
    """Over the limit: an event, an error in diagnostics and in the answer; the rest is there."""
    kept.set_parameters(max_message_size=50_000)
    try:
        kept.statuses.clear()
        started = kept.call(kept.start, name='run')
        kept.setpoints[0].publish(make_chunk(0))
        kept.setpoints[0].publish(make_chunk(25, size=2000))  # of 96 kB
        kept.setpoints[1].publish(make_chunk(0))
        kept.spin_until(
            lambda: any(status.level == DiagnosticStatus.ERROR for status in kept.statuses)
        )
        answer = kept.call(kept.stop, expected_setpoints=[25, 25, 0])
    finally:
        kept.set_parameters(max_message_size=100_000_000)
    left_out = 'messages larger than 0.05 MB are left out: 1 of /kept/finger_1/setpoints'
    assert (answer.error_code, answer.error_msg) == (ErrorCode.RECORDER_MISSING, left_out)
    run = Run.open(started.file)
    assert (run.finished, run.end) == (True, left_out)
    assert [len(run.fingers[finger].setpoint_um) for finger in (1, 2)] == [25, 25]
    assert left_out in [event.text for event in run.events]


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


def test_stop_waits_for_setpoints_under_way_and_blocks_nothing(kept):
    """While a stop waits, other services answer and messages are recorded; then it completes."""
    kept.call(kept.start, name='run')
    stopping = kept.send(kept.stop, expected_setpoints=[50, 0, 0])
    kept.setpoints[0].publish(make_chunk(0))
    assert kept.call(kept.start, name='other').error_code == ErrorCode.BUSY
    assert kept.call(kept.stop).error_code == ErrorCode.NOT_ALLOWED
    assert not stopping.done()
    kept.setpoints[0].publish(make_chunk(25))
    kept.spin_until(stopping.done)
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


@pytest.mark.parametrize('moment', ['at once', 'in the middle', 'while the file is closed'])
def test_a_killed_recorder_leaves_what_it_had_received(station, start_recorder, tmp_path, moment):
    """SIGKILL under full load: every setpoint sent more than 100 ms before is recovered."""
    process = start_recorder()
    started = station.call(station.start, name='run')
    begin_s, sent_s = time.monotonic(), []
    # the machine must be able to follow, or the test is of the machine: five chunks on time
    on_time = 0
    while len(sent_s) < (2 if moment == 'at once' else 20) or on_time < min(5, len(sent_s)):
        assert len(sent_s) < 400, 'the machine is too busy to send a run on time'
        late_s = time.monotonic() - begin_s - 0.05 * len(sent_s)
        on_time = on_time + 1 if late_s < 0.02 else 0
        sent_s.append(time.monotonic())
        stream(station, begin_s, len(sent_s) - 1)
    if moment == 'while the file is closed':
        station.send(station.stop, expected_setpoints=[25 * len(sent_s)] * 3)
        until_s = time.monotonic() + 0.11
        station.spin_until(lambda: time.monotonic() > until_s)
    killed_s = time.monotonic()
    process.kill()
    process.communicate(timeout=DEADLINE_S)
    recover(started.file, tmp_path / 'out.mcap')
    due = 3 * 25 * sum(killed_s - time_s > 0.1 for time_s in sent_s)
    found = setpoints_by_mcap(tmp_path / 'out.mcap')
    for finger in (1, 2, 3):
        assert len(found[finger]) >= due > 0
        expected = [1e-9 * k for k in range(len(found[finger]))]
        assert found[finger] == pytest.approx(expected, rel=1e-12, abs=0)


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
    assert any(
        status.level == DiagnosticStatus.ERROR and 'ends early after' in status.message
        for status in station.statuses
    )
    assert os.path.getsize(started.file) <= 1 << 22
    run = Run.open(started.file)
    assert not run.finished
    assert len(run.fingers[1].setpoint_um) == answer.recorded_setpoints[0] >= 40_000
    assert station.call(station.start, name='next').error_code == 0
