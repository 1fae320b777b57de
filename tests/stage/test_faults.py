# SPDX-License-Identifier: Apache-2.0
"""Faults on demand: what each does to a stage, and what its driver then says."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from stage_driver_sim.chunk import Chunk
from stage_driver_sim.controller import ControllerSettings, StageController
from stage_driver_sim.errors import InvalidParameter, StageFailed, StageSilent
from stage_driver_sim.faults import Fault, FaultSettings, FaultyStage
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.simulated_stage import SimulatedStage
from stage_driver_sim.snapshot import Mode, Snapshot

SPEED_UM_S = 20.0
ON_TARGET_UM = 0.02


class FaultBench:
    """A controller on a faulty stage at (50, 50, 50) µm, ticked at 1 kHz."""

    def __init__(self) -> None:
        self.stage = FaultyStage(
            SimulatedStage(
                REPRESENTATIVE_100_UM_XYZ,
                home_um=np.full(3, 50.0),
                rng=np.random.default_rng(9),
                now_s=0.0,
            )
        )
        self.now_s = 0.0
        self.controller = StageController(
            self.stage,
            name='finger_2',
            settings=ControllerSettings(1e5, ON_TARGET_UM, 0.02),
            now_s=self.now_s,
        )
        self.seen = [self.controller.tick(self.now_s)]
        self.run(0.1)

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

    def fail(self, fault: Fault, **sizes: float) -> None:
        """Let something go wrong."""
        self.stage.set_fault(FaultSettings(fault, **sizes), self.now_s)

    def ramp(self, count: int = 200) -> None:
        """Send a ramp along x and y that begins in 10 ms where the stage holds."""
        way_um = SPEED_UM_S * 0.002 * np.arange(count)
        self.controller.accept(
            Chunk(
                time_s=self.now_s + 0.01,
                period_s=0.002,
                positions_um=self.last.command_um + np.outer(way_um, [1.0, -1.0, 0.0]),
                velocities_um_s=None,
                sequence=0,
                stream=self.last.stream + 1,
                last=True,
            ),
            self.now_s,
        )

    def positions_um(self) -> NDArray[np.float64]:
        """Return all positions so far, (n, 3)."""
        return np.array([snapshot.position_um for snapshot in self.seen])


@pytest.fixture
def bench() -> FaultBench:
    """Return a bench that holds on target."""
    bench = FaultBench()
    assert bench.last.on_target
    return bench


def test_without_a_fault_it_is_the_stage_itself(bench: FaultBench) -> None:
    """A ramp is followed to its end; every reading is that of the stage without the wrapper."""
    bare = SimulatedStage(
        REPRESENTATIVE_100_UM_XYZ,
        home_um=np.full(3, 50.0),
        rng=np.random.default_rng(9),
        now_s=0.0,
    )
    controller = StageController(
        bare, name='finger_2', settings=ControllerSettings(1e5, ON_TARGET_UM, 0.02), now_s=0.0
    )
    alone_um = [controller.tick(snapshot.time_s).position_um for snapshot in bench.seen]
    np.testing.assert_array_equal(bench.positions_um(), alone_um)
    bench.ramp()
    assert bench.run(1.0).on_target


def test_stuck_the_position_stays_while_the_command_goes_on(bench: FaultBench) -> None:
    """No error, off target; freed, the stage goes to its command, no faster than it may."""
    bench.fail(Fault.STUCK)
    bench.ramp()
    stuck = bench.run(1.0)
    assert (stuck.mode, stuck.error_code, stuck.on_target) == (Mode.HOLDING, 0, False)
    np.testing.assert_allclose(stuck.position_um, 50.0, atol=0.01)
    np.testing.assert_allclose(stuck.command_um, [57.96, 42.04, 50.0], atol=1e-9)
    bench.fail(Fault.NONE)
    assert bench.run(0.2).on_target
    assert np.abs(np.diff(bench.positions_um(), axis=0)).max() < 3500.0 * 0.001 * 1.1


def test_stuck_it_never_comes_home_but_can_be_stopped(bench: FaultBench) -> None:
    """`home` does not end and moves nothing, until a stop ends it."""
    bench.fail(Fault.STUCK)
    bench.controller.home(bench.now_s)
    assert bench.run(1.0).mode is Mode.HOMING
    bench.controller.stop(bench.now_s)
    assert bench.run(0.01).mode is Mode.STOPPED
    np.testing.assert_allclose(bench.last.position_um, 50.0, atol=0.01)


@pytest.mark.parametrize('moving', [False, True])
def test_silent_it_is_a_fault_at_once_and_is_taken_over_by_reset(
    bench: FaultBench, moving: bool
) -> None:
    """FAULT with STAGE_FAULT, last position with its own time; `reset` works when it answers."""
    if moving:
        bench.ramp()
        bench.run(0.1)
    known = bench.last
    bench.fail(Fault.SILENT)
    lost = bench.run(0.3)
    assert (lost.mode, lost.error_code, lost.on_target) == (Mode.FAULT, 301, False)
    assert lost.error_msg == 'finger_2: the stage does not answer'
    assert lost.time_s == known.time_s
    np.testing.assert_array_equal(lost.position_um, known.position_um)
    assert [event.code for event in bench.controller.take_events()] == [301]
    with pytest.raises(StageSilent):
        bench.controller.reset(bench.now_s)
    assert not bench.controller.moving

    bench.fail(Fault.NONE)
    assert bench.run(0.05).mode is Mode.FAULT  # until somebody says that all is well
    before_um = bench.last.position_um
    bench.controller.reset(bench.now_s)
    assert bench.run(0.1).mode is Mode.HOLDING
    assert bench.last.on_target
    np.testing.assert_allclose(bench.last.position_um, before_um, atol=0.01)


def test_silent_while_homing_cannot_be_stopped_and_is_not_commanded_later(
    bench: FaultBench,
) -> None:
    """A stop that does not reach the stage is followed by a fault, not by a motion."""
    bench.ramp()
    bench.run(1.0)
    bench.controller.home(bench.now_s)
    bench.run(0.002)
    bench.fail(Fault.SILENT)
    bench.controller.stop(bench.now_s)
    assert bench.run(0.01).mode is Mode.FAULT
    bench.fail(Fault.NONE)
    bench.run(0.2)
    np.testing.assert_allclose(bench.last.position_um, 50.0, atol=0.01)  # it went home by itself


def test_late_the_position_follows_by_the_delay(bench: FaultBench) -> None:
    """Along a ramp the stage is behind by speed x (delay and the lag of its loop)."""
    bench.fail(Fault.LATE, delay_s=0.05)
    bench.ramp()
    bench.run(0.2)
    behind_um = bench.last.command_um - bench.last.position_um
    lag_s = 0.05 + 2.0 * 0.7 / (2.0 * np.pi * 150.0)
    np.testing.assert_allclose(behind_um[:2], [SPEED_UM_S * lag_s, -SPEED_UM_S * lag_s], rtol=0.05)
    assert not bench.last.on_target
    assert bench.run(0.5).on_target


def test_drifting_the_position_runs_away_at_its_rate(bench: FaultBench) -> None:
    """Holding, it leaves its command at the stated rate, is off target, and reports no error."""
    bench.fail(Fault.DRIFTING, drift_um_s=2.0)
    gone = bench.run(1.0)
    np.testing.assert_allclose(gone.position_um - gone.command_um, 2.0, atol=0.02)
    assert (gone.mode, gone.error_code, gone.on_target) == (Mode.HOLDING, 0, False)
    bench.fail(Fault.DRIFTING, drift_um_s=1e4)
    np.testing.assert_allclose(bench.run(0.2).position_um, 100.0, atol=0.1)


def test_at_its_limit_it_stops_and_says_which_axis_where(bench: FaultBench) -> None:
    """A ramp beyond the limit: FAULT with axis, limit and command; the stage stays at it."""
    bench.fail(Fault.LIMIT, margin_um=0.3)
    bench.ramp()
    hit = bench.run(0.5)
    assert (hit.mode, hit.error_code, hit.on_target) == (Mode.FAULT, 301, False)
    assert re.match(r'finger_2: [xy]: ran into its limit at \d+\.\d{3} µm, comm', hit.error_msg)

    assert np.abs(hit.position_um - 50.0).max() == pytest.approx(0.3, abs=0.02)
    bench.fail(Fault.NONE)
    bench.controller.reset(bench.now_s)
    assert bench.run(0.1).on_target


def test_home_beyond_the_limit_is_refused(bench: FaultBench) -> None:
    """Where the stage cannot come, it does not set off for."""
    bench.ramp()
    bench.run(1.0)
    bench.fail(Fault.LIMIT)
    with pytest.raises(StageFailed, match='ran into its limit'):
        bench.controller.home(bench.now_s)


@pytest.mark.parametrize(
    ('field', 'value'), [('delay_s', -0.1), ('drift_um_s', math.nan), ('margin_um', math.inf)]
)
def test_impossible_sizes_are_refused(field: str, value: float) -> None:
    """A size that is negative or no number is refused by name."""
    sizes: dict[str, Any] = {field: value}
    with pytest.raises(InvalidParameter, match=field):
        FaultSettings(Fault.LATE, **sizes)
