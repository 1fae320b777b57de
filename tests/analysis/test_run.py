# SPDX-License-Identifier: Apache-2.0
"""Reading a run back, from files with contents known by construction."""

import math
import random

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from microhand_msgs_py.msg import (
    ObjectDeviation,
    Plan,
    PlanStep,
    RunEvent,
    SetpointChunk,
    StageState,
)
from rclpy.serialization import serialize_message

from microhand_planner.core.errors import BadRequest
from microhand_station.analysis.findings import findings
from microhand_station.analysis.run import Run
from microhand_station.recording.ros2msg_schema import ros2msg_schema
from microhand_station.recording.run_writer import RunWriter
from microhand_station.recording.setpoint_tally import SetpointTally

START_NS = 1_700_000_000_123_456_789
TOPICS = {
    '/lab/plan': Plan,
    '/lab/events': RunEvent,
    '/lab/finger_1/setpoints': SetpointChunk,
    '/lab/finger_1/state': StageState,
    '/lab/finger_2/state': StageState,
    '/lab/sequencer/object_deviation': ObjectDeviation,
}
HOSTILE = '<script>alert("1")</script> & "so on"'


def stamp(seconds):
    """Return the time so many seconds after the start."""
    sec, nanosec = divmod(START_NS + round(seconds * 1e9), 10**9)
    return Time(sec=sec, nanosec=nanosec)


def messages():
    """Yield topic, seconds and message of a run of 2 s in which finger 1 moves for 1 s."""
    step = PlanStep(tip_positions=[1e-6] * 9, object_positions=[0.0] * 3)
    step.object_orientations, step.contact_normals = [0.0, 0.0, 0.0, 1.0], [math.nan] * 9
    yield '/lab/plan', 0.0, Plan(object_name='ellipsoid', steps=[step], cost=2.5)
    for number in range(20):
        chunk = SetpointChunk(sequence=25 * number, stream=3, period=0.002)
        chunk.header.stamp = stamp(0.5 + 0.05 * number)
        chunk.positions = [1e-9 * k for k in range(75 * number, 75 * (number + 1))]
        chunk.velocities = [0.0] * 75
        yield '/lab/finger_1/setpoints', 0.4 + 0.05 * number, chunk
    for number in range(201):
        seconds = 0.01 * number
        state = StageState(mode=StageState.STREAMING if 0.5 <= seconds < 1.5 else 1)
        state.header.stamp = stamp(seconds)
        swing_m = 5e-5 + 1e-5 * math.sin(2 * math.pi * seconds)
        state.command = Point(x=swing_m, y=2e-5, z=1e-6 * seconds)
        # 3-4-5: off by 50 nm while it streams, and by far more while it does not
        off_m = 1e-8 if state.mode == StageState.STREAMING else 1e-6
        state.position = Point(x=swing_m + 3 * off_m, y=2e-5 - 4 * off_m, z=1e-6 * seconds)
        yield '/lab/finger_1/state', seconds, state
    for number in range(40):
        off = ObjectDeviation(angle=1e-3 * number, distance=2e-9 * number)
        off.header.stamp = stamp(0.5 + 0.02 * number)
        yield '/lab/sequencer/object_deviation', 0.51 + 0.02 * number, off
    event = RunEvent(source=HOSTILE, error_code=303, text=HOSTILE)
    event.header.stamp = stamp(1.25)
    yield '/lab/events', 2.0, event


def write(path, end='complete'):
    """Write the run; an `end` of None leaves the file as a crash would."""
    writer = RunWriter(path.open('xb'), {'run': 'a <b> run', 'metadata_json': '{}'})
    for topic, message_type in TOPICS.items():
        name = f'microhand_msgs_py/msg/{message_type.__name__}'
        writer.add_topic(topic, name, ros2msg_schema(name), '')
    for topic, seconds, message in sorted(messages(), key=lambda item: item[1]):
        time_ns = START_NS + round(seconds * 1e9)
        writer.write(topic, serialize_message(message), time_ns, time_ns)
    if end is None:
        writer.abandon()
    else:
        writer.close(end)
    return path


