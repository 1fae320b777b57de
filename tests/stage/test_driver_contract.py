# SPDX-License-Identifier: Apache-2.0
"""What every driver promises over DDS, whatever is behind it: simulated, or a GCS controller."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from geometry_msgs.msg import Point
from microhand_msgs_py.msg import ErrorCode, SetpointChunk, StageState
from numpy.typing import NDArray

from tests.stage.gcs_bench import running_server

if TYPE_CHECKING:
    from tests.stage.conftest import DriverClient, StartDriver

PERIOD_S = 0.002
LEAD_NS = 200_000_000
AMPLITUDE_M = 4e-6
OMEGA = 2.0 * math.pi

MakeChunk = Callable[..., SetpointChunk]


@pytest.fixture(scope='module', params=['simulated', 'gcs'])
def driven(
    request: pytest.FixtureRequest,
    start_driver: StartDriver,
    make_client: Callable[[str], DriverClient],
) -> Iterator[DriverClient]:
    """Return the client of each kind of driver; its stage has 100 µm of travel."""
    station = f'/station_{os.getpid()}_{request.param}'
    with running_server() as server:
        start_driver(
            station,
            *('-p', f'driver:={request.param}', '-p', f'gcs_address:=127.0.0.1:{server.port}'),
        )
        client = make_client(station)
        client.wait_matched()
        yield client
        client.bring_down()


@pytest.fixture
def active(driven: DriverClient) -> DriverClient:
    """Return a client whose driver has just been activated, its stage at home."""
    driven.bring_down()
    driven.states.clear()
    driven.events.clear()
    driven.activate()
    if abs(driven.state.position.x - 50e-6) > 20e-9:
        assert driven.call('home').error_code == ErrorCode.SUCCESS
        driven.wait_rest()
    return driven


def xyz(point: Point) -> NDArray[np.float64]:
    """Return the coordinates of a message [m]."""
    return np.array([point.x, point.y, point.z])


def wave_m(begin_m: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return a motion along (1, -1, 0.5) that begins at `begin_m` with its full speed, (n, 3)."""
    way_m = AMPLITUDE_M * np.sin(OMEGA * PERIOD_S * np.arange(count))
    return begin_m + np.outer(way_m, [1.0, -1.0, 0.5])


def send(
    active: DriverClient, make_chunk: MakeChunk, positions_m: NDArray[np.float64], **fields: Any
) -> None:
    """Send setpoints as the next stream, due in a moment."""
    active.setpoints.publish(
        make_chunk(
            active.now_ns() + LEAD_NS,
            positions_m,
            period_s=PERIOD_S,
            **{'stream': active.state.stream + 1, **fields},
        )
    )


def test_it_says_what_its_stage_can_do(active: DriverClient) -> None:
    """Travel, home, velocity, acceleration in SI units, and who the stage is."""
    limits = active.call('get_limits')
    assert limits.error_code == ErrorCode.SUCCESS
    np.testing.assert_allclose(xyz(limits.lower), 0.0)
    np.testing.assert_allclose(xyz(limits.upper), 100e-6)
    np.testing.assert_allclose(xyz(limits.home), 50e-6)
    assert limits.max_velocity == pytest.approx(3.5e-3)
    assert limits.max_acceleration == pytest.approx(3.5e-3 * 2.0 * math.pi * 150.0)
    assert limits.hardware_id


def test_it_follows_a_stream_to_its_end(active: DriverClient, make_chunk: MakeChunk) -> None:
    """All setpoints accepted in order, a duplicate ignored, the last one reached on target."""
    begin_m = xyz(active.state.command)
    wanted_m = wave_m(begin_m, 300)
    begin_ns = active.now_ns() + LEAD_NS
    for first in (0, 100, 100, 200):
        active.setpoints.publish(
            make_chunk(
                begin_ns + round(first * PERIOD_S * 1e9),
                wanted_m[first : first + 100],
                period_s=PERIOD_S,
                sequence=first,
                stream=1,
                last=first == 200,
            )
        )
    active.wait(lambda: active.state.received == 300, 'all setpoints')
    end = active.wait_rest()
    assert (end.stream, end.underruns, end.error_code) == (1, 0, 0)
    np.testing.assert_allclose(xyz(end.command), wanted_m[-1], atol=1e-12)
    np.testing.assert_allclose(xyz(end.position), wanted_m[-1], atol=20e-9)
    # On its way it was where it should be, but for its lag: some milliseconds at 25 µm/s.
    moving = [state for state in active.states if state.mode == StageState.STREAMING]
    away_m = [np.abs(xyz(state.position) - xyz(state.command)).max() for state in moving]
    assert np.median(away_m) < AMPLITUDE_M * OMEGA * 0.02


