# SPDX-License-Identifier: Apache-2.0
"""Reading a run back and reporting on it, from files with contents known by construction."""

import math
import random
from html.parser import HTMLParser

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
from microhand_station.recording.report import write_report
from microhand_station.recording.ros2msg_schema import ros2msg_schema
from microhand_station.recording.run_reader import Run
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
    np.testing.assert_allclose(run.object.time_s, 0.5 + 0.02 * np.arange(40), atol=1e-9)
    np.testing.assert_allclose(np.radians(run.object.angle_deg), 1e-3 * np.arange(40))
    np.testing.assert_allclose(run.object.distance_um, 2e-3 * np.arange(40), atol=1e-12)
    assert run.plan['object_name'] == 'ellipsoid'
    assert run.plan['steps'][0]['tip_positions'] == [1e-6] * 9
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
    for _ in range(100):
        damaged = bytearray(data)
        for _ in range(20):
            damaged[draw.randrange(8, len(data))] = draw.randrange(256)
        (tmp_path / 'bad.mcap').write_bytes(damaged)
        run = Run.open(tmp_path / 'bad.mcap')
        assert sum(run.counts.values()) <= 263
        write_report(run, tmp_path / 'bad.html', {})


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


class Page(HTMLParser):
    """Texts, tags and polylines of a page; checks that tags are closed in order."""

    VOID = frozenset({'meta', 'polyline', 'path', '!doctype'})

    def __init__(self, path):
        super().__init__()
        self.open, self.tags, self.texts, self.lines = [], [], [], []
        self.feed(path.read_text(encoding='utf-8'))
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        """Note the tag."""
        self.tags.append((tag, dict(attrs)))
        if tag == 'polyline':
            self.lines.append(dict(attrs)['points'])
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        """Check that it closes the tag opened last."""
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        """Note the text."""
        self.texts.append(data)


SUMMARY = {
    'object': 'examples/ellipsoid.stl',
    'request': 'R(z, 80°) R(y, 220°) R(z, 100°)',
    'cost_deg': 2280.0,
    'reconfigurations': 12,
    'rotations': [
        {'axis': 'z', 'angle_deg': 80.0, 'cost_deg': 520.0, 'reconfigurations': 2, 'time_s': 0.1}
    ],
    'held': None,
    'final_error_deg': None,
}


def test_report_says_what_is_in_the_record(tmp_path):
    """Figures, errors and what nobody judged stand on the page; hostile text stays text."""
    write_report(Run.open(write(tmp_path / 'run.mcap')), tmp_path / 'report.html', SUMMARY)
    page = Page(tmp_path / 'report.html')
    assert page.texts.count('not judged') == 2
    for text in (HOSTILE, 'Run a <b> run', '500', '0.0500', '2280°', '303', '1.250', '12'):
        assert text in page.texts
    assert len(page.lines) == 2 + 6
    assert 'away from the plan [°]' in page.texts
    assert str(tmp_path / 'run.mcap') in page.texts


def test_report_is_self_contained(tmp_path):
    """No script, no link to anything outside the file."""
    write_report(Run.open(write(tmp_path / 'run.mcap')), tmp_path / 'report.html', SUMMARY)
    page = Page(tmp_path / 'report.html')
    assert not {tag for tag, _ in page.tags} & {'script', 'link', 'img', 'iframe', 'a'}
    assert not any(name in attributes for _, attributes in page.tags for name in ('src', 'href'))
    assert 'url(' not in (tmp_path / 'report.html').read_text(encoding='utf-8')


def test_plot_shows_the_swing(tmp_path):
    """The x line of the measured position crosses its mean where the sine does."""
    write_report(Run.open(write(tmp_path / 'run.mcap')), tmp_path / 'report.html', {})
    points = Page(tmp_path / 'report.html').lines[2].split()
    assert len(points) == 201
    x_px, y_px = np.array([point.split(',') for point in points], dtype=float).T
    wave = np.sin(2 * np.pi * np.linspace(0, 2, 201))
    assert np.corrcoef(wave, -y_px)[0, 1] > 0.99999
    assert (np.diff(x_px) > 0).all()


def test_report_of_an_unfinished_record_says_so(tmp_path):
    """A reader must not take half a run for a whole one."""
    write_report(Run.open(write(tmp_path / 'run.mcap', None)), tmp_path / 'report.html', {})
    texts = Page(tmp_path / 'report.html').texts
    assert any(text.startswith('The record was not finished') for text in texts)


def test_report_that_cannot_be_written_is_one_clear_line(tmp_path):
    """A folder that is not there is named."""
    run = Run.open(write(tmp_path / 'run.mcap'))
    with pytest.raises(
        BadRequest, match=r'report is .*none/report.html; allowed: a file that can'
    ):
        write_report(run, tmp_path / 'none' / 'report.html', {})
