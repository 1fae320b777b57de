# SPDX-License-Identifier: Apache-2.0
"""Replaying over DDS: what subscribers get is what was recorded, in its order and at its pace."""

import itertools
import json
import os
import pty
import random
import subprocess
import sys
import threading
import time

import pytest
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, TransformStamped
from microhand_msgs_py.msg import Plan, SequencerState, SetpointChunk, StageState
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock

from microhand_node.qos import LATCHED, SETPOINTS, STATE
from microhand_planner.core.errors import BadRequest, InvalidParameter
from microhand_station.analysis.record_index import record_index
from microhand_station.recording.recorded_topics import offered_qos_yaml
from microhand_station.recording.recover import recover
from microhand_station.recording.ros2msg_schema import ros2msg_schema
from microhand_station.recording.run_writer import RunWriter
from microhand_station.replay.offered_qos import offered_qos
from microhand_station.replay.player import Player, Wishes
from microhand_station.replay.stamps import StampShift

DEADLINE_S = 60.0
START_NS = 1_700_000_000_000_000_000
TOPICS = {
    '/plan': (Plan, LATCHED),
    '/sequencer/state': (SequencerState, LATCHED),
    '/finger_1/setpoints': (SetpointChunk, SETPOINTS),
    '/finger_1/state': (StageState, STATE),
    '/diagnostics': (DiagnosticArray, STATE),
}
COUNT = 40
PERIOD_S = 0.02


def stamp(seconds):
    """Return a time so many seconds after the start of the record."""
    sec, nanosec = divmod(START_NS + round(seconds * 1e9), 10**9)
    return Time(sec=sec, nanosec=nanosec)


def nanoseconds(time_of):
    """Return a time as nanoseconds."""
    return time_of.sec * 10**9 + time_of.nanosec


@pytest.fixture(scope='module')
def short(tmp_path_factory):
    """Return a record of 0.8 s: a plan, then setpoints, states and diagnostics by turns."""
    path = tmp_path_factory.mktemp('replay') / 'short.mcap'
    writer = RunWriter(path.open('xb'), {'run': 'short'})
    for topic, (kind, qos) in TOPICS.items():
        name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
        writer.add_topic(topic, name, ros2msg_schema(name), offered_qos_yaml(qos))

    def write(topic, seconds, message):
        time_ns = START_NS + round(seconds * 1e9)
        writer.write(topic, serialize_message(message), time_ns, time_ns)

    write('/plan', 0.0, Plan(object_name='first'))
    write('/plan', 0.01, Plan(object_name='second'))
    for number in range(COUNT):
        seconds = 0.02 + PERIOD_S * number
        chunk = SetpointChunk(sequence=number, period=0.002, positions=[1e-6 * number] * 3)
        chunk.velocities = [0.0] * 3
        chunk.header.stamp = stamp(seconds + 0.1)  # setpoints are sent ahead of time
        write('/finger_1/setpoints', seconds, chunk)
        state = StageState(received=number, position=Point(x=1e-6 * number))
        state.header.stamp = stamp(seconds - 0.003)
        write('/finger_1/state', seconds, state)
        if number % 10 == 0:
            found = DiagnosticArray(status=[DiagnosticStatus(name=str(number))])
            found.header.stamp = stamp(seconds)
            write('/diagnostics', seconds, found)
    writer.close('complete')
    return path


