# SPDX-License-Identifier: Apache-2.0
"""Record files: what is written comes back in two independent readers, and after a crash."""

import itertools
import os
import random
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from microhand_msgs_py.msg import SetpointChunk
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2.metadata import dump_qos_v9

from microhand_planner.core.errors import BadRequest
from microhand_station.recording.recorded_topics import offered_qos_yaml, recorded_topics
from microhand_station.recording.recover import recover
from microhand_station.recording.ros2msg_schema import ros2msg_schema
from microhand_station.recording.run_writer import RunWriter

TOPIC = '/finger_1/setpoints'
TYPE = 'microhand_msgs_py/msg/SetpointChunk'
FOREVER = QosTime(9223372036, 854775807)


def chunk_cdr(sequence):
    """Return a serialized chunk of two setpoints that start with number `sequence`."""
    positions = [1e-6 * (sequence + k) for k in range(6)]
    return serialize_message(
        SetpointChunk(
            sequence=sequence, stream=7, period=0.002, positions=positions, velocities=[0.0] * 6
        )
    )


def open_writer(path):
    """Open a writer with one announced topic."""
    writer = RunWriter(path.open('xb'), {'run': 'test', 'metadata_json': '{"a": 1}'})
    (topic,) = (topic for topic in recorded_topics([1]) if topic.finger == 1)
    writer.add_topic(TOPIC, TYPE, ros2msg_schema(TYPE), offered_qos_yaml(topic.qos))
    return writer


def write_run(path, chunks):
    """Write a finished file, one chunk per millisecond; return its size after each of them."""
    writer = open_writer(path)
    sizes = []
    for number in range(chunks):
        writer.write(TOPIC, chunk_cdr(2 * number), 10**18 + 10**6 * number, 10**18 + number)
        sizes.append(path.stat().st_size)
    writer.close('complete')
    return sizes


def read_by_mcap(path):
    """Log time, publish time and message of each chunk, by mcap-ros2-support."""
    with path.open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [
            (message.log_time, message.publish_time, chunk)
            for _, _, message, chunk in reader.iter_decoded_messages(topics=[TOPIC])
        ]


def read_by_rosbags(path):
    """Log time and message of each chunk, by rosbags."""
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic == TOPIC]
        return [
            (time, reader.deserialize(raw, connection.msgtype))
            for connection, time, raw in reader.messages(connections)
        ]


def test_both_readers_return_what_was_written_in_order(tmp_path):
    """Times, numbers and positions of every chunk come back from two unrelated readers."""
    path = tmp_path / 'run.mcap'
    write_run(path, 200)
    by_mcap, by_rosbags = read_by_mcap(path), read_by_rosbags(path)
    assert [chunk.sequence for _, _, chunk in by_mcap] == list(range(0, 400, 2))
    assert [time for time, _, _ in by_mcap] == [10**18 + 10**6 * k for k in range(200)]
    assert [time for _, time, _ in by_mcap] == [10**18 + k for k in range(200)]
    assert [time for time, _ in by_rosbags] == [time for time, _, _ in by_mcap]
    for (_, _, one), (_, other), number in zip(by_mcap, by_rosbags, range(200), strict=True):
        expected = [1e-6 * (2 * number + k) for k in range(6)]
        assert list(one.positions) == expected
        assert list(other.positions) == expected


def test_file_follows_the_ros2_profile(tmp_path):
    """Profile, encodings, QoS, statistics and metadata are where other tools look for them."""
    path = tmp_path / 'run.mcap'
    write_run(path, 3)
    with path.open('rb') as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    (channel,), (schema,) = summary.channels.values(), summary.schemas.values()
    assert (channel.topic, channel.message_encoding) == (TOPIC, 'cdr')
    assert (schema.name, schema.encoding) == (TYPE, 'ros2msg')
    assert summary.statistics.message_count == 3
    assert metadata['microhand_run'] == {'run': 'test', 'metadata_json': '{"a": 1}'}
    assert metadata['microhand_end'] == {'end': 'complete'}
    (profile,) = yaml.safe_load(channel.metadata['offered_qos_profiles'])
    theirs = Qos(
        QosHistory.KEEP_LAST,
        profile['depth'],
        QosReliability.RELIABLE,
        QosDurability.VOLATILE,
        FOREVER,
        FOREVER,
        QosLiveliness.SYSTEM_DEFAULT,
        FOREVER,
        False,
    )
    assert [profile] == dump_qos_v9([theirs])


