# SPDX-License-Identifier: Apache-2.0
"""The driver as its users meet it: a process, talked to over DDS."""

from __future__ import annotations

import math
import signal
import subprocess
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point
from lifecycle_msgs.msg import Transition
from microhand_msgs_py.msg import ErrorCode, SetpointChunk, StageState
from numpy.typing import NDArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node

from microhand_node import qos
from stage_driver_sim import driver_node

if TYPE_CHECKING:
    from tests.stage.conftest import DriverClient

PERIOD_S = 0.002
PERIOD_NS = 2_000_000
CHUNK = 20
LEAD_NS = 200_000_000
AMPLITUDE_M = 5e-6
OMEGA = 2.0 * math.pi * 0.5
DEADLINE_S = 15.0

MakeChunk = Callable[..., SetpointChunk]
StartDriver = Callable[..., 'subprocess.Popen[str]']
MakeClient = Callable[[str], 'DriverClient']


def xyz(point: Point) -> NDArray[np.float64]:
    """Return the coordinates of a message [m]."""
    return np.array([point.x, point.y, point.z])


def stamp_ns(state: StageState) -> int:
    """Return when a state was measured [ns]."""
    return int(state.header.stamp.sec) * 1_000_000_000 + int(state.header.stamp.nanosec)


def sine_m(begin_m: NDArray[np.float64], since_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a motion along (1, -1, 0.5) that begins at `begin_m`, shape (n, 3)."""
    way_m = AMPLITUDE_M * np.sin(OMEGA * since_s)
    return begin_m + np.outer(way_m, [1.0, -1.0, 0.5])


def test_two_seconds_of_a_sine_are_followed(active: DriverClient, make_chunk: MakeChunk) -> None:
    """1000 setpoints in 50 chunks: all in order, on time, with the lag of the model, on target."""
    begin_m = xyz(active.state.command)
    begin_ns = active.now_ns() + LEAD_NS
    count = 1000
    wanted_m = sine_m(begin_m, PERIOD_S * np.arange(count))
    for first in range(0, count, CHUNK):
        due_ns = begin_ns + first * PERIOD_NS
        active.wait(lambda due_ns=due_ns: active.now_ns() >= due_ns - LEAD_NS, 'time to send')
        active.setpoints.publish(
            make_chunk(
                due_ns,
                wanted_m[first : first + CHUNK],
                period_s=PERIOD_S,
                sequence=first,
                stream=1,
                last=first + CHUNK == count,
            )
        )
    active.wait(lambda: active.state.received == count, 'all setpoints')
    end = active.wait_rest()
    assert (end.stream, end.underruns, end.error_code) == (1, 0, 0)
    np.testing.assert_allclose(xyz(end.command), wanted_m[-1], atol=1e-12)
    np.testing.assert_allclose(xyz(end.position), wanted_m[-1], atol=20e-9)

    received = [state.received for state in active.states]
    assert received == sorted(received)
    moving = [state for state in active.states if state.mode == StageState.STREAMING]
    since_s = np.array([(stamp_ns(state) - begin_ns) * 1e-9 for state in moving])
    within = (since_s > 0.05) & (since_s < (count - 1) * PERIOD_S)
    assert within.sum() > 200
    since_s = since_s[within]
    commands_m = np.array([xyz(state.command) for state in moving])[within]
    positions_m = np.array([xyz(state.position) for state in moving])[within]
    np.testing.assert_allclose(commands_m, sine_m(begin_m, since_s), atol=0.2e-9)

    # The lag of the loop is 2z/w = 1.49 ms, of the 1 kHz staircase 0.5 to 1 ms. A busy machine
    # delays ticks, never the lag of those on time: hence not the median.
    velocity_m_s = AMPLITUDE_M * OMEGA * np.cos(OMEGA * since_s)
    fast = np.abs(velocity_m_s) > 0.5 * AMPLITUDE_M * OMEGA
    lag_s = ((commands_m - positions_m)[:, 0] / velocity_m_s)[fast]
    assert 0.0015 < np.percentile(lag_s, 10.0) < 0.003
    # A tick that comes 100 ms late finds the stage on its path, only late.
    assert np.abs(commands_m - positions_m).max() < AMPLITUDE_M * OMEGA * 0.1


@pytest.mark.parametrize(
    ('code', 'text', 'spoil'),
    [
        (ErrorCode.INVALID_NUMBER, 'finger_2: y: positions 3 is nan', {'y': math.nan}),
        (
            ErrorCode.TRAVEL_EXCEEDED,
            'finger_2: y: position 3 is 120 µm; allowed: 0 to 100 µm',
            {'y': 120e-6},
        ),
        (ErrorCode.STREAM_BROKEN, 'finger_2: stream 1 begins with setpoint 20', {'sequence': 20}),
        (ErrorCode.STREAM_BROKEN, 'after its arrival; allowed: 0 to 10 s', {'late_ns': 10**9}),
        (ErrorCode.INVALID_PARAMETER, 'positions has 59 values', {'cut': 1}),
        (ErrorCode.INVALID_PARAMETER, 'finger_2: period is 0 s', {'period_s': 0.0}),
    ],
    ids=['nan', 'travel', 'gap', 'past', 'shape', 'period'],
)
def test_a_bad_chunk_is_a_fault_and_nothing_moves(
    active: DriverClient, make_chunk: MakeChunk, code: int, text: str, spoil: dict[str, Any]
) -> None:
    """Refused with code and reason on `state` and `events`, held in place, usable after reset."""
    begin_m = xyz(active.state.command)
    positions_m = sine_m(begin_m, PERIOD_S * np.arange(CHUNK))
    positions_m[3, 1] = spoil.get('y', positions_m[3, 1])
    message = make_chunk(
        active.now_ns() + LEAD_NS - spoil.get('late_ns', 0),
        positions_m,
        period_s=spoil.get('period_s', PERIOD_S),
        sequence=spoil.get('sequence', 0),
        stream=1,
    )
    if 'cut' in spoil:
        message.positions = message.positions[: -spoil['cut']]
    active.setpoints.publish(message)
    state = active.wait_mode(StageState.FAULT)
    assert state.error_code == code
    assert text in state.error_msg
    assert state.received == 0
    active.wait(lambda: code in [event.error_code for event in active.events], 'an event')
    event = next(event for event in active.events if event.error_code == code)
    assert event.text == state.error_msg
    assert event.source.endswith('/finger_2/stage_driver')

    refused_at = len(active.states)
    active.wait(lambda: len(active.states) > refused_at + 60, 'further states')
    for later in active.states[refused_at:]:
        np.testing.assert_array_equal(xyz(later.command), begin_m)
        np.testing.assert_allclose(xyz(later.position), begin_m, atol=20e-9)

    assert active.call('home').error_code == ErrorCode.NOT_ALLOWED
    assert active.call('reset').error_code == ErrorCode.SUCCESS
    assert active.wait_mode(StageState.HOLDING).error_msg == ''


def test_a_gap_in_mid_stream_brakes_and_holds(active: DriverClient, make_chunk: MakeChunk) -> None:
    """A lost chunk ends the motion where it is; the rest of the stream is not executed."""
    begin_m = xyz(active.state.command)
    begin_ns = active.now_ns() + LEAD_NS
    wanted_m = sine_m(begin_m, PERIOD_S * np.arange(2100))

    def send(first: int, count: int) -> None:
        active.setpoints.publish(
            make_chunk(
                begin_ns + first * PERIOD_NS,
                wanted_m[first : first + count],
                period_s=PERIOD_S,
                sequence=first,
                stream=1,
            )
        )

    send(0, 2000)
    active.wait(lambda: xyz(active.state.command)[0] > begin_m[0] + 1e-6, 'motion')
    send(2020, 20)
    state = active.wait_mode(StageState.FAULT)
    assert 'goes on with setpoint 2020; allowed: 2000' in state.error_msg
    # In a fifth of a second the sine would have moved on by a micron at least.
    active.wait_state(lambda later: stamp_ns(later) > stamp_ns(state) + 2 * 10**8, 'later')
    for later in active.states_measured_since(stamp_ns(state)):
        np.testing.assert_allclose(xyz(later.command), xyz(state.command), atol=5e-9)


def test_a_stream_that_runs_dry_is_held_and_counted(
    active: DriverClient, make_chunk: MakeChunk
) -> None:
    """No chunk after the first: braked within microns of its end, one underrun, STREAM_BROKEN."""
    begin_m = xyz(active.state.command)
    wanted_m = sine_m(begin_m, PERIOD_S * np.arange(50))
    active.setpoints.publish(
        make_chunk(active.now_ns() + LEAD_NS, wanted_m, period_s=PERIOD_S, sequence=0, stream=4)
    )
    state = active.wait_mode(StageState.FAULT)
    assert (state.underruns, state.error_code, state.stream) == (1, ErrorCode.STREAM_BROKEN, 4)
    np.testing.assert_allclose(xyz(state.command), wanted_m[-1], atol=10e-9)


def test_stop_home_servo_and_limits(active: DriverClient, make_chunk: MakeChunk) -> None:
    """The services do what they say, in an order that a station would use."""
    limits = active.call('get_limits')
    assert limits.error_code == ErrorCode.SUCCESS
    np.testing.assert_allclose(xyz(limits.lower), 0.0)
    np.testing.assert_allclose(xyz(limits.upper), 100e-6)
    np.testing.assert_allclose(xyz(limits.home), 50e-6)
    assert limits.max_velocity == pytest.approx(3.5e-3)
    assert limits.hardware_id == 'simulated-2'

    begin_m = xyz(active.state.command)
    wanted_m = sine_m(begin_m, PERIOD_S * np.arange(1000))
    active.setpoints.publish(
        make_chunk(active.now_ns() + LEAD_NS, wanted_m, period_s=PERIOD_S, sequence=0, stream=1)
    )
    active.wait(lambda: xyz(active.state.command)[0] > begin_m[0] + 1e-6, 'motion')
    refused = active.call('set_servo', enabled=False)
    assert refused.error_code == ErrorCode.NOT_ALLOWED
    assert active.call('stop').error_code == ErrorCode.SUCCESS
    active.wait_mode(StageState.STOPPED)
    active.wait_state(lambda state: state.on_target, 'rest')
    assert xyz(active.state.position)[0] > begin_m[0] + 0.9e-6
    refused = active.call('home')
    assert refused.error_code == ErrorCode.NOT_ALLOWED
    assert 'home in mode STOPPED' in refused.error_msg
    assert active.call('reset').error_code == ErrorCode.SUCCESS

    assert active.call('home').error_code == ErrorCode.SUCCESS
    active.wait_rest()
    np.testing.assert_allclose(xyz(active.state.position), 50e-6, atol=20e-9)

    assert active.call('set_servo', enabled=False).error_code == ErrorCode.SUCCESS
    active.wait_mode(StageState.OFF)
    assert active.call('set_servo', enabled=True).error_code == ErrorCode.SUCCESS
    active.wait_mode(StageState.HOLDING)


def test_lifecycle_of_the_driver(unconfigured: DriverClient) -> None:
    """Inactive it publishes nothing and answers STAGE_MISSING; it can be activated again."""
    begin_ns = unconfigured.now_ns()
    assert unconfigured.call('get_limits').error_code == ErrorCode.STAGE_MISSING
    assert unconfigured.call('stop').error_code == ErrorCode.STAGE_MISSING
    assert not unconfigured.states_measured_since(begin_ns)
    unconfigured.activate()
    assert unconfigured.state.header.frame_id == 'finger_2_base'
    assert abs(stamp_ns(unconfigured.state) - unconfigured.now_ns()) < 10**9
    assert unconfigured.transition(Transition.TRANSITION_DEACTIVATE)
    refused = unconfigured.call('home')
    assert refused.error_code == ErrorCode.STAGE_MISSING
    assert refused.error_msg.endswith('/finger_2/stage_driver is not active')
    silent_ns = unconfigured.now_ns()
    assert unconfigured.call('get_limits').error_code == ErrorCode.SUCCESS
    unconfigured.wait(lambda: unconfigured.now_ns() > silent_ns + 10**8, '20 periods of silence')
    assert not unconfigured.states_measured_since(silent_ns)
    assert unconfigured.transition(Transition.TRANSITION_ACTIVATE)
    unconfigured.wait_rest()
    assert unconfigured.transition(Transition.TRANSITION_DEACTIVATE)
    assert unconfigured.transition(Transition.TRANSITION_CLEANUP)
    assert unconfigured.call('get_limits').error_code == ErrorCode.STAGE_MISSING


def test_a_transition_that_does_not_exist_is_refused_and_survived(active: DriverClient) -> None:
    """Configuring an active driver, or an invented transition, fails; streaming stays possible."""
    assert not active.transition(Transition.TRANSITION_CONFIGURE)
    assert not active.transition(77)
    seen = len(active.states)
    active.wait(lambda: len(active.states) > seen + 10, 'further states')
    assert active.state.mode == StageState.HOLDING


def test_a_transition_that_breaks_leaves_a_driver_that_can_be_configured(
    monkeypatch: pytest.MonkeyPatch, node: tuple[Node, SingleThreadedExecutor]
) -> None:
    """A defect in `configure` ends in the log and in state unconfigured, not in a dead node."""
    monkeypatch.setattr(driver_node, '_power_up', lambda parameters: 1 / 0)
    driver = driver_node.StageDriverNode(context=node[0].context)
    log: list[str] = []
    monkeypatch.setattr(driver.get_logger(), 'fatal', log.append)
    try:
        assert driver.trigger_configure() is TransitionCallbackReturn.ERROR
        assert 'ZeroDivisionError' in log[0]
        monkeypatch.undo()
        assert driver.trigger_configure() is TransitionCallbackReturn.SUCCESS
        assert driver.trigger_activate() is TransitionCallbackReturn.SUCCESS
    finally:
        driver.destroy_node()
    assert 'control loop' not in [thread.name for thread in threading.enumerate()]
    assert 'reporter' not in [thread.name for thread in threading.enumerate()]


def test_diagnostics_name_the_hardware_and_the_fault(
    active: DriverClient, make_chunk: MakeChunk
) -> None:
    """`/diagnostics` carries hardware_id, mode and the rate of the loop; a fault is an ERROR."""
    seen: list[DiagnosticStatus] = []
    active.node.create_subscription(
        DiagnosticArray,
        '/diagnostics',
        lambda array: seen.extend(array.status),
        qos.DIAGNOSTICS,
    )
    active.wait(lambda: len(seen) > 1, 'diagnostics')
    assert seen[-1].level == DiagnosticStatus.OK
    assert seen[-1].hardware_id == 'simulated-2'
    assert seen[-1].name.endswith('/finger_2/stage_driver: stage')
    values = {pair.key: pair.value for pair in seen[-1].values}
    assert values['mode'] == 'HOLDING'
    assert 100.0 < float(values['control loop rate [Hz]']) < 1100.0
    assert values['control loop scheduling'] == 'ordinary'

    nowhere_m = np.full((5, 3), 1.0)
    active.setpoints.publish(
        make_chunk(active.now_ns() + LEAD_NS, nowhere_m, period_s=PERIOD_S, stream=1)
    )
    active.wait(lambda: seen[-1].level == DiagnosticStatus.ERROR, 'an ERROR')
    assert 'finger_2: x: position 0 is 1e+06 µm' in seen[-1].message


def test_parameters_take_integers_and_refuse_nonsense(
    start_driver: StartDriver, make_client: MakeClient, station: str
) -> None:
    """Integers count as numbers; what is out of range is refused, the range in the reason."""
    start_driver(
        station,
        *('-p', 'damping_ratio:=1', '-p', 'natural_frequency:=[200, 200, 100]'),
        *('-p', 'home:=[0, 0, 0]', '-p', 'travel_upper:=[80.0e-6, 80.0e-6, 80.0e-6]'),
    )
    client = make_client(station)
    client.wait_matched()
    set_parameters = client.node.create_client(
        SetParameters, f'{station}/finger_2/stage_driver/set_parameters'
    )
    client.wait(set_parameters.service_is_ready, 'set_parameters')

    def set_double(name: str, value: float) -> Any:
        value_message = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        future = set_parameters.call_async(
            SetParameters.Request(parameters=[Parameter(name=name, value=value_message)])
        )
        client.wait(future.done, 'an answer')
        return future.result().results[0]

    refused = set_double('damping_ratio', -3.0)
    assert not refused.successful
    assert 'damping_ratio' in refused.reason
    assert '0.3' in refused.reason
    assert not set_double('finger', 1.5).successful
    assert not set_double('home', 1e-6).successful
    assert set_double('max_velocity', 0.001).successful
    client.activate()
    limits = client.call('get_limits')
    np.testing.assert_allclose(xyz(limits.upper), 80e-6)
    np.testing.assert_allclose(xyz(limits.home), 0.0)
    assert limits.max_velocity == pytest.approx(0.001)


@pytest.mark.parametrize(
    ('argument', 'text'),
    [
        ('control_rate:=-5.0', 'control_rate'),
        ('control_rate:=5000', 'control_rate is 5000; allowed: a number from 50 to 2000 Hz'),
        ('seed:=abc', 'seed is abc; allowed: an integer'),
        ('home:=[1, 2]', 'allowed: three numbers from -0.1 to 0.1 m'),
    ],
)
def test_a_parameter_out_of_range_ends_the_start_in_one_line(
    start_driver: StartDriver, station: str, argument: str, text: str
) -> None:
    """A refused parameter gives one line on stderr and exit status 2."""
    process = start_driver(station, '-p', argument)
    _, complaints = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 2
    assert text in complaints
    assert len(complaints.splitlines()) == 1


def test_contradicting_parameters_are_refused_at_configure(
    start_driver: StartDriver, make_client: MakeClient, station: str
) -> None:
    """A home outside the travel fails `configure` with a reason in the log; the node stays up."""
    process = start_driver(station, '-p', 'travel_upper:=[40.0e-6, 100.0e-6, 100.0e-6]')
    client = make_client(station)
    client.wait_matched()
    assert not client.transition(Transition.TRANSITION_CONFIGURE)
    assert client.call('get_limits').error_code == ErrorCode.STAGE_MISSING
    process.send_signal(signal.SIGTERM)
    log, _ = process.communicate(timeout=DEADLINE_S)
    assert 'x: home is 50 µm; allowed: 0 to 40 µm' in log


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_motion_ends_the_process_cleanly(
    start_driver: StartDriver,
    make_client: MakeClient,
    make_chunk: MakeChunk,
    station: str,
    number: int,
) -> None:
    """In the middle of a stream: exit status 0, nothing on stderr, no thread keeps it alive."""
    process = start_driver(station)
    client = make_client(station)
    client.wait_matched()
    client.activate()
    wanted_m = sine_m(xyz(client.state.command), PERIOD_S * np.arange(2000))
    client.setpoints.publish(
        make_chunk(client.now_ns() + LEAD_NS, wanted_m, period_s=PERIOD_S, stream=1)
    )
    client.wait_mode(StageState.STREAMING)
    process.send_signal(number)
    _, complaints = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, complaints) == (0, '')