class Listener:
    """Subscribes to replayed topics; keeps what arrives, in the order of arrival."""

    def __init__(self, names, prefix=''):
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node('listener', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.got = []
        for name in names:
            kind, offered = (Clock, STATE) if name == '/clock' else TOPICS[name]
            self.node.create_subscription(
                kind,
                prefix + name,
                lambda message, name=name: self.got.append((name, message)),
                # deep: what a listener that is kept waiting loses is no fault of a replay
                QoSProfile(
                    depth=1000, durability=offered.durability, reliability=offered.reliability
                ),
            )

    def of(self, name):
        """Return the messages of a topic."""
        return [message for topic, message in self.got if topic == name]

    def spin_until(self, done):
        """Work until `done()`, but not longer than the deadline."""
        give_up_s = time.monotonic() + DEADLINE_S
        while not done():
            assert time.monotonic() < give_up_s, f'the deadline has passed; got {len(self.got)}'
            self.executor.spin_once(timeout_sec=0.05)

    def close(self):
        """Leave the ROS graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def listen():
    """Return a function that makes listeners; they are closed at the end."""
    made = []

    def make(*names, prefix=''):
        made.append(Listener(names, prefix))
        return made[-1]

    yield make
    for listener in made:
        listener.close()


def replay(path, listener, **wishes):
    """Replay in a thread while the listener works; return what was played."""
    played = []
    wishes.setdefault('wait_s', 10.0)
    player = Player(path, record_index(path), Wishes(**wishes))
    thread = threading.Thread(target=lambda: played.append(player.play()))
    thread.start()
    listener.spin_until(lambda: not thread.is_alive())
    thread.join()
    return played[0]


def test_everything_arrives_once_and_in_the_order_of_each_topic(short, listen):
    """All messages of all topics, with the content that was recorded."""
    listener = listen(*TOPICS)
    played = replay(short, listener, rate=20.0)
    total = 2 + 2 * COUNT + 4
    listener.spin_until(lambda: len(listener.got) >= total)
    assert (played.messages, played.rounds, played.left_out) == (total, 1, {})
    assert [plan.object_name for plan in listener.of('/plan')] == ['first', 'second']
    assert [chunk.sequence for chunk in listener.of('/finger_1/setpoints')] == list(range(COUNT))
    assert [state.received for state in listener.of('/finger_1/state')] == list(range(COUNT))


@pytest.mark.parametrize('rate', [0.8, 3.0])
def test_stamps_are_moved_to_now_and_keep_their_distances(short, listen, rate):
    """Divided by the rate, to a microsecond: between messages, and between stamp and sending."""
    listener = listen('/finger_1/state', '/finger_1/setpoints', '/diagnostics')
    before_ns = time.time_ns()
    replay(
        short, listener, rate=rate, topics=['/finger_1/state', 'finger_1/setpoints', 'diagnostics']
    )
    after_ns = time.time_ns()
    listener.spin_until(lambda: len(listener.got) == 2 * COUNT + 4)
    states, chunks, found = (
        [nanoseconds(message.header.stamp) for message in listener.of(name)]
        for name in ('/finger_1/state', '/finger_1/setpoints', '/diagnostics')
    )
    period_ns = PERIOD_S * 1e9 / rate
    for stamps in (states, chunks):
        assert len(stamps) == COUNT
        for one, other in itertools.pairwise(stamps):
            assert other - one == pytest.approx(period_ns, abs=1000)
    ahead_ns = [chunk - state for chunk, state in zip(chunks, states, strict=True)]
    assert ahead_ns == pytest.approx([0.103e9 / rate] * COUNT, abs=1000)
    assert found[1] - found[0] == pytest.approx(10 * period_ns, abs=1000)
    assert before_ns < found[0] < found[-1] <= after_ns


def test_with_a_clock_times_stay_and_the_clock_runs_along(short, listen):
    """Stamps as recorded; /clock runs from the first message to the last, and never goes back."""
    listener = listen('/clock', '/finger_1/state')
    replay(short, listener, rate=4.0, clock=True, topics=['/finger_1/state'])
    listener.spin_until(lambda: len(listener.of('/finger_1/state')) == COUNT)
    stamps = [nanoseconds(state.header.stamp) for state in listener.of('/finger_1/state')]
    expected = [START_NS + round((0.017 + PERIOD_S * k) * 1e9) for k in range(COUNT)]
    assert stamps == pytest.approx(expected, abs=1)
    last_ns = START_NS + round((0.02 + PERIOD_S * (COUNT - 1)) * 1e9)
    clock = [nanoseconds(message.clock) for message in listener.of('/clock')]
    assert clock == sorted(clock)
    assert START_NS < clock[0] < clock[-1] < last_ns + 10**9


def test_a_later_start_shows_what_was_latched_before(short, listen):
    """From 0.4 s on: the last plan first, then what was recorded from there, below a namespace."""
    listener = listen('/plan', '/finger_1/state', prefix='/again')
    wanted = ['/plan', '/finger_1/state']
    replay(short, listener, rate=20.0, start_s=0.4, namespace='again', topics=wanted)
    listener.spin_until(lambda: len(listener.got) == 1 + COUNT - 19)
    states = [state.received for state in listener.of('/finger_1/state')]
    assert states == list(range(19, COUNT))
    assert listener.got[0][0] == '/plan'
    assert [plan.object_name for plan in listener.of('/plan')] == ['second']


def test_rounds_follow_each_other_in_a_loop(short, listen):
    """After the last message the first comes again; stamps go on."""
    listener = listen('/finger_1/state')
    player = Player(
        short,
        record_index(short),
        Wishes(rate=20.0, loop=True, wait_s=10.0, topics=['/finger_1/state']),
        on_time=lambda *_: setattr(
            player,
            '_ended',
            len(listener.got) > 2 * COUNT,  # what the key q does
        ),
    )
    thread = threading.Thread(target=player.play)
    thread.start()
    listener.spin_until(lambda: not thread.is_alive())
    listener.spin_until(lambda: len(listener.got) >= 2 * COUNT)
    received = [state.received for state in listener.of('/finger_1/state')]
    assert received[: 2 * COUNT] == 2 * list(range(COUNT))
    stamps = [nanoseconds(state.header.stamp) for state in listener.of('/finger_1/state')]
    assert stamps == sorted(stamps)


def test_publishers_offer_what_was_offered(short, listen):
    """Reliable, and transient local where it was: as the nodes of a station see it."""
    listener = listen('/plan', '/finger_1/state', prefix='/seen')
    seen = {}

    def look(*_):
        for name in ('/plan', '/finger_1/state'):
            for info in listener.node.get_publishers_info_by_topic(f'/seen{name}'):
                seen[name] = info.qos_profile

    player = Player(
        short,
        record_index(short),
        Wishes(namespace='seen', wait_s=10.0, topics=['/plan', '/finger_1/state']),
        on_time=look,
    )
    thread = threading.Thread(target=player.play)
    thread.start()
    listener.spin_until(lambda: not thread.is_alive())
    assert seen['/plan'].durability is DurabilityPolicy.TRANSIENT_LOCAL
    assert seen['/finger_1/state'].durability is DurabilityPolicy.VOLATILE
    assert {qos.reliability for qos in seen.values()} == {ReliabilityPolicy.RELIABLE}


def test_no_stage_is_moved(short, listen):
    """Where a driver listens to setpoints nothing is published; elsewhere it may be."""
    driver = listen('/finger_1/setpoints')
    driver.node.create_publisher(StageState, '/finger_1/state', STATE)
    index = record_index(short)
    refused = []

    def play():
        try:
            Player(short, index, Wishes(wait_s=2.0)).play()
        except BadRequest as error:
            refused.append(str(error))

    thread = threading.Thread(target=play)
    thread.start()
    driver.spin_until(lambda: not thread.is_alive())
    assert 'a stage driver listens there: it would move' in refused[0]
    assert driver.got == []


def test_keys_pause_step_and_end(short, listen):
    """On a terminal: the first message comes, then space, two times n, and q: three in all."""
    listener = listen('/finger_1/state')
    ours, theirs = pty.openpty()
    command = [sys.executable, '-m', 'microhand_station.cli.app', 'replay', str(short), '--json']
    options = ['--topic', 'finger_1/state', '--start', '0.02', '--rate', '0.001', '--wait', '10']
    with subprocess.Popen([*command, *options], stdin=theirs, stdout=subprocess.PIPE) as process:
        os.close(theirs)
        listener.spin_until(lambda: len(listener.got) == 1)
        # at this rate the second is due 20 s after the first
        os.write(ours, b' nn')
        listener.spin_until(lambda: len(listener.got) == 3)
        os.write(ours, b'q')
        assert process.wait(timeout=DEADLINE_S) == 0
        played = json.loads(process.stdout.read())
    os.close(ours)
    assert played['messages'] == 3
    assert [state.received for state in listener.of('/finger_1/state')] == [0, 1, 2]


def test_a_broken_record_is_replayed_as_far_as_it_goes(short, listen, tmp_path):
    """Cut in the middle of the last messages: those before the cut arrive."""
    broken = tmp_path / 'broken.mcap'
    broken.write_bytes(short.read_bytes()[: short.stat().st_size // 2])
    listener = listen('/finger_1/state')
    played = replay(broken, listener, rate=20.0, topics=['/finger_1/state'])
    listener.spin_until(lambda: len(listener.got) == played.messages)
    received = [state.received for state in listener.of('/finger_1/state')]
    assert 5 < played.messages < COUNT
    assert received == list(range(played.messages))


@pytest.mark.parametrize(
    ('wishes', 'says'),
    [
        ({'rate': 0.0}, 'rate is 0'),
        ({'rate': -1.0}, 'rate is -1'),
        ({'start_s': -1.0}, 'start is -1'),
    ],
)
def test_impossible_wishes_are_refused(wishes, says):
    """Zero and negative numbers, by name."""
    with pytest.raises(InvalidParameter, match=says):
        Wishes(**wishes)


def test_other_definitions_of_a_type_are_not_published(tmp_path, listen):
    """What was recorded with other fields would be misread: it is left out, and said."""
    path = tmp_path / 'old.mcap'
    writer = RunWriter(path.open('xb'), {})
    schema = ros2msg_schema('microhand_msgs_py/msg/StageState')
    writer.add_topic('/old', 'microhand_msgs_py/msg/StageState', f'{schema}bool more\n', '')
    writer.add_topic('/gone', 'no_such_msgs/msg/Thing', 'bool x\n', '')
    name = 'microhand_msgs_py/msg/RunEvent'
    writer.add_topic('/events', name, ros2msg_schema(name), '')
    from microhand_msgs_py.msg import RunEvent

    for topic, message in (('/old', StageState()), ('/gone', Time()), ('/events', RunEvent())):
        writer.write(topic, serialize_message(message), 5, 5)
    writer.close('complete')
    played = Player(path, record_index(path), Wishes(wait_s=0.0)).play()
    assert played.messages == 1
    assert played.left_out['/old'].endswith('was recorded with another definition')
    assert played.left_out['/gone'] == 'no_such_msgs/msg/Thing is not installed'


def test_times_inside_of_messages_are_moved_too():
    """Transforms have headers in a list: each is moved; a time of zero was never set."""
    found = DiagnosticArray()
    found.header.stamp = Time(sec=10, nanosec=5)
    cdr = serialize_message(found)
    moved = deserialize_message(
        StampShift(DiagnosticArray).shifted(cdr, lambda ns: ns + 7), DiagnosticArray
    )
    assert (moved.header.stamp.sec, moved.header.stamp.nanosec) == (10, 12)
    transform = TransformStamped()
    transform.header.stamp = Time(sec=3)
    shift = StampShift(TransformStamped)
    moved = deserialize_message(
        shift.shifted(serialize_message(transform), lambda ns: 2 * ns), TransformStamped
    )
    assert moved.header.stamp.sec == 6
    still = serialize_message(TransformStamped())
    assert shift.shifted(still, lambda ns: ns + 1) == still


def test_offered_qos_survives_nonsense():
    """Damaged YAML, other types and unknown words give the defaults."""
    for text in (
        '',
        '{',
        '[1, 2]',
        '- depth: -3\n  reliability: perhaps',
        'null',
        '- {depth: [1]}',
    ):
        profile = offered_qos(text)
        assert profile.depth == 10
        assert profile.reliability is ReliabilityPolicy.RELIABLE
    best = QoSProfile(depth=3, reliability=ReliabilityPolicy.BEST_EFFORT)
    assert offered_qos(offered_qos_yaml(best)).reliability is ReliabilityPolicy.BEST_EFFORT


def test_damaged_records_are_replayed_or_refused_in_a_line(short, tmp_path):
    """Random bytes flipped (seeded), as it was written and packed: never another error."""
    packed, bad = tmp_path / 'packed.mcap', tmp_path / 'bad.mcap'
    recover(short, packed)
    wishes = Wishes(rate=100.0, wait_s=0.0)
    played, refusals = 0, []
    for round_ in range(48):
        draw = random.Random(round_)  # of its own: the length of what is packed varies
        damaged = bytearray((short, packed)[round_ % 2].read_bytes())
        for _ in range((1, 20, 300)[round_ % 3]):
            damaged[draw.randrange(8, len(damaged))] = draw.randrange(256)
        bad.write_bytes(damaged)
        try:
            played += Player(bad, record_index(bad), wishes).play().messages > 0
        except BadRequest as error:
            refusals.append(str(error))
    assert played > 20
    assert not any('\n' in refusal for refusal in refusals)
