# SPDX-License-Identifier: Apache-2.0
"""Chunks of setpoints → the command at any time: one stream, checked as it grows, interpolated.

Between two setpoints the command is the cubic Hermite polynomial through both positions and
velocities, so position and velocity are continuous. A stream is a value: a refused chunk leaves
it as it was.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from stage_driver_sim.chunk import Chunk
from stage_driver_sim.errors import LeftoverChunk, StreamBroken, TravelExceeded
from stage_driver_sim.protocol import AXES, StageLimits, Vector

START_TOLERANCE_UM = 0.1
"""Largest distance between where the stage holds and where a stream begins, per axis."""
MAX_LEAD_S = 10.0
"""A stream that begins later than this from now betrays a clock that is off."""
REMEMBERED_CHUNKS = 100
"""Chunks kept to recognise duplicates; the depth of the setpoint queue."""


class Phase(Enum):
    """Where a moment lies in a stream."""

    WAITING = 'before the first setpoint'
    RUNNING = 'between two setpoints'
    DONE = 'after the last setpoint of a stream that has ended'
    DRY = 'after the last setpoint received, the end not seen'


@dataclass(frozen=True, eq=False)
class StreamCommand:
    """What a stream commands at one moment."""

    phase: Phase
    position_um: Vector
    velocity_um_s: Vector


@dataclass(frozen=True, eq=False)
class SetpointStream:
    """The setpoints of one stream that still matter, in order and without a gap.

    Made by `accept_chunk` only.
    """

    number: int
    begin_s: float
    times_s: tuple[float, ...]
    positions_um: NDArray[np.float64]
    velocities_um_s: NDArray[np.float64]
    received: int
    ended: bool
    guarded: bool
    recent: tuple[Chunk, ...]

    def command_at(self, time_s: float) -> StreamCommand:
        """Return position and velocity at `time_s` [s].

        Before the first setpoint it is the first position; after the last one it is the last
        position, and if the stream ran dry with its velocity: what a brake has to take over.
        """
        after = bisect_right(self.times_s, time_s)
        if after == 0:
            return StreamCommand(Phase.WAITING, self.positions_um[0], np.zeros(3))
        if after == len(self.times_s):
            if self.ended:
                return StreamCommand(Phase.DONE, self.positions_um[-1], np.zeros(3))
            dry = time_s > self.times_s[-1]
            return StreamCommand(
                Phase.DRY if dry else Phase.RUNNING,
                self.positions_um[-1],
                self.velocities_um_s[-1],
            )
        begin = after - 1
        h = self.times_s[after] - self.times_s[begin]
        s = (time_s - self.times_s[begin]) / h
        rest = 1.0 - s
        p0, p1 = self.positions_um[begin], self.positions_um[after]
        v0, v1 = self.velocities_um_s[begin], self.velocities_um_s[after]
        share = s * s * (1.0 + 2.0 * rest)
        slope = 6.0 * s * rest / h
        rise = p1 - p0
        return StreamCommand(
            Phase.RUNNING,
            p0 + share * rise + (h * s * rest * rest) * v0 - (h * s * s * rest) * v1,
            slope * rise + (rest * (1.0 - 3.0 * s)) * v0 - (s * (2.0 - 3.0 * s)) * v1,
        )


def accept_chunk(
    stream: SetpointStream | None,
    chunk: Chunk,
    *,
    running: bool,
    limits: StageLimits,
    held_um: Vector,
    now_s: float,
) -> SetpointStream:
    """Return the stream with `chunk` added, or a new stream that `chunk` begins.

    Parameters
    ----------
    stream : SetpointStream or None
        The latest stream, running or over; None: there was none yet.
    chunk : Chunk
        What arrived. An exact duplicate changes nothing.
    running : bool
        True: `stream` is being followed; only then can it grow.
    limits : StageLimits
        What the stage can do.
    held_um : (3,) ndarray
        Where the stage holds [µm]: a new stream has to begin there.
    now_s : float
        Time of arrival [s].

    Raises
    ------
    InvalidNumber, TravelExceeded
        A setpoint beyond the travel or the velocity limit, or a start away from `held_um`.
    StreamBroken
        A gap, an overlap, a time that does not fit, an old stream number, a start in the past.
    LeftoverChunk
        The rest of a stream that is over.
    """
    if stream is not None and chunk.stream == stream.number:
        if any(chunk.same_as(known) for known in stream.recent):
            return stream
        if running:
            return _grow(stream, chunk, limits, now_s)
    if stream is not None and chunk.stream <= stream.number:
        if chunk.sequence > 0:
            raise LeftoverChunk(f'stream {chunk.stream} is over')
        raise StreamBroken(
            f'stream {chunk.stream} begins after stream {stream.number}; '
            f'allowed: a number > {stream.number}'
        )
    if stream is not None and running:
        raise StreamBroken(f'stream {chunk.stream} begins before stream {stream.number} is over')
    return _begin(chunk, limits, held_um, now_s)


def _begin(chunk: Chunk, limits: StageLimits, held_um: Vector, now_s: float) -> SetpointStream:
    if chunk.sequence != 0:
        raise StreamBroken(
            f'stream {chunk.stream} begins with setpoint {chunk.sequence}; allowed: 0'
        )
    lead_s = chunk.time_s - now_s
    if not 0.0 <= lead_s <= MAX_LEAD_S:
        raise StreamBroken(
            f'stream {chunk.stream} begins {lead_s:.4f} s after its arrival; '
            f'allowed: 0 to {MAX_LEAD_S:g} s'
        )
    limits.check_positions(chunk.positions_um)
    jump_um = np.abs(chunk.positions_um[0] - held_um)
    if (jump_um > START_TOLERANCE_UM).any():
        axis = int(jump_um.argmax())
        raise TravelExceeded(
            f'{AXES[axis]}: stream {chunk.stream} begins at {chunk.positions_um[0, axis]:.6g} µm, '
            f'the stage holds {held_um[axis]:.6g} µm; allowed: within {START_TOLERANCE_UM:g} µm'
        )
    times_s = chunk.times_s()
    velocities_um_s = chunk.velocities_um_s
    if velocities_um_s is None:
        velocities_um_s = _slopes(chunk.positions_um, times_s)
    _check_velocities(chunk.positions_um, times_s, velocities_um_s, limits)
    return SetpointStream(
        number=chunk.stream,
        begin_s=chunk.time_s,
        times_s=tuple(times_s.tolist()),
        positions_um=chunk.positions_um,
        velocities_um_s=velocities_um_s,
        received=len(chunk.positions_um),
        ended=chunk.last,
        guarded=chunk.guarded,
        recent=(chunk,),
    )


def _grow(
    stream: SetpointStream, chunk: Chunk, limits: StageLimits, now_s: float
) -> SetpointStream:
    if stream.ended:
        raise StreamBroken(f'stream {stream.number} goes on after its last chunk')
    if chunk.sequence != stream.received:
        raise StreamBroken(
            f'stream {stream.number} goes on with setpoint {chunk.sequence}; '
            f'allowed: {stream.received}'
        )
    if chunk.guarded != stream.guarded:
        raise StreamBroken(
            f'stream {stream.number}: guarded is {chunk.guarded} from setpoint {chunk.sequence} '
            f'on; allowed: {stream.guarded} as before'
        )
    late_s = chunk.time_s - (stream.times_s[-1] + chunk.period_s)
    if abs(late_s) > 0.5 * chunk.period_s:
        raise StreamBroken(
            f'stream {stream.number}: setpoint {chunk.sequence} is {late_s:.6f} s off its time; '
            f'allowed: half a period, {0.5 * chunk.period_s:.6f} s'
        )
    limits.check_positions(chunk.positions_um)
    # The join counts for slopes and velocities like any other pair of setpoints.
    times_s = np.concatenate(([stream.times_s[-1]], chunk.times_s()))
    positions_um = np.concatenate((stream.positions_um[-1:], chunk.positions_um))
    velocities_um_s = chunk.velocities_um_s
    if velocities_um_s is None:
        velocities_um_s = _slopes(positions_um, times_s)[1:]
    _check_velocities(positions_um, times_s, velocities_um_s, limits)
    kept = max(bisect_right(stream.times_s, now_s) - 1, 0)
    return replace(
        stream,
        times_s=(*stream.times_s[kept:], *times_s[1:].tolist()),
        positions_um=np.concatenate((stream.positions_um[kept:], chunk.positions_um)),
        velocities_um_s=np.concatenate((stream.velocities_um_s[kept:], velocities_um_s)),
        received=stream.received + len(chunk.positions_um),
        ended=chunk.last,
        recent=(*stream.recent[1 - REMEMBERED_CHUNKS :], chunk),
    )


def _slopes(
    positions_um: NDArray[np.float64], times_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return difference quotients (n, 3): central inside, one-sided at the ends, 0 for one point.

    The last one stays one-sided when the next chunk comes: the stage may be on its way there.
    """
    if len(positions_um) == 1:
        return np.zeros((1, 3))
    return np.asarray(np.gradient(positions_um, times_s, axis=0))


def _check_velocities(
    positions_um: NDArray[np.float64],
    times_s: NDArray[np.float64],
    velocities_um_s: NDArray[np.float64],
    limits: StageLimits,
) -> None:
    """Raise if a setpoint, or the way between two, is faster than the stage."""
    between_um_s = np.diff(positions_um, axis=0) / np.diff(times_s)[:, np.newaxis]
    fastest_um_s = np.abs(np.concatenate((velocities_um_s, between_um_s))).max(axis=0)
    axis = int(fastest_um_s.argmax())
    # A stream at the limit must not fail by rounding.
    if fastest_um_s[axis] > limits.max_velocity_um_s * (1.0 + 1e-6):
        raise TravelExceeded(
            f'{AXES[axis]}: a setpoint demands {fastest_um_s[axis]:.6g} µm/s; '
            f'allowed: {limits.max_velocity_um_s:g} µm/s'
        )
