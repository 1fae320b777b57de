# SPDX-License-Identifier: Apache-2.0
"""A stage behind TCP, in a thread of its own: it works, and whatever happens becomes a failure."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from stage_driver_sim.controller import ControllerSettings, StageController
from stage_driver_sim.errors import (
    InvalidNumber,
    NotAllowed,
    StageFailed,
    StageSilent,
    TravelExceeded,
)
from stage_driver_sim.faults import Fault, FaultSettings
from stage_driver_sim.gcs.connection import TcpConnection
from stage_driver_sim.gcs.gcs_stage import GcsStage
from stage_driver_sim.gcs.server import GcsServer
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.protocol import StageLimits
from stage_driver_sim.remote_stage import RemoteStage
from stage_driver_sim.simulated_stage import SimulatedStage
from stage_driver_sim.snapshot import Mode
from tests.stage.gcs_bench import DEADLINE_S, DisturbedWire, running_server, wait_until

LIMITS = StageLimits(np.zeros(3), np.full(3, 100.0), np.full(3, 50.0), 3500.0)
Result = TypeVar('Result')


def connect(port: int, now_s: float) -> GcsStage:
    """Return the stage behind a port."""
    connection = TcpConnection('127.0.0.1', port)
    return GcsStage(connection, axes=('1', '2', '3'), limits=LIMITS, now_s=now_s)


def open_stage(port: int) -> RemoteStage:
    """Return it, in a thread of its own, at 500 Hz."""
    return RemoteStage(partial(connect, port), period_s=0.002)


@pytest.fixture
def server() -> Iterator[GcsServer]:
    """Return a running server."""
    with running_server() as server:
        yield server


@pytest.fixture
def stage(server: GcsServer) -> Iterator[RemoteStage]:
    """Return a stage, its servo on, at (50, 50, 50) µm."""
    stage = open_stage(server.port)
    try:
        stage.set_servo(True, time.monotonic())
        yield stage
    finally:
        stage.close()


def refused(call: Callable[[float], object]) -> StageSilent | None:
    """Return how a call fails now; None: it does not."""
    try:
        call(time.monotonic())
    except StageSilent as error:
        return error
    return None


def wait_near(stage: RemoteStage, position_um: float) -> None:
    """Wait until all axes are at a position."""
    wait_until(
        lambda: bool(np.abs(stage.measure_um(time.monotonic()) - position_um).max() < 0.02),
        f'{position_um} µm',
    )


def test_it_follows_the_latest_command(stage: RemoteStage) -> None:
    """Commands at a kilohertz; the stage ends at the last one, and says when it was there."""
    for k in range(200):
        now_s = time.monotonic()
        stage.command_um(np.full(3, 50.0 + 0.05 * k), now_s)
        stage.measure_um(now_s)
        assert now_s - 0.25 < stage.measured_s <= now_s
        time.sleep(0.001)
    wait_near(stage, 50.0 + 0.05 * 199)
    assert stage.servo_on
    assert 'bench' in stage.hardware_id


def test_it_homes_is_stopped_and_refuses_what_it_must(stage: RemoteStage) -> None:
    """Home, stop, limits and servo as `Stage` promises them, in real time."""
    stage.command_um(np.full(3, 90.0), time.monotonic())
    wait_near(stage, 90.0)
    stage.home(time.monotonic())
    assert stage.is_homing(time.monotonic())
    with pytest.raises(NotAllowed, match='homing'):
        stage.command_um(np.full(3, 50.0), time.monotonic())
    held_um = stage.stop(time.monotonic())
    assert not stage.is_homing(time.monotonic())
    wait_until(
        lambda: bool(np.abs(stage.measure_um(time.monotonic()) - held_um).max() < 0.02), 'rest'
    )
    stage.home(time.monotonic())
    wait_until(lambda: not stage.is_homing(time.monotonic()), 'home')
    wait_near(stage, 50.0)
    with pytest.raises(TravelExceeded):
        stage.command_um(np.full(3, 100.1), time.monotonic())
    with pytest.raises(InvalidNumber):
        stage.command_um(np.full(3, np.nan), time.monotonic())
    stage.set_servo(False, time.monotonic())
    for refusal in (stage.home, lambda now_s: stage.command_um(np.full(3, 50.0), now_s)):
        with pytest.raises(NotAllowed, match='servo'):
            refusal(time.monotonic())
    assert refused(stage.measure_um) is None  # being refused is no failure


def test_without_a_controller_there_is_no_stage() -> None:
    """Nobody listens, or who listens says nothing: named, and no thread is left."""
    with running_server() as server:
        port = server.port
        server.set_fault(FaultSettings(Fault.SILENT))
        with pytest.raises(StageSilent, match=r'did not answer .*IDN.* within \d\.\d s'):
            open_stage(port)
    with pytest.raises(StageSilent, match=f'no controller at 127.0.0.1:{port}: .*refused'):
        open_stage(port)
    assert 'remote stage' not in [thread.name for thread in threading.enumerate()]


def test_a_controller_that_goes_away_is_a_failure_and_is_found_again_when_it_is_back() -> None:
    """Gone: every call says so, with the address. Back: readings, and a servo to be closed."""
    with running_server() as server:
        port = server.port
        stage = open_stage(port)
        try:
            stage.set_servo(True, time.monotonic())
            stage.command_um(np.full(3, 55.0), time.monotonic())
            wait_near(stage, 55.0)
        except BaseException:
            stage.close()
            raise
    try:
        wait_until(lambda: refused(stage.measure_um) is not None, 'a failure')
        for call in (
            lambda now_s: stage.command_um(np.full(3, 60.0), now_s),
            lambda now_s: stage.set_servo(True, now_s),
            stage.home,
            stage.stop,
            stage.is_homing,
            stage.measure_um,
        ):
            assert f'127.0.0.1:{port}' in str(refused(call))
        with running_server(port):
            wait_until(lambda: refused(stage.measure_um) is None, 'readings')
            assert not stage.servo_on
            stage.set_servo(True, time.monotonic())
            wait_near(stage, 50.0)  # where that one stands: nothing of before is sent again
    finally:
        stage.close()


def test_hanging_up_is_a_failure_until_it_is_found_again(
    server: GcsServer, stage: RemoteStage
) -> None:
    """A connection that is cut is made again; the controller has held its target meanwhile."""
    stage.command_um(np.full(3, 55.0), time.monotonic())
    wait_near(stage, 55.0)
    server.disconnect()
    wait_until(lambda: refused(stage.measure_um) is not None, 'a failure')
    wait_until(lambda: refused(stage.measure_um) is None, 'readings')
    assert stage.servo_on
    wait_near(stage, 55.0)


def test_a_silent_controller_is_a_failure_and_a_waiting_order_is_told() -> None:
    """It stops answering in mid-motion; later it answers again, and is taken over."""
    with running_server() as server:
        stage = open_stage(server.port)
        controller = StageController(
            stage,
            name='finger_2',
            settings=ControllerSettings(1e6, 0.02, 0.02),
            now_s=time.monotonic(),
        )
        try:
            wait_until(lambda: controller.tick(time.monotonic()).on_target, 'on target')
            server.set_fault(FaultSettings(Fault.SILENT))
            wait_until(lambda: controller.tick(time.monotonic()).mode is Mode.FAULT, 'a fault')
            lost = controller.tick(time.monotonic())
            assert lost.error_code == 301
            assert 'did not answer' in lost.error_msg or 'not answered' in lost.error_msg
            with pytest.raises(StageFailed):
                controller.reset(time.monotonic())
            server.set_fault(FaultSettings())
            wait_until(lambda: refused(stage.measure_um) is None, 'readings')
            controller.reset(time.monotonic())
            wait_until(lambda: controller.tick(time.monotonic()).on_target, 'on target')
            assert controller.tick(time.monotonic()).mode is Mode.HOLDING
        finally:
            stage.close()


def test_what_the_controller_objects_to_is_told_once(
    server: GcsServer, stage: RemoteStage
) -> None:
    """Its stage runs into a limit: one failure with the text of ERR?, then readings again."""
    server.set_fault(FaultSettings(Fault.LIMIT, margin_um=0.5))
    stage.command_um(np.full(3, 53.0), time.monotonic())
    failures: list[StageFailed] = []

    def failed() -> bool:
        try:
            stage.measure_um(time.monotonic())
        except StageFailed as error:
            failures.append(error)
        return bool(failures)

    wait_until(failed, 'a failure')
    assert 'GCS error 7 (position out of limits)' in str(failures[0])
    wait_until(lambda: refused(stage.measure_um) is None, 'readings')
    assert np.abs(stage.measure_um(time.monotonic()) - 50.0).max() < 0.6


def test_another_controller_at_the_same_address_is_not_taken_for_the_same() -> None:
    """After a failure only the controller of before counts; the other one is named."""
    with running_server(name='first') as server:
        port = server.port
        stage = open_stage(port)
    try:
        with running_server(port, name='second'):
            wait_until(
                lambda: "'microhand, second, 0, 0.1.0' answers" in str(refused(stage.measure_um)),
                'the other one to be noticed',
            )
    finally:
        stage.close()


@pytest.fixture
def wire(server: GcsServer) -> Iterator[DisturbedWire]:
    """Return a wire to the server that does not disturb yet."""
    wire = DisturbedWire(server)
    yield wire
    wire.close()


def test_replies_in_pieces_and_late_are_replies(server: GcsServer, wire: DisturbedWire) -> None:
    """Byte by byte, and 50 ms late: slower, but nothing is wrong."""
    wire.disturb = lambda data: [data[k : k + 1] for k in range(len(data))]
    server.answer_delay_s = 0.05
    stage = open_stage(wire.port)
    try:
        stage.set_servo(True, time.monotonic())
        stage.command_um(np.full(3, 51.0), time.monotonic())
        wait_near(stage, 51.0)
    finally:
        stage.close()


@pytest.mark.parametrize(
    ('disturb', 'match'),
    [
        (lambda data: [b'\x00\xff garbage\n'], r'was answered|it was not asked'),
        (lambda data: [data, data], 'answers what it was not asked|was answered'),
        (lambda data: [data.replace(b'.', b'..')], 'was answered'),
        (lambda data: [b'x \n' * 2000], 'longer than 4096|not asked'),
        (lambda data: [data[:-3]], 'did not answer'),
        (lambda data: [], 'did not answer'),
    ],
    ids=['garbage', 'twice', 'numbers', 'endless', 'cut', 'nothing'],
)
def test_nonsense_on_the_wire_is_a_failure_and_forgotten_when_it_ends(
    wire: DisturbedWire, disturb: Callable[[bytes], list[bytes]], match: str
) -> None:
    """Whatever arrives instead of a reply: a failure that says so; the next connection is good."""
    stage = open_stage(wire.port)
    try:
        stage.set_servo(True, time.monotonic())
        wire.disturb = disturb
        wait_until(lambda: bool(re.search(match, str(refused(stage.measure_um)))), 'a failure')
        wire.disturb = lambda data: [data]
        wait_until(lambda: refused(stage.measure_um) is None, 'readings')
        stage.set_servo(True, time.monotonic())
        wait_near(stage, 50.0)
    finally:
        stage.close()


class BusyStage(SimulatedStage):
    """A stage whose readings wait until the test opens the gate."""

    gate = threading.Event()
    waiting = threading.Event()

    def measure_um(self, now_s: float) -> NDArray[np.float64]:
        """Return the readings, once the gate is open."""
        if not self.gate.is_set():
            self.waiting.set()
        assert self.gate.wait(DEADLINE_S)
        return super().measure_um(time.monotonic())


def test_an_order_that_was_given_up_is_not_carried_out_later() -> None:
    """The stage is busy for too long: `home` fails, and when it is free again it stays."""
    BusyStage.gate.set()
    busy = BusyStage(
        REPRESENTATIVE_100_UM_XYZ,
        home_um=np.full(3, 50.0),
        rng=np.random.default_rng(4),
        now_s=time.monotonic(),
    )
    stage = RemoteStage(lambda now_s: busy, period_s=0.002)
    try:
        stage.set_servo(True, time.monotonic())
        stage.command_um(np.full(3, 60.0), time.monotonic())
        wait_near(stage, 60.0)
        BusyStage.gate.clear()
        assert BusyStage.waiting.wait(DEADLINE_S)
        cycles = stage.cycles
        with pytest.raises(StageSilent, match='the stage did not answer within'):
            stage.home(time.monotonic())
        wait_until(lambda: 'has not answered' in str(refused(stage.measure_um)), 'a failure')
        BusyStage.gate.set()
        wait_until(lambda: stage.cycles > cycles + 20, 'further cycles')
        assert not stage.is_homing(time.monotonic())
        np.testing.assert_allclose(stage.measure_um(time.monotonic()), 60.0, atol=0.02)
    finally:
        BusyStage.gate.set()
        stage.close()
