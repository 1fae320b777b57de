# SPDX-License-Identifier: Apache-2.0
"""Trajectory to chunks: the setpoints of one stream, cut to the size of a message, stoppable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microhand_planner.core.pose import FloatArray
from microhand_planner.core.trajectory import Trajectory

CHUNK = 25
"""Setpoints in a chunk: 50 ms at 500 Hz."""


@dataclass(frozen=True)
class Chunk:
    """Consecutive setpoints of all fingers.

    Parameters
    ----------
    first : int
        Number of the first setpoint in the stream.
    tip_um, velocity_um_s : (n, 3, 3) float
        Setpoints of fingers 1, 2, 3, station frame [µm], [µm/s].
    last : bool
        The stream ends with this chunk.
    """

    first: int
    tip_um: FloatArray
    velocity_um_s: FloatArray
    last: bool


class SetpointStream:
    """Hands out a trajectory chunk by chunk, from one setpoint on; it can be cut short.

    Without interference the chunks, put together, are the trajectory. `pause` lets the stream
    end with the step that is being executed; `ramp_down` makes it leave the time law, but not the
    path: the fingers brake along it and stand.

    Parameters
    ----------
    trajectory : Trajectory
        What to stream.
    begin : int
        Setpoint of the trajectory that the stream begins with; the fingers are at rest there.
    """

    def __init__(self, trajectory: Trajectory, begin: int = 0) -> None:
        self._trajectory = trajectory
        self._begin = begin
        self._end = len(trajectory)
        self._tail: tuple[FloatArray, FloatArray] | None = None
        self._tail_from = 0
        self.sent = 0
        """Setpoints handed out so far."""

    @property
    def finished(self) -> bool:
        """Whether the last chunk has been handed out."""
        return self.sent == self.length

    @property
    def length(self) -> int:
        """Setpoints of the stream, as things stand."""
        if self._tail is not None:
            return self._tail_from + len(self._tail[0])
        return self._end - self._begin

    @property
    def position(self) -> int:
        """Setpoint of the trajectory that was handed out last; does not move on a ramp."""
        handed_out = self.sent if self._tail is None else self._tail_from
        return self._begin + max(handed_out - 1, 0)

    def due(self, periods: int) -> int:
        """Return the setpoint of the trajectory that is due, `periods` after the first one."""
        return min(self._begin + max(periods, 0), self.position)

    def next_chunk(self, size: int = CHUNK) -> Chunk:
        """Return the next chunk, of `size` setpoints or what is left."""
        first, stop = self.sent, min(self.sent + size, self.length)
        if self._tail is None:
            rows = slice(self._begin + first, self._begin + stop)
            tip, velocity = self._trajectory.tip_um[rows], self._trajectory.velocity_um_s[rows]
        else:
            rows = slice(first - self._tail_from, stop - self._tail_from)
            tip, velocity = self._tail[0][rows], self._tail[1][rows]
        self.sent = stop
        return Chunk(first, tip, velocity, last=stop == self.length)

    def pause(self) -> None:
        """End the stream with the step of the next setpoint: everything is at rest there."""
        if self._tail is None and not self.finished:
            self._end = 1 + self._step_end(self._begin + self.sent)

    def ramp_down(self, duration_s: float) -> None:
        """Replace what has not been handed out by a ramp to standstill along the path.

        The rate at which the trajectory is followed falls smoothly from 1 to 0. The ramp does
        not go beyond the end of the step, where the fingers stand anyway.
        """
        if self.finished or self._tail is not None:
            return
        if self.sent == 0:
            # nothing has moved: one setpoint that says so
            self._tail = self._trajectory.tip_um[[self._begin]], np.zeros((1, 3, 3))
            return
        period_s = self._trajectory.period_s
        count = max(2, round(duration_s / period_s))
        x = np.arange(1, count + 1) / count
        rate = 1.0 - x**2 * (3.0 - 2.0 * x)
        followed = count * (x - x**3 + x**4 / 2.0)  # integral of the rate, in setpoints
        here = self._begin + self.sent - 1
        self._tail = _along(self._trajectory, here + followed, rate, self._step_end(here))
        self._tail_from = self.sent

    def _step_end(self, setpoint: int) -> int:
        """Return the last setpoint of the step that a setpoint belongs to."""
        ends = self._trajectory.step_end
        return int(ends[np.searchsorted(ends, setpoint)])


def _along(
    trajectory: Trajectory, setpoint: FloatArray, rate: FloatArray, end: int
) -> tuple[FloatArray, FloatArray]:
    """Evaluate a trajectory at fractional setpoints up to `end`, followed at `rate`."""
    at = np.minimum(setpoint, float(end))
    index = np.minimum(at.astype(np.int64), end - 1)
    x = (at - index)[:, None, None]
    p0, p1 = trajectory.tip_um[index], trajectory.tip_um[index + 1]
    m0 = trajectory.velocity_um_s[index] * trajectory.period_s
    m1 = trajectory.velocity_um_s[index + 1] * trajectory.period_s
    chord = p1 - p0
    bend, twist = 3 * chord - 2 * m0 - m1, m0 + m1 - 2 * chord
    tip = p0 + x * (m0 + x * (bend + x * twist))
    slope = (m0 + x * (2 * bend + 3 * x * twist)) / trajectory.period_s
    moving = np.where(setpoint < end, rate, 0.0)
    return tip, slope * moving[:, None, None]
