# SPDX-License-Identifier: Apache-2.0
"""When setpoints stay away, come twice or come late: the stage holds, soon, and never jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stage_driver_sim.chunk import Chunk
from stage_driver_sim.controller import ControllerSettings, StageController
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.simulated_stage import SimulatedStage
from stage_driver_sim.snapshot import Mode, Snapshot

DECELERATION_UM_S2 = 1e6
"""The default of the driver."""
HOLD_S = 0.05
PERIOD_S = 0.002


class StreamBench:
    """A controller with the driver's default settings, ticked at 1 kHz."""

    def __init__(self) -> None:
        stage = SimulatedStage(
            REPRESENTATIVE_100_UM_XYZ,
            home_um=np.full(3, 20.0),
            rng=np.random.default_rng(6),
            now_s=0.0,
        )
        self.now_s = 0.0
        self.controller = StageController(
            stage,
            name='finger_2',
            settings=ControllerSettings(DECELERATION_UM_S2, 0.02, 0.02),
            now_s=0.0,
        )
        self.seen = [self.controller.tick(0.0)]

    @property
    def last(self) -> Snapshot:
        """What the latest tick saw."""
        return self.seen[-1]

    def run_until(self, time_s: float) -> Snapshot:
        """Tick until a time and return the last snapshot."""
        while self.now_s < time_s - 1e-9:
            self.now_s += 0.001
            self.seen.append(self.controller.tick(self.now_s))
        return self.last

    def chunk(self, speed_um_s: float, *, begin_s: float = 0.01, count: int = 10) -> Chunk:
        """Return the first chunk of a ramp from (20, 20, 20) µm along x."""
        way_um = speed_um_s * PERIOD_S * np.arange(count)
        return Chunk(
            time_s=begin_s,
            period_s=PERIOD_S,
            positions_um=np.full(3, 20.0) + np.outer(way_um, [1.0, 0.0, 0.0]),
            velocities_um_s=None,
            sequence=0,
            stream=1,
            last=False,
        )


@pytest.mark.parametrize('speed_um_s', [10.0, 100.0, 1000.0, 3400.0])
def test_it_holds_within_50_ms_after_the_last_setpoint(speed_um_s: float) -> None:
    """Nothing comes after the first chunk: 50 ms after its end the command is at rest."""
    bench = StreamBench()
    chunk = bench.chunk(speed_um_s)
    bench.controller.accept(chunk, 0.0)
    end_s = float(chunk.times_s()[-1])
    held = bench.run_until(end_s + HOLD_S)
    assert (held.mode, held.underruns, held.error_code) == (Mode.FAULT, 1, 303)
    still = [snapshot for snapshot in bench.seen if snapshot.time_s > end_s + 0.005]
    for snapshot in still:
        np.testing.assert_array_equal(snapshot.command_um, held.command_um)
    overrun_um = held.command_um[0] - chunk.positions_um[-1, 0]
    assert overrun_um == pytest.approx(speed_um_s**2 / (2.0 * DECELERATION_UM_S2), abs=1e-6)
    np.testing.assert_allclose(held.position_um, held.command_um, atol=0.05)


def test_chunks_that_come_twice_or_too_late_move_nothing() -> None:
    """A copy changes nothing; what is left of a stream that is over is dropped and counted."""
    bench = StreamBench()
    first = bench.chunk(100.0)
    second = replace(
        first,
        time_s=first.time_s + 10 * PERIOD_S,
        positions_um=first.positions_um + np.array([10 * 100.0 * PERIOD_S, 0.0, 0.0]),
        sequence=10,
        last=True,
    )
    for chunk in (first, first, second, first, second):
        bench.controller.accept(chunk, bench.now_s)
    assert bench.run_until(0.2).mode is Mode.HOLDING
    assert (bench.last.received, bench.last.dropped) == (20, 3)
    end_um = second.positions_um[-1]
    for chunk in (second, first):
        bench.controller.accept(chunk, bench.now_s)
    bench.controller.accept(replace(second, sequence=20, time_s=bench.now_s + 0.01), bench.now_s)
    assert bench.run_until(0.4).mode is Mode.HOLDING
    assert bench.last.dropped == 6
    np.testing.assert_array_equal(bench.last.command_um, end_um)
