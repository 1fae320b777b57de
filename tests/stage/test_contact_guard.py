# SPDX-License-Identifier: Apache-2.0
"""Guarded streams: a stage stops where its tip met something; the test turns the clock."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stage_driver_sim.chunk import Chunk
from stage_driver_sim.contact_guard import SILENCE_S, ContactGuard, ContactReport
from stage_driver_sim.controller import ControllerSettings, Mode, Snapshot, StageController
from stage_driver_sim.errors import InvalidNumber
from stage_driver_sim.position_history import KEPT_S, PositionHistory
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.simulated_stage import SimulatedStage

PERIOD_S = 0.002
SPEED_UM_S = 10.0
NOISE_UM = 0.001


class GuardedBench:
    """A controller on a stage at (50, 50, 50) µm, a wall, and a sensor that reports it late."""

    def __init__(self, wall_um: float = np.inf, lag_s: float = 0.03) -> None:
        stage = SimulatedStage(
            REPRESENTATIVE_100_UM_XYZ,
            home_um=np.full(3, 50.0),
            rng=np.random.default_rng(5),
            now_s=0.0,
        )
        self.controller = StageController(
            stage, name='finger_2', settings=ControllerSettings(1e5, 0.02, 0.02), now_s=0.0
        )
        self.wall_um = wall_um
        self.lag = round(lag_s / 0.001)
        self.reporting = True
        self.now_s = 0.0
        self.seen: list[Snapshot] = [self.controller.tick(0.0)]

    def run(self, duration_s: float) -> Snapshot:
        """Tick at 1 kHz, reporting what was `lag` ticks ago, and return the last snapshot."""
        for _ in range(round(duration_s / 0.001)):
            if self.reporting:
                then = self.seen[max(len(self.seen) - 1 - self.lag, 0)]
                touching = bool(then.position_um[0] >= self.wall_um)
                self.controller.note_contact(ContactReport(then.time_s, touching))
            self.now_s += 0.001
            self.seen.append(self.controller.tick(self.now_s))
        return self.seen[-1]

    def send(
        self, *, first: int = 0, count: int = 200, last: bool = True, guarded: bool = True
    ) -> Chunk:
        """Send setpoints `first`... of a ramp along x that began where the stage held."""
        if first == 0:
            self.begin_um = self.seen[-1].command_um
            self.begin_s = self.now_s + 0.01
            self.stream = self.seen[-1].stream + 1
        way_um = SPEED_UM_S * PERIOD_S * np.arange(first, first + count)
        chunk = Chunk(
            time_s=self.begin_s + first * PERIOD_S,
            period_s=PERIOD_S,
            positions_um=self.begin_um + np.outer(way_um, [1.0, 0.0, 0.0]),
            velocities_um_s=None,
            sequence=first,
            stream=self.stream,
            last=last,
            guarded=guarded,
        )
        self.controller.accept(chunk, self.now_s)
        return chunk


@pytest.mark.parametrize('lag_s', [0.0, 0.03, 0.2])
def test_a_guarded_stream_stops_at_the_wall_and_knows_where_it_was(lag_s: float) -> None:
    """The contact is where the wall is, whatever the lag; the stage overshoots by lag x speed."""
    bench = GuardedBench(wall_um=51.0, lag_s=lag_s)
    bench.run(0.1)
    bench.send()
    end = bench.run(0.6)
    assert (end.mode, end.guard_tripped, end.error_code) == (Mode.HOLDING, True, 0)
    # one tick of the ramp, and the noise that may show the wall to be crossed before it is
    np.testing.assert_allclose(end.contact_um[0], 51.0, atol=SPEED_UM_S * 0.001 + 5 * NOISE_UM)
    overshoot_um = end.command_um[0] - 51.0
    servo_lag_s = 2.0 * 0.7 / (2.0 * np.pi * 150.0) + 0.0005
    assert overshoot_um == pytest.approx(SPEED_UM_S * (lag_s + servo_lag_s + 0.001), abs=0.025)
    assert end.on_target
    assert not bench.controller.moving
    commands_um = np.array([one.command_um for one in bench.seen])
    assert np.abs(np.diff(commands_um, axis=0)).max() <= SPEED_UM_S * 0.001 + 1e-9
    assert bench.controller.take_events() == []


def test_the_rest_of_a_tripped_stream_is_dropped_and_the_next_stream_begins_anew() -> None:
    """Chunks that were under way do no harm; a new stream clears the trip and moves."""
    bench = GuardedBench(wall_um=50.5)
    bench.run(0.1)
    bench.send(count=100, last=False)
    held = bench.run(0.15)
    assert held.guard_tripped
    bench.send(first=100, count=100)
    after = bench.run(0.1)
    assert (after.mode, after.received, after.dropped) == (Mode.HOLDING, 100, 1)
    np.testing.assert_array_equal(after.command_um, held.command_um)
    assert after.guard_tripped
    bench.send(guarded=False)
    end = bench.run(0.6)
    assert (end.mode, end.guard_tripped) == (Mode.HOLDING, False)
    assert np.isnan(end.contact_um).all()
    assert end.command_um[0] == pytest.approx(held.command_um[0] + 199 * SPEED_UM_S * PERIOD_S)


def test_a_guarded_stream_that_meets_nothing_holds_at_its_end() -> None:
    """No contact: the stream is followed to the end, nothing tripped."""
    bench = GuardedBench()
    bench.run(0.1)
    chunk = bench.send()
    end = bench.run(0.6)
    assert (end.mode, end.guard_tripped, end.received) == (Mode.HOLDING, False, 200)
    np.testing.assert_array_equal(end.command_um, chunk.positions_um[-1])


def test_a_stream_that_is_not_guarded_ignores_contacts() -> None:
    """Rolling fingers touch all the time."""
    bench = GuardedBench(wall_um=50.5)
    bench.run(0.1)
    chunk = bench.send(guarded=False)
    end = bench.run(0.6)
    assert not end.guard_tripped
    np.testing.assert_array_equal(end.command_um, chunk.positions_um[-1])


def test_a_contact_that_still_is_there_trips_at_once_and_one_that_ended_does_not() -> None:
    """What was reported before the stream counts only if no later report took it back."""
    bench = GuardedBench(wall_um=0.0)
    bench.run(0.1)
    bench.send()
    end = bench.run(0.05)
    assert end.guard_tripped
    np.testing.assert_allclose(end.contact_um, 50.0, atol=0.02 + 5 * NOISE_UM)
    np.testing.assert_allclose(end.command_um[0], 50.0, atol=0.02)

    bench = GuardedBench()
    bench.run(0.1)
    bench.controller.note_contact(ContactReport(0.05, True))
    bench.controller.note_contact(ContactReport(0.09, False))
    bench.controller.note_contact(ContactReport(0.08, True))  # came late: it is out of date
    bench.send()
    assert not bench.run(0.6).guard_tripped


def test_a_guarded_stream_without_news_of_contacts_is_a_fault() -> None:
    """Nobody reports, or nobody reports any more: the stage brakes, holds and says why."""
    bench = GuardedBench()
    bench.reporting = False
    bench.run(0.1)
    bench.send()
    end = bench.run(0.1)
    assert (end.mode, end.error_code) == (Mode.FAULT, 310)
    assert 'finger_2: nobody reports contacts' in end.error_msg
    np.testing.assert_allclose(end.command_um[0], 50.0, atol=SPEED_UM_S * 0.001)

    bench = GuardedBench(lag_s=0.0)
    bench.run(0.1)
    bench.send(count=900)
    bench.run(0.2)
    bench.reporting = False
    before = bench.seen[-1]
    end = bench.run(1.2)
    assert (end.mode, end.error_code) == (Mode.FAULT, 310)
    assert 'the latest contact report is 1.00 s old' in end.error_msg
    assert end.command_um[0] == pytest.approx(before.command_um[0] + SPEED_UM_S, abs=0.03)


def test_every_contact_that_counts_has_its_position() -> None:
    """The latest contact that is not too old to count is younger than the oldest position kept."""
    assert SILENCE_S < KEPT_S


def test_a_stream_is_guarded_as_a_whole() -> None:
    """A chunk that says otherwise than the first one is refused."""
    bench = GuardedBench()
    bench.run(0.1)
    bench.send(count=100, last=False)
    bench.run(0.05)
    bench.send(first=100, guarded=False)
    end = bench.run(0.1)
    assert (end.mode, end.error_code) == (Mode.FAULT, 303)
    assert 'guarded is False from setpoint 100 on; allowed: True as before' in end.error_msg


def test_a_report_without_a_time_is_refused() -> None:
    """NaN is no time."""
    with pytest.raises(InvalidNumber, match='time_s is nan'):
        ContactReport(np.nan, True)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(steps_s=st.lists(st.floats(1e-4, 0.01), min_size=2, max_size=300), share=st.floats(0, 1))
def test_history_interpolates_as_numpy_does(steps_s: list[float], share: float) -> None:
    """Any time, within the kept ones or not, gives what numpy.interp gives for those."""
    times_s = np.cumsum(steps_s)
    positions_um = np.column_stack([np.sin(40 * times_s), times_s, times_s**2])
    history = PositionHistory()
    for time_s, position_um in zip(times_s, positions_um, strict=True):
        history.add(float(time_s), position_um)
    kept = times_s >= times_s[-1] - KEPT_S
    at_s = float(times_s[0]) - 0.1 + share * (float(times_s[-1] - times_s[0]) + 0.2)
    expected_um = [np.interp(at_s, times_s[kept], axis) for axis in positions_um[kept].T]
    np.testing.assert_allclose(history.at(at_s), expected_um, atol=1e-12)


def test_a_contact_began_with_its_first_report() -> None:
    """Several reports between two looks: the position is that of the first one that touched."""
    guard = ContactGuard()
    for k in range(50):
        guard.remember(0.001 * k, np.array([0.1 * k, 0.0, 0.0]))
    for k, touching in ((10, False), (20, True), (30, True), (40, True)):
        guard.note(ContactReport(0.001 * k, touching))
    found_um = guard.contact_um(begin_s=0.0, now_s=0.05)
    np.testing.assert_allclose(found_um, [2.0, 0.0, 0.0])
    guard.note(ContactReport(0.045, False))
    assert guard.contact_um(begin_s=0.0, now_s=0.05) is None
