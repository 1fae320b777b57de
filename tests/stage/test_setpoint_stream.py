# SPDX-License-Identifier: Apache-2.0
"""Streams of setpoints: interpolation against polynomials and scipy, and everything refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from stage_driver_sim.chunk import Chunk
from stage_driver_sim.errors import (
    InvalidNumber,
    InvalidParameter,
    LeftoverChunk,
    StageError,
    StreamBroken,
    TravelExceeded,
)
from stage_driver_sim.protocol import StageLimits
from stage_driver_sim.setpoint_stream import Phase, SetpointStream, accept_chunk

LIMITS = StageLimits(
    lower_um=np.zeros(3),
    upper_um=np.array([100.0, 80.0, 60.0]),
    home_um=np.full(3, 50.0),
    max_velocity_um_s=3500.0,
)
PERIOD_S = 0.002
BEGIN_S = 10.1
NOW_S = 10.0
HELD_UM = np.full(3, 50.0)


def path_um(times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a smooth path that begins at `HELD_UM`, shape (n, 3)."""
    t = times_s - BEGIN_S
    return 50.0 + np.column_stack((9.0 * np.sin(7.0 * t), 5.0 * np.sin(3.0 * t), 40.0 * t**2))


def chunk_of(first: int, count: int, **changes: Any) -> Chunk:
    """Return setpoints `first` to `first + count` of the path, without velocities."""
    times_s = BEGIN_S + PERIOD_S * np.arange(first, first + count)
    chunk = Chunk(
        time_s=float(times_s[0]),
        period_s=PERIOD_S,
        positions_um=path_um(times_s),
        velocities_um_s=None,
        sequence=first,
        stream=5,
        last=False,
    )
    return replace(chunk, **changes)


def accept(
    stream: SetpointStream | None, chunk: Chunk, *, running: bool = True, now_s: float = NOW_S
) -> SetpointStream:
    """Accept `chunk` at `now_s`; without a stream nothing is running."""
    return accept_chunk(
        stream,
        chunk,
        running=running and stream is not None,
        limits=LIMITS,
        held_um=HELD_UM,
        now_s=now_s,
    )


def test_cubics_with_velocities_are_reproduced_exactly() -> None:
    """Where positions and velocities come from a cubic, the command is that cubic throughout."""
    rng = np.random.default_rng(3)
    coefficients = rng.uniform(-1.0, 1.0, (3, 3)) * [[40.0], [100.0], [300.0]]
    polynomials = [np.polynomial.Polynomial([50.0, *c]) for c in coefficients.T]
    stream = None
    for first in range(0, 100, 20):
        t = PERIOD_S * np.arange(first, first + 20)
        positions_um = np.column_stack([p(t) for p in polynomials])
        velocities_um_s = np.column_stack([p.deriv()(t) for p in polynomials])
        chunk = chunk_of(first, 20, positions_um=positions_um, velocities_um_s=velocities_um_s)
        stream = accept(stream, chunk)
    assert stream is not None
    for t in rng.uniform(0.0, 99 * PERIOD_S, 500):
        command = stream.command_at(BEGIN_S + float(t))
        assert command.phase is Phase.RUNNING
        np.testing.assert_allclose(command.position_um, [p(t) for p in polynomials], atol=1e-9)
        np.testing.assert_allclose(
            command.velocity_um_s, [p.deriv()(t) for p in polynomials], atol=1e-6
        )


