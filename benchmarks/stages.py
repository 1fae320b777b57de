# SPDX-License-Identifier: Apache-2.0
"""What stages cost: the model per millisecond, and a GCS controller on loopback per cycle.

Usage: python benchmarks/stages.py [SECONDS]     (of each measurement, default 5)
"""

from __future__ import annotations

import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from stage_driver_sim.gcs.connection import TcpConnection
from stage_driver_sim.gcs.gcs_stage import GcsStage
from stage_driver_sim.model import at_rest, make_model, step
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.protocol import StageLimits
from stage_driver_sim.remote_stage import RemoteStage
from stage_driver_sim.servo import SAMPLE_S

LIMITS = StageLimits(np.zeros(3), np.full(3, 100.0), np.full(3, 50.0), 3500.0)
SERVER = Path(sys.executable).with_name('gcs_server')
TICK_S = 0.001


def model_cost(duration_s: float) -> None:
    """Print the processor time of three axes, commanded at 1 kHz."""
    model = make_model(REPRESENTATIVE_100_UM_XYZ)
    state, rng = at_rest(model, np.full(3, 50.0)), np.random.default_rng(0)
    samples, ticks = round(TICK_S / SAMPLE_S), round(duration_s / TICK_S)
    state = step(model, state, np.full(3, 50.0), samples, rng)
    begin_s = time.process_time()
    for k in range(ticks):
        state = step(model, state, np.full(3, 50.0 + 5.0 * np.sin(0.01 * k)), samples, rng)
    per_tick_s = (time.process_time() - begin_s) / ticks
    print(
        f'model, 3 axes, {samples} samples of the servo per ms: {1e6 * per_tick_s:.1f} µs per ms'
    )


def round_trips(port: int, count: int) -> None:
    """Print how long ``MOV`` of three axes and ``POS?`` take, one after the other."""
    connection = TcpConnection('127.0.0.1', port)
    stage = GcsStage(connection, axes=('1', '2', '3'), limits=LIMITS, now_s=0.0)
    stage.set_servo(True, 0.0)
    took_s = []
    for k in range(count):
        begin_s = time.monotonic()
        stage.command_um(np.full(3, 50.0 + 5.0 * np.sin(0.01 * k)), 0.0)
        stage.measure_um(0.0)
        took_s.append(time.monotonic() - begin_s)
    stage.close()
    middle, late, worst = np.percentile(took_s, [50.0, 99.0, 100.0]) * 1e3
    print(
        f'GCS, MOV and POS? of 3 axes: {middle:.2f} ms, 99 % {late:.2f} ms, worst {worst:.2f} ms'
    )


def streaming(port: int, rate_hz: float, duration_s: float) -> None:
    """Print the rate at which a stage is commanded and read while a loop commands it at 1 kHz."""

    def connect(at_port: int, now_s: float) -> GcsStage:
        connection = TcpConnection('127.0.0.1', at_port)
        return GcsStage(connection, axes=('1', '2', '3'), limits=LIMITS, now_s=now_s)

    stage = RemoteStage(partial(connect, port), period_s=1.0 / rate_hz)
    stage.set_servo(True, time.monotonic())
    ages_s = []
    begin_s, begin_cpu_s, begin = time.monotonic(), time.process_time(), stage.cycles
    while (now_s := time.monotonic()) < begin_s + duration_s:
        swing_um = 5.0 * np.sin(10.0 * (now_s - begin_s))
        stage.command_um(np.full(3, 50.0 + swing_um), now_s)
        stage.measure_um(now_s)
        ages_s.append(now_s - stage.measured_s)
        time.sleep(TICK_S)
    wall_s = time.monotonic() - begin_s
    share = (time.process_time() - begin_cpu_s) / wall_s
    rate = (stage.cycles - begin) / wall_s
    stage.close()
    middle, late = np.percentile(ages_s, [50.0, 99.0]) * 1e3
    print(
        f'GCS at {rate_hz:g} Hz: {rate:.0f} cycles/s, readings {middle:.1f} ms old '
        f'(99 % {late:.1f} ms), {100.0 * share:.0f} % of a core with the loop that commands it'
    )


def main() -> None:
    """Measure, print."""
    duration_s = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    model_cost(duration_s)
    server = subprocess.Popen(
        [str(SERVER), '--port=0', '--travel-um', '0', '100'], stdout=subprocess.PIPE, text=True
    )
    try:
        greeting = server.stdout.readline() if server.stdout else ''
        port = int(greeting.rpartition(':')[2])
        round_trips(port, 2000)
        for rate_hz in (500.0, 1000.0):
            streaming(port, rate_hz, duration_s)
        ticks = Path(f'/proc/{server.pid}/stat').read_text().rpartition(')')[2].split()
        print(f'GCS server: {(int(ticks[11]) + int(ticks[12])) / 100.0:.1f} s of processor time')
    finally:
        server.terminate()
        server.wait()


if __name__ == '__main__':
    main()
