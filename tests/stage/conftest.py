# SPDX-License-Identifier: Apache-2.0
"""A driver as a process of its own, and the client that talks to it over DDS."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from microhand_msgs_py.msg import RunEvent, SetpointChunk, StageState
from microhand_msgs_py.srv import Command, GetStageLimits, SetServo
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from microhand_node import qos

DEADLINE_S = 15.0
DRIVER = Path(sys.executable).with_name('stage_driver')

StartDriver = Callable[..., 'subprocess.Popen[str]']


def stamp_ns(state: StageState) -> int:
    """Return when a state was measured [ns]."""
    return int(state.header.stamp.sec) * 1_000_000_000 + int(state.header.stamp.nanosec)


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
                'get_state': GetState,  # last: its answer proves that the others will come
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
        # A server may know a client's request before it knows where to answer. Endpoints become
        # known in the order of their making, so ask the last one until it answers.
        asked: list[tuple[float, Future]] = []

        def answered() -> bool:
            if not asked or time.monotonic() > asked[-1][0] + 1.0:
                future = self.clients['get_state'].call_async(GetState.Request())
                asked.append((time.monotonic(), future))
            return any(future.done() for _, future in asked)

        self.wait(answered, 'an answer of get_state')

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
        begin_ns = self.now_ns()
        assert self.transition(Transition.TRANSITION_CONFIGURE)
        assert self.transition(Transition.TRANSITION_ACTIVATE)
        self.wait(
            lambda: bool(self.states) and self.state.on_target and stamp_ns(self.state) > begin_ns,
            'the first state',
        )
        # What the driver said before its last deactivation may have come late.
        self.states[:] = self.states_measured_since(begin_ns)

    def bring_down(self) -> None:
        """Bring the driver to state unconfigured from wherever it is."""
        if self.call('get_state').current_state.id == State.PRIMARY_STATE_ACTIVE:
            assert self.transition(Transition.TRANSITION_DEACTIVATE)
        if self.call('get_state').current_state.id == State.PRIMARY_STATE_INACTIVE:
            assert self.transition(Transition.TRANSITION_CLEANUP)

    def wait_state(self, condition: Callable[[StageState], bool], what: str) -> StageState:
        """Wait for a state measured from now on that meets `condition`, and return it.

        States measured before may still arrive: they say nothing about what was just asked for.
        """
        begin_ns = self.now_ns()
        self.wait(lambda: stamp_ns(self.state) > begin_ns and condition(self.state), what)
        return self.state

    def wait_mode(self, mode: int) -> StageState:
        """Wait for a state in `mode`, measured from now on, and return it."""
        return self.wait_state(lambda state: state.mode == mode, f'mode {mode}')

    def wait_rest(self) -> StageState:
        """Wait until the stage holds on target, and return that state."""
        return self.wait_state(
            lambda state: state.mode == StageState.HOLDING and state.on_target, 'rest'
        )

    def states_measured_since(self, begin_ns: int) -> list[StageState]:
        """Return the states heard so far that were measured after `begin_ns`."""
        return [state for state in self.states if stamp_ns(state) > begin_ns]

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


@pytest.fixture(scope='module')
def node() -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    """Return the node of all clients, in a context of its own, and its executor."""
    context = Context()
    context.init()
    node = Node('client', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        context.shutdown()


@pytest.fixture(scope='module')
def start_driver() -> Iterator[StartDriver]:
    """Return the function that starts a driver process; every one has to end without a traceback.

    Its log goes to stdout, so that stderr has only what should not be there.
    """
    processes: list[subprocess.Popen[str]] = []

    def start(station: str, *arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [
                str(DRIVER),
                '--ros-args',
                *('-r', f'__ns:={station}/finger_2', '-r', f'events:={station}/events'),
                *('-p', 'finger:=2'),
                *arguments,
            ],
            env=dict(
                os.environ,
                RCUTILS_LOGGING_USE_STDOUT='1',
                PYTHONWARNINGS='ignore:failed to send response',  # see wait_matched
            ),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.terminate()
        try:
            _, complaints = process.communicate(timeout=DEADLINE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        assert 'Traceback' not in complaints


@pytest.fixture(scope='module')
def make_client(node: tuple[Node, SingleThreadedExecutor]) -> Callable[[str], DriverClient]:
    """Return the function that makes the client of a station's driver."""
    return lambda station: DriverClient(*node, station)


@pytest.fixture
def station(request: pytest.FixtureRequest) -> str:
    """Return a namespace that no other test uses."""
    return f'/station_{os.getpid()}_{abs(hash(request.node.name))}'


@pytest.fixture(scope='module')
def shared(start_driver: StartDriver, make_client: Callable[[str], DriverClient]) -> DriverClient:
    """Return the client of a driver that the tests of a module share."""
    station = f'/station_{os.getpid()}'
    start_driver(station)
    client = make_client(station)
    client.wait_matched()
    return client


@pytest.fixture
def unconfigured(shared: DriverClient) -> DriverClient:
    """Return a client whose driver has just begun: unconfigured, nothing heard from it."""
    shared.bring_down()
    shared.states.clear()
    shared.events.clear()
    return shared


@pytest.fixture
def active(unconfigured: DriverClient) -> DriverClient:
    """Return a client whose driver is active and on target."""
    unconfigured.activate()
    return unconfigured