def test_with_velocities_the_command_is_scipys_hermite_spline() -> None:
    """Random positions and velocities: the same curve as scipy's CubicHermiteSpline."""
    rng = np.random.default_rng(11)
    times_s = BEGIN_S + PERIOD_S * np.arange(60)
    positions_um = 50.0 + np.cumsum(rng.uniform(-1.0, 1.0, (60, 3)), axis=0)
    positions_um[0] = HELD_UM
    velocities_um_s = rng.uniform(-800.0, 800.0, (60, 3))
    stream = None
    for first, end in ((0, 1), (1, 3), (3, 40), (40, 60)):
        stream = accept(
            stream,
            chunk_of(
                first,
                end - first,
                positions_um=positions_um[first:end],
                velocities_um_s=velocities_um_s[first:end],
            ),
        )
    assert stream is not None
    spline = CubicHermiteSpline(times_s, positions_um, velocities_um_s)
    for t in rng.uniform(times_s[0], times_s[-1], 300):
        command = stream.command_at(float(t))
        np.testing.assert_allclose(command.position_um, spline(t), atol=1e-8)
        np.testing.assert_allclose(command.velocity_um_s, spline.derivative()(t), atol=1e-5)


def test_without_velocities_the_command_follows_the_path() -> None:
    """Difference quotients keep within 1 nm of a smooth path, whatever the size of the chunks."""
    stream = accept(None, chunk_of(0, 3))
    for first, count in ((3, 1), (4, 1), (5, 20), (25, 50), (75, 25)):
        stream = accept(stream, chunk_of(first, count))
    for t in np.linspace(BEGIN_S, BEGIN_S + 99 * PERIOD_S, 1234):
        np.testing.assert_allclose(
            stream.command_at(float(t)).position_um, path_um(np.array([t]))[0], atol=1e-3
        )


def test_a_straight_ramp_without_velocities_stays_straight() -> None:
    """Equal steps give a constant velocity from the first setpoint to the last."""
    ramp_um = 50.0 + np.outer(np.arange(30), [0.1, -0.2, 0.3])
    stream = accept(None, chunk_of(0, 10, positions_um=ramp_um[:10]))
    stream = accept(stream, chunk_of(10, 20, positions_um=ramp_um[10:]))
    for t in np.linspace(0.0, 29 * PERIOD_S, 97)[:-1]:
        command = stream.command_at(BEGIN_S + float(t))
        np.testing.assert_allclose(command.velocity_um_s, [50.0, -100.0, 150.0], rtol=1e-6)


def test_position_and_velocity_are_continuous_where_chunks_join() -> None:
    """Just before and just after each setpoint the command is the same."""
    stream = accept(accept(None, chunk_of(0, 10)), chunk_of(10, 10))
    for k in range(1, 19):
        t = BEGIN_S + k * PERIOD_S
        before, after = stream.command_at(t - 1e-9), stream.command_at(t + 1e-9)
        np.testing.assert_allclose(before.position_um, after.position_um, atol=1e-5)
        np.testing.assert_allclose(before.velocity_um_s, after.velocity_um_s, atol=1e-2)


def test_growing_does_not_move_what_is_being_executed() -> None:
    """A new chunk leaves the command up to the last known setpoint as it was."""
    short = accept(None, chunk_of(0, 10))
    long = accept(short, chunk_of(10, 10))
    for t in np.linspace(BEGIN_S - 0.01, BEGIN_S + 9 * PERIOD_S, 100):
        np.testing.assert_array_equal(
            short.command_at(float(t)).position_um, long.command_at(float(t)).position_um
        )


def test_setpoints_of_the_past_are_forgotten() -> None:
    """A stream keeps the segment it is in and what follows: it does not grow without end."""
    still_um = np.full((20, 3), 50.0)
    stream = accept(None, chunk_of(0, 20, positions_um=still_um))
    for first in range(20, 4000, 20):
        now_s = BEGIN_S + (first - 10) * PERIOD_S
        stream = accept(stream, chunk_of(first, 20, positions_um=still_um), now_s=now_s)
        assert len(stream.times_s) <= 31
        assert stream.times_s[0] <= now_s
    assert stream.received == 4000


