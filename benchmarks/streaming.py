# SPDX-License-Identifier: Apache-2.0
"""Setpoints of three fingers over DDS: three stage drivers, and the same load in bare rclpy.

Usage: python benchmarks/streaming.py [--seconds 600] [--rates 500 1000]

Writes benchmarks/results/streaming.json and docs/reference/streaming.md. Real processes on this
machine; each rate takes twice the seconds.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import record
import streaming_bare
import streaming_page
from machine_probe import MachineProbe
from microhand_msgs_py.msg import StageState
from numpy.typing import NDArray

from microhand_node.inbox import Inbox
from microhand_node.qos import STATE
from microhand_planner.ros.conversions import um_from_point
from microhand_station.bringup.lifecycle import activate
from microhand_station.bringup.node_commands import node_commands
from microhand_station.bringup.processes import NodeProcess, end_processes
from microhand_station.client import StationClient
from microhand_station.config import StationConfig, write_config
from microhand_station.sequencer.setpoint_stream import Chunk
from microhand_station.sequencer.stage_link import StageLink
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ

CONFIG = StationConfig(
    namespace='streaming',
    fingers=tuple(
        replace(finger, driver={'realtime_priority': 50}) for finger in StationConfig().fingers
    ),
)
CHUNK_S = 0.05
LEAD_S = 0.4
"""As the sequencer: so much in a chunk, sent so long before it is due [s]."""
SWING_UM = 20.0
TURN_HZ = 0.5
SPEED_UM_S = 2.0 * math.pi * TURN_HZ * SWING_UM
TICK_S = 0.001
"""Period of a driver's control loop [s]."""
WARM_UP_S = 1.0
TICKS_PER_S = os.sysconf('SC_CLK_TCK')

Array = NDArray[np.float64]


def path_um(since_s: Array | float) -> Array:
    """Return where a tip is to be on x, from its home, at times since the begin."""
    return SWING_UM * np.sin(2.0 * math.pi * TURN_HZ * np.asarray(since_s))


def speed_um_s(since_s: Array | float) -> Array:
    """Return how fast it is to be there."""
    return SPEED_UM_S * np.cos(2.0 * math.pi * TURN_HZ * np.asarray(since_s))


