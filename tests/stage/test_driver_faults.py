# SPDX-License-Identifier: Apache-2.0
"""Faults as the users of a driver meet them: switched on at run time, seen on `state`."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest
from geometry_msgs.msg import Point
from lifecycle_msgs.msg import Transition
from microhand_msgs_py.msg import ErrorCode, SetpointChunk, StageState
from numpy.typing import NDArray
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from stage_driver_sim.driver_parameters import TEXTS
from stage_driver_sim.faults import Fault, FaultSettings
from stage_driver_sim.presets import PRESETS
from tests.stage.gcs_bench import make_server, running_server

if TYPE_CHECKING:
    from tests.stage.conftest import DriverClient, StartDriver

PERIOD_S = 0.002
SPEED_M_S = 10e-6
DEADLINE_S = 15.0

MakeChunk = Callable[..., SetpointChunk]
MakeClient = Callable[[str], 'DriverClient']


def xyz(point: Point) -> NDArray[np.float64]:
    """Return the coordinates of a message [m]."""
    return np.array([point.x, point.y, point.z])


def set_parameters(client: DriverClient, **values: str | float) -> SetParametersResult:
    """Set parameters of a driver; return the answer for the last one."""
    finger = client.setpoints.topic_name.rpartition('/')[0]
    service = client.node.create_client(SetParameters, f'{finger}/stage_driver/set_parameters')
    client.wait(service.service_is_ready, 'set_parameters')
    parameters = [
        Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
    ]
    future = service.call_async(SetParameters.Request(parameters=parameters))
    client.wait(future.done, 'an answer')
    client.node.destroy_client(service)
    return future.result().results[-1]


@pytest.fixture
def healthy(active: DriverClient) -> Iterator[DriverClient]:
    """Return a client whose driver is active; whatever goes wrong ends with the test."""
    yield active
    assert set_parameters(active, fault='none').successful


def ramp(healthy: DriverClient, make_chunk: MakeChunk, count: int = 500) -> NDArray[np.float64]:
    """Send a ramp along x, by default of 10 µm in a second; return its positions [m]."""
    way_m = SPEED_M_S * PERIOD_S * np.arange(count)
    wanted_m = xyz(healthy.state.command) + np.outer(way_m, [1.0, 0.0, 0.0])
    begin_ns = healthy.now_ns() + 100_000_000
    stream = healthy.state.stream + 1
    healthy.setpoints.publish(
        make_chunk(begin_ns, wanted_m, period_s=PERIOD_S, stream=stream, last=True)
    )
    return wanted_m


def test_stuck(healthy: DriverClient, make_chunk: MakeChunk) -> None:
    """Stuck: `position` stays, `command` goes on, not on target, and no error."""
    begin_m = xyz(healthy.state.command)
    assert set_parameters(healthy, fault='stuck').successful
    ramp(healthy, make_chunk)
    far = healthy.wait_state(lambda state: state.command.x > begin_m[0] + 2e-6, 'a command away')
    np.testing.assert_allclose(xyz(far.position), begin_m, atol=20e-9)
    assert (far.mode, far.error_code, far.on_target) == (StageState.STREAMING, 0, False)
    assert set_parameters(healthy, fault='none').successful
    healthy.wait_rest()


def test_silent(healthy: DriverClient) -> None:
    """Silent: FAULT, STAGE_FAULT, a stamp that stands still; reset is refused until it answers."""
    assert set_parameters(healthy, fault='silent').successful
    healthy.wait(lambda: healthy.state.mode == StageState.FAULT, 'a fault')
    lost = healthy.state
    assert (lost.error_code, lost.on_target) == (ErrorCode.STAGE_FAULT, False)
    assert lost.error_msg == 'finger_2: the stage does not answer'
    seen = len(healthy.states)
    healthy.wait(lambda: len(healthy.states) > seen + 10, 'further states')
    assert healthy.state.header.stamp == lost.header.stamp
    assert healthy.call('reset').error_code == ErrorCode.STAGE_FAULT
    assert set_parameters(healthy, fault='none').successful
    assert healthy.call('reset').error_code == ErrorCode.SUCCESS
    healthy.wait_rest()


def test_late(healthy: DriverClient, make_chunk: MakeChunk) -> None:
    """Late: `position` is behind `command` by speed times delay, and arrives later."""
    assert set_parameters(healthy, fault_delay=0.3, fault='late').successful
    wanted_m = ramp(healthy, make_chunk)
    middle = healthy.wait_state(lambda state: state.command.x > wanted_m[300, 0], 'the middle')
    behind_m = middle.command.x - middle.position.x
    assert behind_m == pytest.approx(SPEED_M_S * 0.3, rel=0.1)
    end = healthy.wait_rest()
    np.testing.assert_allclose(xyz(end.position), wanted_m[-1], atol=20e-9)


def test_drifting(healthy: DriverClient) -> None:
    """Drifting: `position` leaves a `command` that stands still, at the stated rate."""
    begin_m = xyz(healthy.state.command)
    assert set_parameters(healthy, fault_drift=5e-6, fault='drifting').successful
    gone = healthy.wait_state(lambda state: state.position.z > begin_m[2] + 1e-6, 'a drift')
    np.testing.assert_array_equal(xyz(gone.command), begin_m)
    assert (gone.mode, gone.error_code, gone.on_target) == (StageState.HOLDING, 0, False)
    earlier = next(state for state in healthy.states if state.position.z > begin_m[2] + 0.5e-6)
    passed_s = (gone.header.stamp.sec - earlier.header.stamp.sec) + 1e-9 * (
        gone.header.stamp.nanosec - earlier.header.stamp.nanosec
    )
    rise_m = gone.position.z - earlier.position.z
    assert rise_m / passed_s == pytest.approx(5e-6, rel=0.1)
    assert set_parameters(healthy, fault='none').successful
    healthy.wait_rest()


def test_limit(healthy: DriverClient, make_chunk: MakeChunk) -> None:
    """Limit: FAULT, STAGE_FAULT, a text with axis, limit and command; `position` stays at it."""
    begin_m = xyz(healthy.state.command)
    assert set_parameters(healthy, fault_margin=1e-6, fault='limit').successful
    ramp(healthy, make_chunk)
    hit = healthy.wait_mode(StageState.FAULT)
    assert hit.error_code == ErrorCode.STAGE_FAULT
    assert re.match(r'finger_2: x: ran into its limit at (50\.99|51\.0)', hit.error_msg)
    later = healthy.wait_state(lambda _: True, 'a later state')
    assert later.position.x == pytest.approx(begin_m[0] + 1e-6, abs=30e-9)
    assert not later.on_target
    assert set_parameters(healthy, fault='none').successful
    assert healthy.call('reset').error_code == ErrorCode.SUCCESS
    healthy.wait_rest()


def test_what_cannot_go_wrong_is_refused(shared: DriverClient) -> None:
    """An unknown fault, or one of no size: named, with what is allowed; nothing changes."""
    refused = set_parameters(shared, fault='broken')
    assert not refused.successful
    allowed = 'none, stuck, silent, late, drifting, limit'
    assert refused.reason == f"fault is 'broken'; allowed: {allowed}"
    assert not set_parameters(shared, fault_delay=-1.0).successful
    refused = set_parameters(shared, preset='slow_200_um_xyz')
    assert not refused.successful  # a stage does not become another one


@pytest.mark.parametrize(
    ('name', 'value', 'objection'),
    [
        ('driver', 'magic', "driver is 'magic'; allowed: simulated, gcs"),
        ('preset', 'best', f"preset is 'best'; allowed: {', '.join(PRESETS)}"),
        ('gcs_address', 'nowhere:0', "gcs_address is 'nowhere:0'; allowed: host:port, port 1 to"),
        ('gcs_axes', '1 2', "gcs_axes is '1 2'; allowed: three different names"),
        ('gcs_axes', '1 2 2', "gcs_axes is '1 2 2'; allowed: three different names"),
        ('fault', 5, 'fault is 5; allowed: a text'),
    ],
)
def test_a_text_that_is_not_allowed_is_named(name: str, value: object, objection: str) -> None:
    """Each text parameter says what it is, and what is allowed; its default is allowed."""
    (spec,) = [spec for spec in TEXTS if spec.name == name]
    assert spec.objection(value).startswith(objection)
    assert spec.objection(spec.default) == ''


def test_a_wrong_choice_ends_the_start_in_one_line(
    start_driver: StartDriver, station: str
) -> None:
    """A text that is not allowed gives one line on stderr and exit status 2."""
    process = start_driver(station, '-p', 'driver:=magic')
    _, complaints = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 2
    assert "driver is 'magic'; allowed: simulated, gcs" in complaints
    assert len(complaints.splitlines()) == 1


def log_of(process: subprocess.Popen[str]) -> str:
    """End a driver and return what it logged."""
    process.send_signal(signal.SIGTERM)
    log, _ = process.communicate(timeout=DEADLINE_S)
    return log


def test_a_gcs_controller_that_goes_away_and_comes_back(
    start_driver: StartDriver, make_client: MakeClient
) -> None:
    """No controller: not configured. It goes away: STAGE_FAULT. It is back: reset, and on."""
    station = f'/station_{os.getpid()}_gcs'
    with running_server() as server:
        port = server.port
    process = start_driver(station, *('-p', 'driver:=gcs', '-p', f'gcs_address:=127.0.0.1:{port}'))
    client = make_client(station)
    client.wait_matched()
    assert not client.transition(Transition.TRANSITION_CONFIGURE)
    refused = set_parameters(client, fault='stuck')
    assert refused.reason == "fault is 'stuck'; allowed with driver gcs: none"

    server = make_server(port)
    try:
        client.activate()
        client.wait_rest()
        server.close()
        client.wait(lambda: client.state.mode == StageState.FAULT, 'a fault')
        assert client.state.error_code == ErrorCode.STAGE_FAULT
        assert f'finger_2: 127.0.0.1:{port}' in client.state.error_msg
        assert client.call('reset').error_code == ErrorCode.STAGE_FAULT

        server = make_server(port)
        client.wait(lambda: client.call('reset').error_code == ErrorCode.SUCCESS, 'a reset')
        client.wait_rest()
        server.set_fault(FaultSettings(Fault.SILENT))
        client.wait(lambda: client.state.mode == StageState.FAULT, 'a fault')
        assert client.state.error_code == ErrorCode.STAGE_FAULT
        assert client.transition(Transition.TRANSITION_DEACTIVATE)
        assert client.transition(Transition.TRANSITION_CLEANUP)
    finally:
        server.close()
    log = log_of(process)
    assert f'no controller at 127.0.0.1:{port}: Connection refused' in log
    assert 'the servo could not be switched off' in log