@pytest.mark.parametrize('end', ['complete', None])
def test_everything_of_a_run_comes_back(tmp_path, end):
    """Setpoints, states, events, plan and counts, in µm and s; also from an unfinished file."""
    run = Run.open(write(tmp_path / 'run.mcap', end))
    assert (run.finished, run.end) == ((True, 'complete') if end else (False, ''))
    assert run.counts == {
        '/lab/plan': 1,
        '/lab/events': 1,
        '/lab/finger_1/setpoints': 20,
        '/lab/finger_1/state': 201,
        '/lab/finger_2/state': 0,
        '/lab/sequencer/object_deviation': 40,
    }
    assert run.start_ns == START_NS
    assert run.duration_s == pytest.approx(2.0, abs=1e-12)
    finger = run.fingers[1]
    np.testing.assert_allclose(finger.setpoint_um.ravel(), 1e-3 * np.arange(1500), atol=1e-12)
    np.testing.assert_allclose(finger.setpoint_time_s, 0.5 + 0.002 * np.arange(500), atol=1e-9)
    np.testing.assert_allclose(finger.state_time_s, 0.01 * np.arange(201), atol=1e-9)
    assert (finger.missing, finger.out_of_order) == (0, 0)
    assert finger.streaming.sum() == 100
    off = run.deviation
    np.testing.assert_allclose(off.time_s, 0.5 + 0.02 * np.arange(40), atol=1e-9)
    np.testing.assert_allclose(np.radians(off.angle_deg), 1e-3 * np.arange(40))
    np.testing.assert_allclose(off.distance_um, 2e-3 * np.arange(40), atol=1e-12)
    assert off.source == 'sequencer'
    (event,) = run.events
    assert (event.source, event.error_code, event.text) == (HOSTILE, 303, HOSTILE)
    assert event.time_s == pytest.approx(1.25, abs=1e-9)
    assert run.undecodable == 0


def test_tracking_error_counts_only_while_streaming(tmp_path):
    """3-4-5 triangle: 50 nm off in every state of the stream, whatever happened before it."""
    error = Run.open(write(tmp_path / 'run.mcap')).fingers[1].tracking_error
    assert error.rms_um == pytest.approx(0.05, rel=1e-9)
    assert error.max_um == pytest.approx(0.05, rel=1e-9)


def test_arrays_are_read_only(tmp_path):
    """What was recorded cannot be changed by accident."""
    finger = Run.open(write(tmp_path / 'run.mcap')).fingers[1]
    with pytest.raises(ValueError, match='read-only'):
        finger.measured_um[0, 0] = 0.0


def test_damaged_records_are_read_as_far_as_possible(tmp_path):
    """Random bytes flipped (seed 2): a run with no more than was written, never an exception."""
    data = write(tmp_path / 'run.mcap').read_bytes()
    draw = random.Random(2)
    refused = 0
    for _ in range(100):
        damaged = bytearray(data)
        for _ in range(20):
            damaged[draw.randrange(8, len(data))] = draw.randrange(256)
        (tmp_path / 'bad.mcap').write_bytes(damaged)
        try:
            run = Run.open(tmp_path / 'bad.mcap')
        except BadRequest:
            refused += 1
            continue
        assert sum(run.counts.values()) <= 263
        findings(run)
    assert refused < 10, 'a few bytes must not cost the whole record'


@pytest.mark.parametrize(
    ('chunks', 'result'),
    [
        ([(1, 0, 10), (1, 10, 10), (2, 0, 5)], (25, 0, 0)),
        ([(1, 0, 10), (1, 15, 10)], (20, 5, 0)),
        ([(1, 5, 10)], (10, 5, 0)),
        ([(1, 0, 10), (1, 0, 10)], (20, 0, 10)),
        ([(1, 0, 10), (1, 5, 10), (1, 15, 1)], (21, 0, 5)),
        ([(1, 0, 10), (1, 20, 10), (1, 10, 10)], (30, 10, 10)),
    ],
)
def test_tally_finds_gaps_and_repeats(chunks, result):
    """Counted by hand: gaps, repeated, overlapping and late chunks, a second stream."""
    tally = SetpointTally()
    for stream, first, size in chunks:
        tally.add(stream, first, size)
    assert (tally.count, tally.missing, tally.out_of_order) == result
    assert tally.complete == (result[1:] == (0, 0))
