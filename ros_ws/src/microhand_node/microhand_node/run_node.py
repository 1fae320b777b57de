# SPDX-License-Identifier: Apache-2.0
"""A node as a process: start, spin in one thread, end cleanly on SIGINT and SIGTERM."""

from __future__ import annotations

import faulthandler
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

HANGS_S = 60.0
"""A node that has not ended so long after it was told to hangs in the middleware [s]."""
STOP_LATENCY_S = 0.1
"""Longest time an idle node takes to notice that it shall end."""
WIND_DOWN_S = 3.0
"""Longest time for what is under way to come to rest before a node ends [s]."""

NodeT = TypeVar('NodeT', bound=Node)


def stop_at_signals() -> threading.Event:
    """Return an event that SIGINT and SIGTERM set; from then on the process has to end.

    Now and then Fast DDS does not return from the end of a node whose peers were killed. A process
    that is still there after `HANGS_S` writes where it is to stderr and ends, with status 1.
    """
    stopping = threading.Event()

    def stop(*_: object) -> None:
        faulthandler.dump_traceback_later(HANGS_S, exit=True)
        stopping.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    return stopping


def run_node(
    make_node: Callable[[], NodeT],
    args: Sequence[str] | None = None,
    *,
    still_busy: Callable[[NodeT], bool] = lambda _: False,
) -> int:
    """Run a node until SIGINT or SIGTERM and return the exit status of the process.

    The signals end the loop between two callbacks; the context stays valid until the node is
    destroyed, so that nothing has to fear a publisher that vanished. A node that owns threads ends
    them in its ``destroy_node``.

    Parameters
    ----------
    make_node : callable
        Returns the node; called once ROS is up.
    args : sequence of str, optional
        Command line; default: that of the process.
    still_busy : callable
        Asked again and again once the node shall end, which goes on until then, or until
        `WIND_DOWN_S` have passed.

    Returns
    -------
    int
        0; 2 if a parameter was refused, after one line on stderr.
    """
    stopping = stop_at_signals()
    rclpy.init(
        args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO
    )
    try:
        node = make_node()
    except ParameterException as error:
        sys.stderr.write(f'{error}\n')
        rclpy.shutdown()
        return 2
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stopping.is_set():
            executor.spin_once(timeout_sec=STOP_LATENCY_S)
        give_up_s = time.monotonic() + WIND_DOWN_S
        while still_busy(node) and time.monotonic() < give_up_s:
            executor.spin_once(timeout_sec=STOP_LATENCY_S)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
        faulthandler.cancel_dump_traceback_later()
    return 0