def test_phases_of_a_stream() -> None:
    """Waiting before, running within, dry after the last known setpoint, done after the end."""
    open_stream = accept(None, chunk_of(0, 10))
    end_s = BEGIN_S + 9 * PERIOD_S
    assert open_stream.command_at(BEGIN_S - 1e-6).phase is Phase.WAITING
    assert open_stream.command_at(BEGIN_S).phase is Phase.RUNNING
    assert open_stream.command_at(end_s + 1e-6).phase is Phase.DRY
    ended = accept(None, chunk_of(0, 10, last=True))
    assert ended.command_at(end_s + 1e-6).phase is Phase.DONE
    np.testing.assert_array_equal(
        ended.command_at(end_s + 1.0).position_um, chunk_of(0, 10).positions_um[-1]
    )
    np.testing.assert_array_equal(ended.command_at(end_s + 1.0).velocity_um_s, np.zeros(3))


def test_exact_duplicates_change_nothing() -> None:
    """A copy of an accepted chunk is recognised, also when the stream is over."""
    stream = accept(accept(None, chunk_of(0, 10)), chunk_of(10, 10))
    for copy in (chunk_of(0, 10), chunk_of(10, 10)):
        assert accept(stream, copy) is stream
        assert accept(stream, copy, running=False) is stream


