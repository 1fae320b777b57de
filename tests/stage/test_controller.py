# SPDX-License-Identifier: Apache-2.0
"""The driver's modes on a simulated stage, with a clock that the test turns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from stage_driver_sim.chunk import Chunk
from stage_driver_sim.controller import ControllerSettings, Mode, Snapshot, StageController
from stage_driver_sim.errors import InvalidNumber, NotAllowed, StageError
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.simulated_stage import SimulatedStage

PERIOD_S = 0.002
DECELERATION_UM_S2 = 1e5
VELOCITY_UM_S = 200.0


class Bench:
    """A controller on a simulated stage at (50, 50, 50) µm, and a clock that ticks it at 1 kHz."""

    def __init__(self) -> None:
        stage = SimulatedStage(
            REPRESENTATIVE_100_UM_XYZ,
            home_um=np.full(3, 50.0),
            rng=np.random.default_rng(9),
            now_s=0.0,
        )
        self.now_s = 0.0
        self.controller = StageController(
            stage,
            name='finger_2',
            settings=ControllerSettings(DECELERATION_UM_S2, 0.02, 0.02),
            now_s=self.now_s,
        )
        self.seen = [self.controller.tick(self.now_s)]

    @property
    def last(self) -> Snapshot:
        """What the latest tick saw."""
        return self.seen[-1]

    def run(self, duration_s: float) -> Snapshot:
        """Tick for a while and return the last snapshot."""
        for _ in range(round(duration_s / 0.001)):
            self.now_s += 0.001
            self.seen.append(self.controller.tick(self.now_s))
        return self.last

    def begin_ramp(self, *, count: int = 100, last: bool = False) -> Chunk:
        """Send a ramp of `VELOCITY_UM_S` along x that begins in 10 ms where the stage holds."""
        way_um = VELOCITY_UM_S * PERIOD_S * np.arange(count)
        chunk = Chunk(
            time_s=self.now_s + 0.01,
            period_s=PERIOD_S,
            positions_um=self.last.command_um + np.outer(way_um, [1.0, 0.0, 0.0]),
            velocities_um_s=None,
            sequence=0,
            stream=self.last.stream + 1,
            last=last,
        )
        self.controller.accept(chunk, self.now_s)
        return chunk

    def largest_jump_um(self) -> float:
        """Return the largest step of the command between two ticks so far."""
        commands_um = np.array([snapshot.command_um for snapshot in self.seen])
        return float(np.abs(np.diff(commands_um, axis=0)).max())


@pytest.fixture
def bench() -> Bench:
    """Return a bench after 50 ms of holding."""
    bench = Bench()
    bench.run(0.05)
    return bench


def test_taking_over_holds_the_stage_where_it_is(bench: Bench) -> None:
    """The first command is the first measurement, nothing jumps; on target comes by dwelling."""
    assert bench.last.mode is Mode.HOLDING
    np.testing.assert_allclose(bench.last.position_um, 50.0, atol=0.01)
    on_target = [snapshot.on_target for snapshot in bench.seen]
    assert on_target.index(True) == 20
    assert all(on_target[20:])
    assert bench.largest_jump_um() == 0.0


def test_a_stream_is_followed_to_its_end(bench: Bench) -> None:
    """The command runs through the setpoints on time; the stage lags by 2z/w and arrives."""
    chunk = bench.begin_ramp(last=True)
    bench.run(0.1)
    assert bench.last.mode is Mode.STREAMING
    wanted_um = np.interp(bench.now_s, chunk.times_s(), chunk.positions_um[:, 0])
    assert bench.last.command_um[0] == pytest.approx(wanted_um, abs=1e-9)
    # The command is held between two ticks: half a millisecond late on average.
    lag_s = 2.0 * 0.7 / (2.0 * np.pi * 150.0) + 0.0005
    lag_um = bench.last.command_um[0] - bench.last.position_um[0]
    assert lag_um == pytest.approx(VELOCITY_UM_S * lag_s, abs=VELOCITY_UM_S * 0.0006)
    assert bench.last.velocity_um_s[0] == pytest.approx(VELOCITY_UM_S, rel=0.02)
    bench.run(0.2)
    assert (bench.last.mode, bench.last.received) == (Mode.HOLDING, 100)
    np.testing.assert_array_equal(bench.last.command_um, chunk.positions_um[-1])
    assert bench.last.on_target
    assert bench.controller.take_events() == []


def braked(bench: Bench, interrupt: Callable[[], None]) -> Snapshot:
    """Interrupt a ramp in full motion and assert that the command brakes as it should."""
    bench.begin_ramp()
    before = bench.run(0.1)
    interrupt()
    after = bench.run(0.1)
    way_um = after.command_um[0] - before.command_um[0]
    stopping_um = VELOCITY_UM_S**2 / (2.0 * DECELERATION_UM_S2)
    assert stopping_um - 1e-9 <= way_um <= stopping_um + VELOCITY_UM_S * 0.001
    np.testing.assert_array_equal(after.command_um[1:], before.command_um[1:])
    assert bench.largest_jump_um() <= VELOCITY_UM_S * 0.001 + 1e-9
    assert after.on_target
    assert not bench.controller.moving
    return after


def test_stop_brakes_holds_and_refuses(bench: Bench) -> None:
    """After a stop: ramped to rest, mode STOPPED, the rest of the stream dropped, until reset."""
    after = braked(bench, lambda: bench.controller.stop(bench.now_s))
    assert (after.mode, after.error_code) == (Mode.STOPPED, 0)
    rest = bench.begin_ramp()
    assert bench.run(0.1).mode is Mode.STOPPED
    assert bench.last.dropped == 1
    np.testing.assert_array_equal(bench.last.command_um, after.command_um)
    bench.controller.reset(bench.now_s)
    bench.controller.accept(rest, bench.now_s)  # its time has passed: a fault, not a motion
    assert bench.run(0.05).mode is Mode.FAULT
    np.testing.assert_array_equal(bench.last.command_um, after.command_um)


def test_a_refused_chunk_is_a_fault_that_names_finger_axis_and_amount(bench: Bench) -> None:
    """A gap in full motion: ramped to rest, mode FAULT, code and text kept, one event."""

    def send_gap() -> None:
        gap = Chunk(
            time_s=bench.now_s,
            period_s=PERIOD_S,
            positions_um=np.full((5, 3), 50.0),
            velocities_um_s=None,
            sequence=120,
            stream=bench.last.stream,
            last=False,
        )
        bench.controller.accept(gap, bench.now_s)

    after = braked(bench, send_gap)
    assert (after.mode, after.error_code) == (Mode.FAULT, 303)
    assert after.error_msg == 'finger_2: stream 1 goes on with setpoint 120; allowed: 100'
    (event,) = bench.controller.take_events()
    assert (event.code, event.text) == (303, after.error_msg)


def test_a_stream_that_runs_dry_is_an_underrun(bench: Bench) -> None:
    """Time passes the last setpoint, no end announced: brake from there, FAULT, counted once."""
    bench.begin_ramp(count=20)
    bench.run(0.3)
    assert (bench.last.mode, bench.last.error_code, bench.last.underruns) == (Mode.FAULT, 303, 1)
    assert 'ran dry after setpoint 19' in bench.last.error_msg
    stopping_um = VELOCITY_UM_S**2 / (2.0 * DECELERATION_UM_S2)
    expected_um = bench.seen[0].command_um[0] + VELOCITY_UM_S * 19 * PERIOD_S + stopping_um
    assert bench.last.command_um[0] == pytest.approx(expected_um, abs=1e-9)
    steps_um = np.diff([snapshot.command_um[0] for snapshot in bench.seen])
    at_speed = int(steps_um.argmax())
    assert steps_um[at_speed] == pytest.approx(VELOCITY_UM_S * 0.001)
    assert (np.diff(steps_um[at_speed:]) < 1e-9).all()  # slower and slower, no halt in between


def test_a_stop_before_a_stream_begins_moves_nothing(bench: Bench) -> None:
    """A stream that waits for its time, a little beside the stage, is given up without a step."""
    held_um = bench.last.command_um
    chunk = Chunk(
        time_s=bench.now_s + 0.1,
        period_s=PERIOD_S,
        positions_um=held_um + np.full((5, 3), 0.05),
        velocities_um_s=None,
        sequence=0,
        stream=1,
        last=True,
    )
    bench.controller.accept(chunk, bench.now_s)
    assert bench.run(0.05).mode is Mode.STREAMING
    bench.controller.stop(bench.now_s)
    assert bench.run(0.2).mode is Mode.STOPPED
    np.testing.assert_array_equal(bench.last.command_um, held_um)


def test_the_first_fault_stays_until_reset(bench: Bench) -> None:
    """Later errors and a stop change nothing; after reset the stage takes a new stream."""
    bench.controller.fail(InvalidNumber('first'), bench.now_s)
    bench.controller.fail(StageError('second'), bench.now_s)
    bench.controller.refuse(InvalidNumber('third'), bench.now_s)
    bench.controller.stop(bench.now_s)
    assert bench.run(0.01).error_msg == 'finger_2: first'
    assert (bench.last.mode, bench.last.error_code) == (Mode.FAULT, 105)
    with pytest.raises(NotAllowed, match='home in mode FAULT'):
        bench.controller.home(bench.now_s)
    bench.controller.reset(bench.now_s)
    assert bench.run(0.001).mode is Mode.HOLDING
    assert (bench.last.error_code, bench.last.error_msg) == (0, '')
    bench.begin_ramp()
    assert bench.run(0.05).mode is Mode.STREAMING


def test_leftovers_of_a_stopped_stream_do_no_harm_after_reset(bench: Bench) -> None:
    """Chunks of the stream before that arrive late are dropped, not feared."""
    first = bench.begin_ramp(count=20)
    bench.run(0.02)
    bench.controller.stop(bench.now_s)
    bench.run(0.05)
    bench.controller.reset(bench.now_s)
    late = Chunk(
        time_s=first.time_s + 20 * PERIOD_S,
        period_s=PERIOD_S,
        positions_um=first.positions_um,
        velocities_um_s=None,
        sequence=20,
        stream=first.stream,
        last=False,
    )
    bench.controller.accept(late, bench.now_s)
    bench.controller.accept(first, bench.now_s)
    assert bench.run(0.01).mode is Mode.HOLDING
    assert bench.last.dropped == 2


def test_home_goes_home_and_ends_holding(bench: Bench) -> None:
    """From elsewhere `home` leads to the home position, mode HOMING on the way."""
    bench.begin_ramp(last=True)
    bench.run(0.3)
    assert bench.last.position_um[0] > 85.0
    bench.controller.home(bench.now_s)
    assert bench.run(0.005).mode is Mode.HOMING
    assert bench.controller.moving
    with pytest.raises(NotAllowed, match='home in mode HOMING'):
        bench.controller.home(bench.now_s)
    bench.run(0.2)
    assert bench.last.mode is Mode.HOLDING
    np.testing.assert_allclose(bench.last.position_um, 50.0, atol=0.01)
    assert bench.last.on_target


@pytest.mark.parametrize('how', ['stop', 'chunk'])
def test_homing_can_be_interrupted(bench: Bench, how: str) -> None:
    """A stop, or a stream that does not wait its turn, ends homing short of home."""
    bench.begin_ramp(last=True)
    bench.run(0.3)
    bench.controller.home(bench.now_s)
    bench.run(0.005)
    if how == 'stop':
        bench.controller.stop(bench.now_s)
    else:
        bench.controller.accept(
            Chunk(
                time_s=bench.now_s + 0.1,
                period_s=PERIOD_S,
                positions_um=bench.last.command_um + np.zeros((5, 3)),
                velocities_um_s=None,
                sequence=0,
                stream=7,
                last=True,
            ),
            bench.now_s,
        )
    bench.run(0.2)
    assert bench.last.mode is (Mode.STOPPED if how == 'stop' else Mode.FAULT)
    assert bench.last.position_um[0] > 60.0
    np.testing.assert_allclose(bench.last.position_um, bench.last.command_um, atol=0.01)


def test_servo_off_and_on(bench: Bench) -> None:
    """OFF does not follow and refuses streams; back on, the stage holds where it is."""
    bench.controller.set_servo(False, bench.now_s)
    assert bench.run(0.03).mode is Mode.OFF
    assert not bench.last.on_target
    with pytest.raises(NotAllowed, match='home in mode OFF'):
        bench.controller.home(bench.now_s)
    bench.begin_ramp()
    assert bench.run(0.01).mode is Mode.FAULT
    assert (
        bench.last.error_msg == 'finger_2: stream 1 begins in mode OFF; allowed: HOLDING, at rest'
    )
    bench.controller.reset(bench.now_s)
    assert bench.run(0.01).mode is Mode.OFF
    bench.controller.set_servo(True, bench.now_s)
    assert bench.run(0.03).mode is Mode.HOLDING
    assert bench.last.on_target


def test_the_servo_is_not_opened_in_motion(bench: Bench) -> None:
    """Opening the loop while the stage moves is refused, and the motion goes on."""
    bench.begin_ramp()
    bench.run(0.05)
    with pytest.raises(NotAllowed, match='servo off in mode STREAMING'):
        bench.controller.set_servo(False, bench.now_s)
    assert bench.run(0.01).mode is Mode.STREAMING


def test_braking_ends_at_the_travel(bench: Bench) -> None:
    """A stream that runs dry at speed near the end of the travel does not leave it."""
    way_um = np.minimum(3000.0 * PERIOD_S * np.arange(9), 49.9)
    chunk = Chunk(
        time_s=bench.now_s + 0.01,
        period_s=PERIOD_S,
        positions_um=bench.last.command_um + np.outer(way_um, [1.0, 0.0, 0.0]),
        velocities_um_s=None,
        sequence=0,
        stream=1,
        last=False,
    )
    bench.controller.accept(chunk, bench.now_s)
    bench.run(0.3)
    assert bench.last.mode is Mode.FAULT
    assert bench.last.command_um[0] == 100.0
