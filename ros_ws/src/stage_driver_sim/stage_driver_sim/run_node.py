# SPDX-License-Identifier: Apache-2.0
"""A node as a process: start, spin in one thread, end cleanly on SIGINT and SIGTERM."""

from __future__ import annotations

import faulthandler
import signal
import sys
import threading
from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

HANGS_S = 60.0
"""A node that has not ended so long after it was told to hangs in the middleware [s]."""
STOP_LATENCY_S = 0.1
"""Longest time an idle node takes to notice that it shall end."""


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


def run_node(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
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
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
        faulthandler.cancel_dump_traceback_later()
    return 0
