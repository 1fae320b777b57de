# SPDX-License-Identifier: Apache-2.0
"""A driver as a process of its own, and the client that talks to it over DDS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from microhand_msgs_py.msg import RunEvent, SetpointChunk, StageState
from microhand_msgs_py.srv import Command, GetStageLimits, SetServo
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from stage_driver_sim import qos

DEADLINE_S = 15.0
DRIVER = Path(sys.executable).with_name('stage_driver')


class DriverClient:
    """What a sequencer sees of one driver: its states, its events, its services."""

    def __init__(self, node: Node, executor: SingleThreadedExecutor, station: str) -> None:
        self.node = node
        self.executor = executor
        self.states: list[StageState] = []
        self.events: list[RunEvent] = []
        finger = f'{station}/finger_2'
        node.create_subscription(StageState, f'{finger}/state', self.states.append, qos.STATE)
        node.create_subscription(RunEvent, f'{station}/events', self.events.append, qos.EVENTS)
        self.setpoints = node.create_publisher(SetpointChunk, f'{finger}/setpoints', qos.SETPOINTS)
        driver = f'{finger}/stage_driver'
        self.clients = {
            name: node.create_client(kind, f'{driver}/{name}')
            for name, kind in {
                'change_state': ChangeState,
                'stop': Command,
                'home': Command,
                'reset': Command,
                'set_servo': SetServo,
                'get_limits': GetStageLimits,
            }.items()
        }

    @property
    def state(self) -> StageState:
        """The latest state."""
        return self.states[-1]

    def wait(
        self, condition: Callable[[], bool], what: str, deadline_s: float = DEADLINE_S
    ) -> None:
        """Spin until `condition` holds."""
        give_up_s = time.monotonic() + deadline_s
        while not condition():
            assert time.monotonic() < give_up_s, f'not within {deadline_s} s: {what}'
            self.executor.spin_once(timeout_sec=0.05)

    def wait_matched(self) -> None:
        """Wait until the setpoints have their subscriber and every service its server."""
        self.wait(lambda: self.setpoints.get_subscription_count() == 1, 'a driver for setpoints')
        for name, client in self.clients.items():
            self.wait(client.service_is_ready, f'service {name}')

    def call(self, name: str, **fields: Any) -> Any:
        """Call a service of the driver and return its response."""
        client = self.clients[name]
        future = client.call_async(client.srv_type.Request(**fields))
        self.wait(future.done, f'answer of {name}')
        return future.result()

    def transition(self, transition_id: int) -> bool:
        """Ask for a lifecycle transition and return whether it succeeded."""
        return bool(self.call('change_state', transition=Transition(id=transition_id)).success)

    def activate(self) -> None:
        """Configure and activate the driver, and wait for its first state on target."""
        assert self.transition(Transition.TRANSITION_CONFIGURE)
        assert self.transition(Transition.TRANSITION_ACTIVATE)
        self.wait(lambda: bool(self.states) and self.state.on_target, 'the first state')

    def wait_mode(self, mode: int) -> StageState:
        """Wait for a state in `mode` and return it."""
        self.wait(lambda: self.state.mode == mode, f'mode {mode}, it is {self.state.mode}')
        return self.state

    def now_ns(self) -> int:
        """Return the ROS time [ns]."""
        return int(self.node.get_clock().now().nanoseconds)


def chunk_message(
    begin_ns: int, positions_m: NDArray[np.float64], *, period_s: float, **fields: Any
) -> SetpointChunk:
    """Return a chunk whose first setpoint is due at `begin_ns`."""
    message = SetpointChunk(period=period_s, positions=positions_m.reshape(-1).tolist(), **fields)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(begin_ns, 1_000_000_000)
    return message


@pytest.fixture
def make_chunk() -> Callable[..., SetpointChunk]:
    """Return the function that fills a chunk message."""
    return chunk_message


def start_driver(station: str, *arguments: str) -> subprocess.Popen[str]:
    """Start the driver of finger 2; its log goes to stdout, only defects to stderr."""
    environment = dict(os.environ, RCUTILS_LOGGING_USE_STDOUT='1')
    return subprocess.Popen(
        [
            str(DRIVER),
            '--ros-args',
            *('-r', f'__ns:={station}/finger_2', '-r', f'events:={station}/events'),
            *('-p', 'finger:=2'),
            *arguments,
        ],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def station() -> str:
    """Return a namespace of this test session."""
    return f'/station_{os.getpid()}'


@pytest.fixture
def make_driver(station: str) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Return the function that starts a driver; every driver is ended and must end cleanly."""
    processes: list[subprocess.Popen[str]] = []

    def make(*arguments: str) -> subprocess.Popen[str]:
        processes.append(start_driver(station, *arguments))
        return processes[-1]

    yield make
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        try:
            _, complaints = process.communicate(timeout=DEADLINE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        assert 'Traceback' not in complaints


@pytest.fixture
def client(station: str) -> Iterator[DriverClient]:
    """Return a client in a context of its own."""
    context = Context()
    context.init()
    node = Node('client', context=context, namespace=station)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield DriverClient(node, executor, station)
    finally:
        executor.shutdown()
        node.destroy_node()
        context.shutdown()


@pytest.fixture
def active(
    make_driver: Callable[..., subprocess.Popen[str]], client: DriverClient
) -> DriverClient:
    """Return a client whose driver is active and on target."""
    make_driver()
    client.wait_matched()
    client.activate()
    return client