def model_limit_um() -> float:
    """Return how far the stage model may be behind at the largest speed: servo, tick, noise."""
    axis = REPRESENTATIVE_100_UM_XYZ[0]
    lag_s = 2.0 * axis.damping_ratio / (2.0 * math.pi * axis.natural_frequency_Hz) + TICK_S
    return SPEED_UM_S * lag_s + 5.0 * axis.noise_rms_um + axis.resolution_um


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has used [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text(encoding='utf-8').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def three(values: Array, unit: float = 1.0) -> list[float]:
    """Return median, 99 % and largest."""
    return [round(float(x) / unit, 4) for x in np.percentile(values, [50.0, 99.0, 100.0])]


class Listener:
    """Keeps what the drivers report: time, position and command on x."""

    def __init__(self, client: StationClient) -> None:
        self.rows: dict[int, list[tuple[float, float, float]]] = {1: [], 2: [], 3: []}
        self.last: dict[int, StageState] = {}
        for finger in self.rows:
            client.node.create_subscription(
                StageState, f'finger_{finger}/state', self._note, STATE
            )

    def _note(self, state: StageState) -> None:
        finger = int(state.header.frame_id[7])
        stamp = state.header.stamp
        self.last[finger] = state
        self.rows[finger].append(
            (
                stamp.sec + 1e-9 * stamp.nanosec,
                float(um_from_point(state.position)[0]),
                float(um_from_point(state.command)[0]),
            )
        )


def stream(links: Iterable[StageLink], rate_hz: float, count: int, begin_ns: int) -> float:
    """Send `count` setpoints to each finger, chunk by chunk; return the worst delay [s]."""
    links, home = list(links), [np.add(f.home_um, f.base_um) for f in CONFIG.fingers]
    size, period_s = round(CHUNK_S * rate_hz), 1.0 / rate_hz
    begin_s = time.monotonic() + (begin_ns - time.time_ns()) * 1e-9
    worst_s = 0.0
    for first in range(0, count, size):
        numbers = np.arange(first, min(first + size, count))
        tips = np.stack([np.tile(tip, (len(numbers), 1)) for tip in home], axis=1)
        tips[..., 0] += path_um(numbers * period_s)[:, None]
        velocities = np.zeros_like(tips)
        velocities[..., 0] = speed_um_s(numbers * period_s)[:, None]
        chunk = Chunk(first, tips, velocities, last=bool(numbers[-1] == count - 1))
        due_s = begin_s + first * period_s - LEAD_S
        time.sleep(max(0.0, due_s - time.monotonic()))
        worst_s = max(worst_s, time.monotonic() - due_s)
        for link in links:
            link.send(chunk, 1, begin_ns, period_s, guarded=False)
    return worst_s


def ours(rate_hz: float, seconds: float, folder: Path) -> dict[str, Any]:
    """Stream to three stage drivers, and return the figures."""
    folder.mkdir()
    write_config(CONFIG, folder / 'station.yaml')
    drivers = [
        NodeProcess(node.name, node.module, node.arguments, folder / f'{node.name}.log', {})
        for node in node_commands(CONFIG, folder)
        if node.name.startswith('finger_')
    ]
    count = round(seconds * rate_hz)
    try:
        with StationClient(CONFIG.namespace) as client:
            listener = Listener(client)
            inbox = Inbox(client.node)  # only what is sent is measured here
            links = [StageLink(client.node, inbox, f, CONFIG.fingers[f - 1]) for f in (1, 2, 3)]
            for finger in (1, 2, 3):
                name = f'finger_{finger}'
                activate(client.node, f'{name}/stage_driver', who=name, deadline_s=60.0)
            wait(lambda: all('stage_driver' in link.listeners() for link in links))
            wait(lambda: all(f in listener.last and listener.last[f].on_target for f in (1, 2, 3)))
            before = {process.name: cpu_s(process.pid) for process in drivers}
            before['sender'] = time.process_time()
            began_s = time.monotonic()
            steady_s = began_s - time.time()
            with MachineProbe(folder) as probe:
                begin_ns = time.time_ns() + round((LEAD_S + 0.1) * 1e9)
                worst_s = stream(links, rate_hz, count, begin_ns)
                wait(lambda: all(s.mode != StageState.STREAMING for s in listener.last.values()))
            wall_s = time.monotonic() - began_s
            used = {process.name: cpu_s(process.pid) for process in drivers}
            used['sender'] = time.process_time()
            last = dict(listener.last)
    finally:
        end_processes(drivers)
    return {
        'way': 'microhand: chunks of 50 ms to stage drivers',
        'rate_hz': rate_hz,
        'setpoints': 3 * count,
        'lost': sum(count - int(state.received) for state in last.values()),
        'reordered': sum(state.error_code != 0 for state in last.values()),
        'underruns': sum(int(state.underruns) for state in last.values()),
        'sender_late_ms': round(1e3 * worst_s, 3),
        **judge(listener.rows, begin_ns * 1e-9, seconds, probe, steady_s),
        **probe.figures(),
        'cpu_percent': {
            name: round(100.0 * (used[name] - before[name]) / wall_s, 1) for name in sorted(used)
        },
    }


def judge(
    rows: Mapping[int, list[tuple[float, float, float]]],
    begin_s: float,
    seconds: float,
    probe: MachineProbe,
    steady_s: float,
) -> dict[str, Any]:
    """Compare where tips were with where they were to be at the same time.

    Once for all moments, and once without those at which the machine itself was away;
    `steady_s` leads from the clock of the stamps to the one of the probe.
    """
    lags, errors, times = [], [], []
    for finger, home in zip((1, 2, 3), CONFIG.fingers, strict=True):
        since_s, position_um, _ = (np.array(rows[finger]) - [begin_s, home.home_um[0], 0.0]).T
        inside = (since_s > WARM_UP_S) & (since_s < seconds - 0.1)
        since_s, error_um = since_s[inside], (path_um(since_s) - position_um)[inside]
        speed = speed_um_s(since_s)
        fast = np.abs(speed) > 0.7 * SPEED_UM_S
        errors.append((since_s, np.abs(error_um)))
        lags.append((error_um / speed)[fast])
        times.append(since_s[fast])
    nearest = [np.clip(np.searchsorted(t, times[0]), 0, len(t) - 1) for t in times]
    together = np.stack([lag[at] for lag, at in zip(lags, nearest, strict=True)])
    skew_s = together.max(axis=0) - together.min(axis=0)
    served = ~np.any(
        [probe.away(t[at] + begin_s + steady_s) for t, at in zip(times, nearest, strict=True)],
        axis=0,
    )
    error_s, error_um = np.concatenate(errors, axis=1)
    there = ~probe.away(error_s + begin_s + steady_s)
    return {
        'tracking_nm': three(error_um, 1e-3),
        'tracking_served_nm': three(error_um[there], 1e-3),
        'model_limit_nm': round(1e3 * model_limit_um(), 1),
        'lag_ms': three(np.concatenate(lags), 1e-3),
        'skew_ms': three(skew_s, 1e-3),
        'skew_served_ms': three(skew_s[served], 1e-3),
        'served_percent': round(100.0 * float(served.mean()), 2),
        'skew_over_1ms_percent': round(100.0 * float((skew_s > 1e-3).mean()), 4),
    }


def bare(rate_hz: float, seconds: float, folder: Path) -> dict[str, Any]:
    """Send the same setpoints one by one to three receivers that do nothing with them."""
    folder.mkdir()
    count = round(seconds * rate_hz)

    def run(role: str, first: float) -> subprocess.Popen[bytes]:
        file = str(folder / f'{role}_{first:g}.npy')
        script = str(Path(streaming_bare.__file__))
        return subprocess.Popen([sys.executable, script, role, f'{first:g}', str(count), file])

    processes = {f'finger_{f}': run('receive', f) for f in (1, 2, 3)}
    processes['sender'] = run('send', rate_hz)
    begin_s = time.monotonic()
    used = {}
    with MachineProbe(folder) as probe:
        while processes['sender'].poll() is None:
            used = {
                name: cpu_s(process.pid)
                for name, process in processes.items()
                if process.poll() is None
            }
            time.sleep(0.2)
    wall_s = time.monotonic() - begin_s
    for process in processes.values():
        process.wait()
    sent_s = np.load(folder / f'send_{rate_hz:g}.npy')
    arrivals = [np.load(folder / f'receive_{f}.npy') for f in (1, 2, 3)]
    at_s = np.full((3, count), np.nan)
    for row, arrived in zip(at_s, arrivals, strict=True):
        row[arrived[:, 0].astype(int)] = arrived[:, 1]
    skew_s = np.nanmax(at_s, axis=0) - np.nanmin(at_s, axis=0)
    served = ~probe.away(sent_s) & ~probe.away(np.nanmax(at_s, axis=0))
    return {
        'way': 'bare rclpy: one message per setpoint',
        'rate_hz': rate_hz,
        'setpoints': 3 * count,
        'lost': int(np.isnan(at_s).sum()),
        'reordered': sum(int((np.diff(arrived[:, 0]) < 1).sum()) for arrived in arrivals),
        'sent_hz': round(float(count - 1) / float(sent_s[-1] - sent_s[0]), 1),
        'period_ms': three(np.diff(sent_s), 1e-3),
        'latency_ms': three((at_s - sent_s)[~np.isnan(at_s)], 1e-3),
        'skew_ms': three(skew_s, 1e-3),
        'skew_served_ms': three(skew_s[served], 1e-3),
        'served_percent': round(100.0 * float(served.mean()), 2),
        'skew_over_1ms_percent': round(100.0 * float((skew_s > 1e-3).mean()), 4),
        **probe.figures(),
        'cpu_percent': {name: round(100.0 * spent / wall_s, 1) for name, spent in used.items()},
    }


def wait(condition: Any, deadline_s: float = 60.0) -> None:
    """Return when a condition holds."""
    give_up_s = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > give_up_s:
            raise RuntimeError('the drivers do not come to rest')
        threading.Event().wait(0.02)


def main() -> None:
    """Measure, and write results and page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=600.0)
    parser.add_argument('--rates', type=float, nargs='+', default=[500.0, 1000.0])
    arguments = parser.parse_args()
    os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as name:
        for rate_hz in arguments.rates:
            for way in (ours, bare):
                load = os.getloadavg()[0]
                folder = Path(name) / f'{way.__name__}_{rate_hz:g}'
                row = way(rate_hz, arguments.seconds, folder)
                about = {'seconds': arguments.seconds, 'load_before': round(load, 2)}
                rows.append({**row, **about, 'nice': os.nice(0)})
                print(rows[-1], flush=True)
    record.write('streaming', rows, ('numpy', 'ros-rclpy'))
    print(streaming_page.write())


if __name__ == '__main__':
    main()