def test_log_times_never_run_backwards(tmp_path):
    """A clock set back in the middle of a run does not put messages out of order."""
    path = tmp_path / 'run.mcap'
    writer = open_writer(path)
    for number, time_ns in enumerate((100, 90, 110)):
        writer.write(TOPIC, chunk_cdr(number), time_ns, time_ns)
    writer.close('complete')
    times = [(log, published) for log, published, _ in read_by_mcap(path)]
    assert times == [(100, 100), (100, 90), (110, 110)]


def test_attachment_comes_back(tmp_path):
    """A mesh kept in the record is read back byte for byte, also after `recover`."""
    path = tmp_path / 'run.mcap'
    writer = open_writer(path)
    writer.attach('object.stl', 'model/stl', b'solid' * 1000, 5)
    writer.abandon()
    recover(path, tmp_path / 'out.mcap')
    with (tmp_path / 'out.mcap').open('rb') as stream:
        (attachment,) = make_reader(stream).iter_attachments()
    assert (attachment.name, attachment.data) == ('object.stl', b'solid' * 1000)


@pytest.mark.parametrize('enough', [1, 40, 700, 3000])
def test_kill_loses_no_message_that_was_written(tmp_path, enough):
    """SIGKILL at any moment: every message whose `write` had returned is recovered, in order."""
    path, out = tmp_path / 'run.mcap', tmp_path / 'out.mcap'
    code = (
        'import itertools, sys; from pathlib import Path; sys.path.insert(0, sys.argv[2])\n'
        'import test_recording_file as t; writer = t.open_writer(Path(sys.argv[1]))\n'
        'for k in itertools.count():\n'
        '    writer.write(t.TOPIC, t.chunk_cdr(2 * k), k, k); print(k, flush=True)\n'
    )
    command = [sys.executable, '-c', code, str(path), str(Path(__file__).parent)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            if int(line) + 1 >= enough:
                break
        os.kill(process.pid, signal.SIGKILL)
        written = enough + len(process.stdout.read().splitlines())
    count = recover(path, out)
    assert count >= written
    assert [chunk.sequence for _, _, chunk in read_by_mcap(out)] == list(range(0, 2 * count, 2))
    assert [chunk.sequence for _, chunk in read_by_rosbags(out)] == list(range(0, 2 * count, 2))


def test_cut_anywhere_keeps_every_whole_message(tmp_path):
    """A file cut at any place yields exactly the messages that end before the cut."""
    path, cut, out = (tmp_path / name for name in ('run.mcap', 'cut.mcap', 'out.mcap'))
    ends = write_run(path, 4)
    data = path.read_bytes()
    everywhere, in_a_message = range(8, len(data), 41), range(ends[1] - 3, ends[2] + 3)
    for length in itertools.chain(everywhere, in_a_message):
        cut.write_bytes(data[:length])
        assert recover(cut, out) == sum(end <= length for end in ends)
        out.unlink()


def test_damaged_bytes_never_crash_and_leave_a_good_file(tmp_path):
    """Random bytes flipped (seed 1): the copy always opens, with no more messages than written."""
    path, bad, out = (tmp_path / name for name in ('run.mcap', 'bad.mcap', 'out.mcap'))
    write_run(path, 30)
    data = path.read_bytes()
    draw = random.Random(1)
    for _ in range(300):
        damaged = bytearray(data)
        for _ in range(draw.choice((1, 5, 50))):
            damaged[draw.randrange(8, len(data))] = draw.randrange(256)
        bad.write_bytes(damaged)
        count = recover(bad, out)
        with out.open('rb') as stream:
            assert len(list(make_reader(stream).iter_messages())) == count <= 30
        out.unlink()


def test_one_flipped_byte_costs_two_messages_at_most(tmp_path):
    """Damage in the length of a record, too, costs that record and its neighbour, not the rest."""
    path, bad, out = (tmp_path / name for name in ('run.mcap', 'bad.mcap', 'out.mcap'))
    ends = write_run(path, 6)
    data = path.read_bytes()
    for place in range(ends[0], ends[4]):
        damaged = bytearray(data)
        damaged[place] ^= 0x41
        bad.write_bytes(damaged)
        assert 4 <= recover(bad, out) <= 6, f'byte {place}'
        out.unlink()


def test_a_damaged_chunk_costs_its_own_messages_only(tmp_path):
    """Of a chunked file with broken chunks, the messages of all other chunks come back.

    Also without the first chunk, which defines schemas and channels: the summary repeats them.
    """
    path, out = tmp_path / 'chunked.mcap', tmp_path / 'out.mcap'
    starts = []
    with path.open('xb') as stream:
        writer = Writer(stream)
        writer.start('ros2')
        channel = writer.register_channel(
            't', 'cdr', writer.register_schema('a', 'ros2msg', b'int8 x')
        )
        for k in range(30):
            writer.add_message(channel, k, random.Random(k).randbytes(100), k)
            if k % 10 == 9:
                writer.flush()
                starts.append(stream.tell())
        writer.finish()
    data = bytearray(path.read_bytes())
    for damaged, left in (
        (starts[0] + 200, 20),
        (starts[0] - 600, 10),
    ):  # the second, then also the first
        data[damaged] ^= 0xFF
        path.write_bytes(data)
        assert recover(path, out) == left
        out.unlink()


def test_a_whole_record_is_copied_whole(tmp_path):
    """Recovering a finished file changes nothing but its layout; progress ends at the total."""
    path, out = tmp_path / 'run.mcap', tmp_path / 'out.mcap'
    write_run(path, 50)
    steps = []
    assert recover(path, out, lambda done, total: steps.append((done, total))) == 50
    one, other = read_by_mcap(path), read_by_mcap(out)
    assert [a[:2] for a in one] == [b[:2] for b in other]
    assert [list(a[2].positions) for a in one] == [list(b[2].positions) for b in other]
    assert steps == sorted(steps)
    assert steps[-1][0] <= steps[-1][1] == path.stat().st_size


@pytest.mark.parametrize(
    ('content', 'says'),
    [(b'', 'empty'), (b'\x89MCAP', 'otherwise'), (b'solid ellipsoid', 'otherwise')],
)
def test_what_is_no_mcap_file_is_refused(tmp_path, content, says):
    """An empty, a too short and a foreign file are named in one line; nothing is written."""
    path, out = tmp_path / 'bad.mcap', tmp_path / 'out.mcap'
    path.write_bytes(content)
    with pytest.raises(BadRequest, match=f'bad.mcap; allowed: an mcap file; .*{says}') as caught:
        recover(path, out)
    assert '\n' not in str(caught.value)
    assert not out.exists()


def test_neither_input_nor_an_existing_file_is_overwritten(tmp_path):
    """Input as output, an existing output, missing files and folders: refused, untouched."""
    path, other = tmp_path / 'run.mcap', tmp_path / 'other.mcap'
    write_run(path, 3)
    shutil.copy(path, other)
    before = path.read_bytes()
    for out in (path, other, tmp_path / 'no' / 'folder' / 'out.mcap'):
        with pytest.raises(BadRequest, match='output is'):
            recover(path, out)
    with pytest.raises(BadRequest, match='record is'):
        recover(tmp_path / 'none.mcap', tmp_path / 'out.mcap')
    assert path.read_bytes() == other.read_bytes() == before
