# SPDX-License-Identifier: Apache-2.0
"""Setpoints in bare rclpy, one message each: what a sender and three receivers make of it.

Run by streaming.py, as processes: ``receive FINGER COUNT FILE`` and ``send RATE COUNT FILE``.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE
)
FINGERS = (1, 2, 3)
FIND_S = 30.0
SILENCE_S = 3.0
"""A receiver that hears nothing for so long ends [s]."""


def topic(finger: int) -> str:
    """Return the topic of a finger."""
    return f'bare/finger_{finger}/setpoint'


def receive(finger: int, count: int, file: str) -> None:
    """Note when each setpoint arrives: rows of number and time [s], in the order of arrival."""
    rows = np.zeros((2 * count, 2))
    got, last_s = 0, time.monotonic() + FIND_S

    def note(message: PointStamped) -> None:
        nonlocal got, last_s
        last_s = time.monotonic()
        rows[got] = message.point.x, last_s
        got += 1

    node = rclpy.create_node(f'receiver_{finger}')
    node.create_subscription(PointStamped, topic(finger), note, QOS)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while time.monotonic() < last_s + SILENCE_S:
        executor.spin_once(timeout_sec=0.1)
    np.save(file, rows[:got])


def send(rate_hz: float, count: int, file: str) -> None:
    """Send one message per finger and setpoint at absolute deadlines; note when: [s]."""
    node = rclpy.create_node('sender')
    publishers = [node.create_publisher(PointStamped, topic(finger), QOS) for finger in FINGERS]
    give_up_s = time.monotonic() + FIND_S
    while any(publisher.get_subscription_count() == 0 for publisher in publishers):
        if time.monotonic() > give_up_s:
            raise RuntimeError('no receivers')
        time.sleep(0.05)
    sent_s = np.zeros(count)
    message = PointStamped()
    begin_s = time.monotonic() + 0.1
    for k in range(count):
        time.sleep(max(0.0, begin_s + k / rate_hz - time.monotonic()))
        message.point.x = float(k)
        sent_s[k] = time.monotonic()
        for publisher in publishers:
            publisher.publish(message)
    np.save(file, sent_s)
    time.sleep(1.0)


def main() -> None:
    """Be a sender or a receiver."""
    role, first, count, file = sys.argv[1:5]
    rclpy.init()
    if role == 'receive':
        receive(int(first), int(count), file)
    else:
        send(float(first), int(count), file)
    rclpy.shutdown()


if __name__ == '__main__':
    main()
