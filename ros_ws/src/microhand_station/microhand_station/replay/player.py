# SPDX-License-Identifier: Apache-2.0
"""Publishes the messages of a record again: in their order, each when it is due."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from mcap.records import Channel, Message, Schema
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from microhand_planner.core.errors import BadRequest
from microhand_planner.core.parameters import check_number
from microhand_station.analysis.message_decoder import MessageDecoder
from microhand_station.analysis.record_index import RecordIndex
from microhand_station.recording.record_scan import scan_records
from microhand_station.replay.keyboard import Keyboard
from microhand_station.replay.pace import Pace
from microhand_station.replay.stamps import NS_PER_S
from microhand_station.replay.topics import Replayed, check_no_driver_listens, replayed_topics

CLOCK_PERIOD_S = 0.01
"""Of /clock, in wall time [s]."""
LOOK_S = 0.05
"""Keys are looked for no less often than this [s]."""
ACKNOWLEDGED_S = 2.0
"""Longest wait at the end for subscribers that have not taken everything yet [s]."""


@dataclass(frozen=True)
class Wishes:
    """How to replay.

    Parameters
    ----------
    rate : float
        So many times as fast as recorded.
    start_s : float
        Begin so long after the first message [s].
    loop : bool
        Begin anew at the end.
    clock : bool
        Publish /clock and leave all times as recorded; else times are moved to now.
    namespace : str
        Put before all names; empty: none.
    topics : collection of str
        Names; none: all.
    wait_s : float
        Wait so long for subscribers: no longer than until every topic has one [s].

    Raises
    ------
    InvalidNumber, InvalidParameter
        A number outside its range.
    """

    rate: float = 1.0
    start_s: float = 0.0
    loop: bool = False
    clock: bool = False
    namespace: str = ''
    topics: Collection[str] = ()
    wait_s: float = 1.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('rate', self.rate, low=0.0, high=1e3, low_open=True)
        check_number('start', self.start_s, low=0.0, high=1e9)
        check_number('wait', self.wait_s, low=0.0, high=3600.0)


@dataclass
class Played:
    """What was replayed.

    Attributes
    ----------
    messages : int
        Published, over all rounds.
    rounds : int
        Begun.
    topics : list of str
        On which was published.
    left_out : dict
        Why a topic of the record was not published, by name.
    """

    messages: int = 0
    rounds: int = 0
    topics: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


class Player:
    """Replays one record, in the thread that calls `play`.

    Keys, where there is a terminal: space pauses and goes on, n publishes the next message of a
    pause, q ends.

    Parameters
    ----------
    record : Path
        The mcap file, whole or broken.
    index : RecordIndex
        Of that file.
    wishes : Wishes
        How to replay.
    tell : callable
        Told what is worth knowing, as sentences.
    on_time : callable
        Told how far the record has come [s], several times a second, and whether it is paused.
    """

    def __init__(
        self,
        record: Path,
        index: RecordIndex,
        wishes: Wishes,
        tell: Callable[[str], None] = lambda text: None,
        on_time: Callable[[float, bool], None] = lambda reached_s, paused: None,
    ) -> None:
        self._record = record
        self._index = index
        self._wishes = wishes
        self._chosen = index.chosen(wishes.topics)
        self._tell = tell
        self._on_time = on_time
        self._played = Played()
        self._told_s = self._clock_s = 0.0
        self._clock_ns = 0
        # of the steady clock's zero, once: the system clock may be set while a record is replayed
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._clock: Any = None
        self._ended = False

    def play(self) -> Played:
        """Replay the record to its end.

        Raises
        ------
        BadRequest
            There is nothing to replay, or a stage driver would move.
        """
        if self._wishes.start_s > self._index.duration_s:
            allowed = f'up to {self._index.duration_s:.3f} s'
            raise BadRequest('start', f'{self._wishes.start_s:g} s', allowed)
        context = Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        try:
            node = Node(
                f'replay_{os.getpid()}',
                context=context,
                enable_rosout=False,
                start_parameter_services=False,
            )
            try:
                self._play(node)
            finally:
                node.destroy_node()
        finally:
            context.try_shutdown()
        return self._played

    def _play(self, node: Node) -> None:
        """Find subscribers, then publish round after round."""
        replayed, left_out = replayed_topics(node, self._chosen.values(), self._wishes.namespace)
        self._played.left_out = left_out
        self._played.topics = [topic.name for topic in replayed.values()]
        for name, why in left_out.items():
            self._tell(f'{name} is left out: {why}')
        if not any(self._index.counts.get(name, 0) for name in replayed):
            raise BadRequest('record', self._record, 'one with messages that can be replayed')
        if self._wishes.clock:
            self._clock = node.create_publisher(Clock, '/clock', QoSProfile(depth=10))
        self._await_subscribers(replayed)
        check_no_driver_listens(node, replayed.values())
        with Keyboard() as keyboard:
            while not self._ended:
                self._round(replayed, keyboard)
                self._ended |= not self._wishes.loop
        give_up_s = time.monotonic() + ACKNOWLEDGED_S
        for topic in replayed.values():
            left_s = max(0.0, give_up_s - time.monotonic())
            topic.publisher.wait_for_all_acked(Duration(seconds=left_s))

    def _await_subscribers(self, replayed: dict[str, Replayed]) -> None:
        give_up_s = time.monotonic() + self._wishes.wait_s
        waiting = list(replayed.values())
        while waiting and time.monotonic() < give_up_s:
            time.sleep(min(LOOK_S, max(0.0, give_up_s - time.monotonic())))
            waiting = [one for one in waiting if not one.publisher.get_subscription_count()]
        # a subscriber may learn of its publisher a moment later than the publisher of it
        time.sleep(min(LOOK_S, max(0.0, give_up_s - time.monotonic())))

    def _round(self, replayed: dict[str, Replayed], keyboard: Keyboard) -> None:
        """Publish the record once, from the wished start on."""
        self._played.rounds += 1
        self._clock_ns = 0
        begin_ns = self._index.start_ns + round(self._wishes.start_s * NS_PER_S)
        latched: dict[str, Message] = {}
        pace: Pace | None = None
        due_ns = begin_ns
        for name, message in self._messages():
            topic = replayed.get(name)
            if topic is None or not self._index.start_ns <= message.log_time <= self._index.end_ns:
                continue
            if message.log_time < begin_ns:
                # what a late subscriber would have seen at the start
                if topic.publisher.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL:
                    latched[name] = message
                continue
            if pace is None:
                pace = Pace(self._wishes.rate, begin_ns, time.monotonic())
                for latched_name, early in latched.items():
                    self._publish(replayed[latched_name], early, pace, begin_ns)
            # the order of the file counts, also where its times go back
            due_ns = max(due_ns, message.log_time)
            self._wait(pace, due_ns, keyboard)
            if self._ended:
                return
            self._publish(topic, message, pace, due_ns)

    def _messages(self) -> Iterator[tuple[str, Message]]:
        decoder = MessageDecoder()
        for record in scan_records(self._record):
            if isinstance(record, Schema | Channel):
                decoder.announce(record)
            elif isinstance(record, Message) and (topic := decoder.topic_of(record)) is not None:
                yield topic.name, record

    def _wait(self, pace: Pace, due_ns: int, keyboard: Keyboard) -> None:
        """Wait until a message is due; serve keys and clock meanwhile."""
        while not self._ended:
            now_s = time.monotonic()
            self._tell_time(pace, now_s)
            left_s = LOOK_S if pace.paused else pace.due_s(due_ns) - now_s
            if left_s <= 0.0:
                return
            pause_s = min(left_s, CLOCK_PERIOD_S if self._clock is not None else LOOK_S)
            key = keyboard.key(pause_s)
            if key == 'q':
                self._ended = True
            elif key == ' ' and pace.paused:
                pace.resume(time.monotonic())
            elif key == ' ':
                pace.pause(time.monotonic())
            elif key == 'n' and pace.paused:
                pace.skip_to(due_ns)
                return

    def _tell_time(self, pace: Pace, now_s: float) -> None:
        """Publish the clock, and tell how far the record has come, when it is time."""
        if self._clock is not None and now_s >= self._clock_s + CLOCK_PERIOD_S:
            self._clock_s = now_s
            self._publish_clock(pace.reached_ns(now_s))
        if now_s >= self._told_s + LOOK_S:
            self._told_s = now_s
            self._on_time((pace.reached_ns(now_s) - self._index.start_ns) / NS_PER_S, pace.paused)

    def _publish_clock(self, reached_ns: int) -> None:
        # a message that is sent late has its time behind the clock, which does not go back
        if reached_ns <= self._clock_ns:
            return
        self._clock_ns = reached_ns
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(reached_ns, NS_PER_S)
        self._clock.publish(message)

    def _publish(self, topic: Replayed, message: Message, pace: Pace, due_ns: int) -> None:
        """Publish a message; its times are moved to now unless there is a clock."""
        cdr = message.data
        if self._clock is not None:
            self._publish_clock(due_ns)
        else:
            # by when it was due, not by when it is sent: times keep their distances
            now_ns = self._epoch_ns + round(pace.due_s(due_ns) * NS_PER_S)
            rate = self._wishes.rate
            cdr = topic.shift.shifted(cdr, lambda old_ns: now_ns + round((old_ns - due_ns) / rate))
        topic.publisher.publish(cdr)
        self._played.messages += 1
