# SPDX-License-Identifier: Apache-2.0
"""An inbox: nothing is lost or reordered, nothing wakes the executor, and any thread may look."""

import threading
import time
from functools import partial

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message
from std_msgs.msg import Int64

from microhand_node.inbox import Inbox
from microhand_node.qos import STATE

DEADLINE_S = 10.0
TOPICS = ('left', 'right')


class Pair:
    """A node with an inbox, and another one that writes to it."""

    def __init__(self, raw=False):
        self.context = rclpy.Context()
        self.context.init()
        self.reader = rclpy.create_node('reader', namespace='inbox', context=self.context)
        self.writer = rclpy.create_node('writer', namespace='inbox', context=self.context)
        self.inbox = Inbox(self.reader)
        self.got = []
        for topic in TOPICS:
            self.inbox.subscribe(Int64, topic, partial(self._keep, topic), STATE, raw=raw)
        self.send = {t: self.writer.create_publisher(Int64, t, STATE) for t in TOPICS}
        self.wait(lambda: all(p.get_subscription_count() == 1 for p in self.send.values()))

    def _keep(self, topic, *letter):
        self.got.append((topic, *letter))

    def wait(self, condition):
        """Return when `condition` holds."""
        give_up_s = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < give_up_s
            time.sleep(0.001)

    def empty_until(self, count):
        """Look into the inbox until there have been so many messages."""

        def has_come():
            self.inbox.empty()
            return len(self.got) >= count

        self.wait(has_come)


@pytest.fixture
def make_pair():
    """Return a function that makes a pair; it is taken away at the end."""
    pairs = []

    def make(**options):
        pairs.append(Pair(**options))
        return pairs[-1]

    yield make
    for pair in pairs:
        pair.reader.destroy_node()
        pair.writer.destroy_node()
        pair.context.shutdown()


def test_messages_of_all_topics_come_in_the_order_in_which_they_were_sent(make_pair):
    """Two topics, by turns and in bursts: each message once, sorted by arrival, not by topic."""
    pair = make_pair()
    sent = [(TOPICS[(k // 3) % 2], k) for k in range(60)]
    for topic, k in sent:
        pair.send[topic].publish(Int64(data=k))
    pair.empty_until(len(sent))
    assert [(topic, message.data) for topic, message in pair.got] == sent
    pair.inbox.empty()
    assert len(pair.got) == len(sent)


def test_no_message_wakes_the_executor(make_pair):
    """An executor that spins meanwhile runs nothing: what was sent waits for a look."""
    pair = make_pair()
    executor = SingleThreadedExecutor(context=pair.context)
    executor.add_node(pair.reader)
    for k in range(20):
        pair.send['left'].publish(Int64(data=k))
        executor.spin_once(timeout_sec=0.01)
    executor.shutdown()
    assert pair.got == []
    pair.empty_until(20)


def test_raw_messages_come_as_bytes_with_what_the_middleware_knows(make_pair):
    """The bytes are those of the message; it was received after it was sent."""
    pair = make_pair(raw=True)
    pair.send['right'].publish(Int64(data=7))
    pair.empty_until(1)
    ((topic, cdr, info),) = pair.got
    assert (topic, deserialize_message(cdr, Int64).data) == ('right', 7)
    assert info['received_timestamp'] >= info['source_timestamp'] > 0


def test_several_threads_may_look_and_each_message_is_handed_over_once(make_pair):
    """Four threads look as fast as they can: no message twice, none lost, none out of order."""
    pair = make_pair()
    stopping = threading.Event()

    def look():
        while not stopping.is_set():
            pair.inbox.empty()

    threads = [threading.Thread(target=look) for _ in range(4)]
    for thread in threads:
        thread.start()
    try:
        for k in range(90):
            pair.send['left'].publish(Int64(data=k))
        pair.wait(lambda: len(pair.got) >= 90)
    finally:
        stopping.set()
        for thread in threads:
            thread.join()
    assert [message.data for _, message in pair.got] == list(range(90))