@pytest.mark.parametrize(
    'changes',
    [
        {'velocities_um_s': np.ones((10, 3))},
        {'positions_um': np.full((10, 3), 50.0)},
        {'time_s': BEGIN_S + 10 * PERIOD_S + 1e-4},
        {'last': True},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_a_copy_that_differs_is_a_contradiction(changes: dict[str, Any]) -> None:
    """The same numbers with another content are refused, whatever differs."""
    stream = accept(accept(None, chunk_of(0, 10)), chunk_of(10, 10))
    refuse(StreamBroken, 'setpoint 10; allowed: 20', stream, chunk_of(10, 10, **changes))


def refuse(
    error: type[StageError],
    match: str,
    stream: SetpointStream | None,
    chunk: Chunk,
    **how: Any,
) -> None:
    """Assert that `chunk` is refused for the stated reason."""
    with pytest.raises(error, match=match):
        accept(stream, chunk, **how)


def beyond(axis: int, value_um: float) -> NDArray[np.float64]:
    """Return ten positions of which the seventh leaves the travel on one axis."""
    positions_um = np.array(chunk_of(10, 10).positions_um)
    positions_um[6, axis] = value_um
    return positions_um


@pytest.mark.parametrize(
    ('error', 'match', 'changes'),
    [
        (StreamBroken, 'setpoint 11; allowed: 10', {'sequence': 11}),
        (StreamBroken, 'setpoint 9; allowed: 10', {'sequence': 9}),
        (StreamBroken, 'setpoint 0; allowed: 10', {'sequence': 0}),
        (StreamBroken, 'off its time', {'time_s': BEGIN_S + 11.1 * PERIOD_S}),
        (StreamBroken, 'off its time', {'time_s': BEGIN_S + 8.9 * PERIOD_S}),
        (StreamBroken, 'before stream 5 is over', {'stream': 6, 'sequence': 0}),
        (StreamBroken, r'allowed: a number > 5', {'stream': 4, 'sequence': 0}),
        (LeftoverChunk, 'stream 4 is over', {'stream': 4}),
        (TravelExceeded, r'x: position 6 is 100\.1 µm; allowed: 0 to 100', 'beyond x'),
        (TravelExceeded, r'z: position 6 is -3 µm; allowed: 0 to 60', 'beyond z'),
        (TravelExceeded, r'y: a setpoint demands .* µm/s; allowed: 3500 µm/s', 'too fast'),
        (TravelExceeded, r'x: a setpoint demands 4000 µm/s', 'too fast by velocity'),
    ],
)
def test_chunks_that_do_not_continue_the_stream_are_refused(
    error: type[StageError], match: str, changes: Any
) -> None:
    """Gap, overlap, wrong time, wrong stream, travel, velocity: each by its name."""
    stream = accept(None, chunk_of(0, 10))
    if changes == 'beyond x':
        changes = {'positions_um': beyond(0, 100.1)}
    elif changes == 'beyond z':
        changes = {'positions_um': beyond(2, -3.0)}
    elif changes == 'too fast':
        changes = {'positions_um': beyond(1, 58.0)}
    elif changes == 'too fast by velocity':
        changes = {'velocities_um_s': np.full((10, 3), [4000.0, 0.0, 0.0])}
    refuse(error, match, stream, chunk_of(10, 10, **changes))


@pytest.mark.parametrize(
    ('error', 'match', 'changes'),
    [
        (StreamBroken, 'begins with setpoint 7; allowed: 0', {'sequence': 7}),
        (StreamBroken, r'begins -0\.5000 s after its arrival', {'time_s': NOW_S - 0.5}),
        (StreamBroken, r'allowed: 0 to 10 s', {'time_s': NOW_S + 10.001}),
        (TravelExceeded, r'z: stream 5 begins at 50\.2 µm, the stage holds 50 µm', 'jump'),
        (TravelExceeded, 'position 6', 'beyond'),
    ],
)
def test_streams_that_begin_wrong_are_refused(
    error: type[StageError], match: str, changes: Any
) -> None:
    """A start in the middle, in the past, in the far future, elsewhere, or beyond the travel."""
    if changes == 'jump':
        changes = {'positions_um': chunk_of(0, 10).positions_um + np.array([0.0, 0.0, 0.2])}
    elif changes == 'beyond':
        changes = {'positions_um': np.vstack((np.full((6, 3), 50.0), np.full((4, 3), 90.0)))}
    refuse(error, match, None, chunk_of(0, 10, **changes))


def test_a_join_faster_than_the_stage_is_refused() -> None:
    """The step from the last setpoint of one chunk to the first of the next counts as well."""
    stream = accept(None, chunk_of(0, 10))
    still_um = np.full((10, 3), [59.0, 50.0, 50.0])
    refuse(
        TravelExceeded, 'x: a setpoint demands', stream, chunk_of(10, 10, positions_um=still_um)
    )


def test_a_stream_that_ended_does_not_go_on() -> None:
    """After `last` there is nothing to add, only a new stream with a larger number."""
    ended = accept(None, chunk_of(0, 10, last=True))
    refuse(StreamBroken, 'after its last chunk', ended, chunk_of(10, 10))
    refuse(LeftoverChunk, 'is over', ended, chunk_of(10, 10), running=False)
    refuse(StreamBroken, 'a number > 5', ended, chunk_of(0, 9), running=False)
    begun = accept(ended, chunk_of(0, 10, stream=6), running=False)
    assert (begun.number, begun.received) == (6, 10)


@pytest.mark.parametrize(
    ('error', 'changes'),
    [
        (InvalidNumber, {'time_s': math.nan}),
        (InvalidNumber, {'period_s': math.inf}),
        (InvalidParameter, {'period_s': 0.0}),
        (InvalidParameter, {'period_s': -0.002}),
        (InvalidParameter, {'period_s': 1e-300}),
        (InvalidNumber, {'positions_um': np.full((10, 3), math.nan)}),
        (InvalidNumber, {'positions_um': np.full((10, 3), -math.inf)}),
        (InvalidNumber, {'velocities_um_s': np.full((10, 3), math.nan)}),
        (InvalidParameter, {'positions_um': np.zeros((0, 3))}),
        (InvalidParameter, {'positions_um': np.zeros((10, 2))}),
        (InvalidParameter, {'positions_um': np.zeros(3)}),
        (InvalidParameter, {'velocities_um_s': np.zeros((9, 3))}),
    ],
)
def test_malformed_chunks_cannot_be_made(error: type[StageError], changes: dict[str, Any]) -> None:
    """NaN, infinity, wrong shapes and impossible periods are refused before any stream."""
    with pytest.raises(error):
        chunk_of(0, 10, **changes)


def test_travel_tolerates_the_rounding_of_metres_only() -> None:
    """A picometre beyond the end is a rounding error, a nanometre is not."""
    LIMITS.check_positions(np.array([100.0 + 1e-7, 50.0, -1e-7]))
    with pytest.raises(TravelExceeded):
        LIMITS.check_positions(np.array([100.001, 50.0, 50.0]))