@pytest.mark.parametrize(
    ('spoil_m', 'code', 'text'),
    [
        (math.nan, ErrorCode.INVALID_NUMBER, 'finger_2: y: positions 3 is nan'),
        (101e-6, ErrorCode.TRAVEL_EXCEEDED, 'y: position 3 is 101 µm; allowed: 0 to 100 µm'),
    ],
    ids=['nan', 'travel'],
)
def test_it_refuses_what_it_cannot_do(
    active: DriverClient, make_chunk: MakeChunk, spoil_m: float, code: int, text: str
) -> None:
    """One bad setpoint: FAULT with code and reason, nothing moves; after reset all is well."""
    begin_m = xyz(active.state.command)
    wanted_m = wave_m(begin_m, 50)
    wanted_m[3, 1] = spoil_m
    send(active, make_chunk, wanted_m)
    state = active.wait_mode(StageState.FAULT)
    assert state.error_code == code
    assert text in state.error_msg
    later = active.wait_state(lambda _: True, 'a later state')
    np.testing.assert_array_equal(xyz(later.command), begin_m)
    np.testing.assert_allclose(xyz(later.position), begin_m, atol=20e-9)
    assert active.call('reset').error_code == ErrorCode.SUCCESS
    assert active.wait_rest().error_msg == ''


def test_it_holds_when_a_stream_runs_dry(active: DriverClient, make_chunk: MakeChunk) -> None:
    """No chunk after the first: one underrun, STREAM_BROKEN, held behind the last setpoint."""
    wanted_m = wave_m(xyz(active.state.command), 50)
    send(active, make_chunk, wanted_m)
    state = active.wait_mode(StageState.FAULT)
    assert (state.underruns, state.error_code) == (1, ErrorCode.STREAM_BROKEN)
    held = active.wait_state(lambda later: later.on_target, 'rest')
    np.testing.assert_allclose(xyz(held.command), wanted_m[-1], atol=10e-9)
    np.testing.assert_allclose(xyz(held.position), wanted_m[-1], atol=30e-9)


def test_it_stops_in_motion_homes_and_switches_its_servo(
    active: DriverClient, make_chunk: MakeChunk
) -> None:
    """Stop holds and refuses until reset; home leads home; without servo nothing follows."""
    begin_m = xyz(active.state.command)
    send(active, make_chunk, wave_m(begin_m, 2000))
    active.wait(lambda: xyz(active.state.command)[0] > begin_m[0] + 1e-6, 'motion')
    refused = active.call('set_servo', enabled=False)
    assert refused.error_code == ErrorCode.NOT_ALLOWED
    assert active.call('stop').error_code == ErrorCode.SUCCESS
    active.wait_mode(StageState.STOPPED)
    stopped = active.wait_state(lambda state: state.on_target, 'rest')
    assert active.call('home').error_code == ErrorCode.NOT_ALLOWED
    assert active.call('reset').error_code == ErrorCode.SUCCESS
    np.testing.assert_allclose(xyz(active.wait_rest().position), xyz(stopped.position), atol=30e-9)

    assert active.call('home').error_code == ErrorCode.SUCCESS
    home = active.wait_rest()
    np.testing.assert_allclose(xyz(home.position), 50e-6, atol=20e-9)

    assert active.call('set_servo', enabled=False).error_code == ErrorCode.SUCCESS
    active.wait_mode(StageState.OFF)
    assert active.call('home').error_code == ErrorCode.NOT_ALLOWED
    assert active.call('set_servo', enabled=True).error_code == ErrorCode.SUCCESS
    active.wait_rest()
