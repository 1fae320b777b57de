# SPDX-License-Identifier: Apache-2.0
"""How long an emergency stop takes, from the call of a client until all three stages stand.

Usage: python benchmarks/emergency_stop.py [STOPS]     (default 20)

A station of real processes executes a plan, and is stopped at some moment of a motion; each time
it is reset and begins anew. Drivers report at 100 Hz: so exact is when a stage stands.
"""

from __future__ import annotations

import contextlib
import math
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import record
from microhand_msgs_py.msg import RunEvent, StageState
from scipy.spatial.transform import Rotation

from microhand_node.qos import EVENTS, STATE
from microhand_planner.core.errors import MicrohandError
from microhand_planner.core.plan import Plan
from microhand_planner.core.pose import Pose
from microhand_planner.ros.conversions import um_from_point
from microhand_station.bringup.station import RunningStation
from microhand_station.client import StationClient
from microhand_station.config import StationConfig
from microhand_station.recording_config import RecordingConfig

FINGERS = (1, 2, 3)
STANDS_UM = 0.007
"""A tip stands when it is nearer than this to where it will be: seven times the sensor noise."""
MOVES_UM_S = 5.0
"""A tip that is faster than this moves."""
GIVE_UP_S = 60.0


class Watch:
    """What the drivers say: when they were told to stop, and where their stages are."""

    def __init__(self, client: StationClient) -> None:
        self.stopped_s: list[float] = []
        self.rows: dict[int, list[tuple[float, np.ndarray]]] = {finger: [] for finger in FINGERS}
        self.fastest_um_s = 0.0
        client.node.create_subscription(RunEvent, 'events', self._on_event, EVENTS)
        for finger in FINGERS:
            client.node.create_subscription(
                StageState, f'finger_{finger}/state', self._on_state, STATE
            )

    def _on_event(self, event: RunEvent) -> None:
        if event.text.endswith(': stopped'):
            self.stopped_s.append(seconds(event))

    def _on_state(self, state: StageState) -> None:
        finger = int(state.header.frame_id[7])
        self.rows[finger].append((seconds(state), um_from_point(state.position)))
        velocity = 1e6 * np.array([state.velocity.x, state.velocity.y, state.velocity.z])
        if state.mode == StageState.STREAMING:
            self.fastest_um_s = max(0.9 * self.fastest_um_s, float(np.linalg.norm(velocity)))

    def wait(self, condition: Callable[[], bool]) -> None:
        """Return when a condition holds."""
        give_up_s = time.monotonic() + GIVE_UP_S
        while not condition():
            if time.monotonic() > give_up_s:
                raise RuntimeError('waited in vain')
            time.sleep(0.002)


def seconds(message: RunEvent | StageState) -> float:
    """Return the stamp of a message [s]."""
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec)


@contextlib.contextmanager
def executing(client: StationClient, plan: Plan) -> Iterator[None]:
    """Execute a plan in another thread, whose end is a stop."""

    def execute() -> None:
        with contextlib.suppress(MicrohandError):
            client.execute(plan)

    thread = threading.Thread(target=execute)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def one_stop(client: StationClient, watch: Watch, plan: Plan, after_s: float) -> dict[str, object]:
    """Stop a run that has been moving for a while; return the delays [s]."""
    watch.stopped_s.clear()
    watch.fastest_um_s = 0.0
    with executing(client, plan):
        watch.wait(lambda: watch.fastest_um_s > MOVES_UM_S)
        time.sleep(after_s)
        watch.wait(lambda: watch.fastest_um_s > MOVES_UM_S)
        speed_um_s = watch.fastest_um_s
        for rows in watch.rows.values():
            rows.clear()
        called_s = time.time()
        client.command('emergency_stop')
        answered_s = time.time()
        watch.wait(lambda: len(watch.stopped_s) == len(FINGERS))
        time.sleep(0.3)
    stands_s = []
    for finger in FINGERS:
        times_s, places_um = zip(*watch.rows[finger], strict=True)
        end_um = np.mean(places_um[-10:], axis=0)
        away_um = np.abs(np.array(places_um) - end_um).max(axis=1)
        moving = np.flatnonzero(away_um > STANDS_UM)
        stands_s.append(times_s[moving[-1] + 1] if len(moving) else called_s)
    client.command('reset')
    return {
        'speed_um_s': round(speed_um_s, 1),
        'told_ms': round(1e3 * (max(watch.stopped_s) - called_s), 2),
        'stand_ms': round(1e3 * (max(stands_s) - called_s), 2),
        'answered_ms': round(1e3 * (answered_s - called_s), 2),
    }


def main() -> None:
    """Stop again and again, and write the figures."""
    stops = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    config = StationConfig(namespace='stops', recording=RecordingConfig(required=False))
    goal = Pose.of((0, 0, 0), Rotation.from_euler('ZYZ', [80, 220, 100], degrees=True))
    rows = []
    with (
        tempfile.TemporaryDirectory() as folder,
        RunningStation(config, Path(folder) / 'station', None, print),
        StationClient(config.namespace) as client,
    ):
        watch = Watch(client)
        plan = client.plan('ellipsoid', Pose(), goal).plan
        for number in range(stops):
            rows.append(
                one_stop(client, watch, plan, after_s=0.5 * math.fmod(0.618 * number, 1.0))
            )
            print(rows[-1], flush=True)
    print(record.write('emergency_stop', rows, ('ros-rclpy',)))
    for key in ('told_ms', 'stand_ms', 'answered_ms'):
        middle, most = np.percentile([row[key] for row in rows], [50.0, 100.0])
        print(f'{key}: median {middle:.1f}, largest {most:.1f}')


if __name__ == '__main__':
    main()
