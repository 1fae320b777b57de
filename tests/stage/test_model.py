# SPDX-License-Identifier: Apache-2.0
"""The axis model against scipy's integrators and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.model import (
    AxisParameters,
    AxisState,
    axis_at_rest,
    read_sensor,
    step_axis,
)
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ

FAST = AxisParameters(
    lower_um=-1e6,
    upper_um=1e6,
    max_velocity_um_s=1e12,
    natural_frequency_Hz=150.0,
    damping_ratio=0.7,
    noise_rms_um=0.0,
    resolution_um=0.0,
)
OMEGA = 2.0 * math.pi * 150.0


@pytest.mark.parametrize('damping_ratio', [0.05, 0.7, 0.999999, 1.0, 1.000001, 3.0])
def test_step_response_is_that_of_the_transfer_function(damping_ratio: float) -> None:
    """A step of the command gives scipy's step response of w²/(s² + 2zws + w²)."""
    axis = replace(FAST, damping_ratio=damping_ratio)
    times_s = np.linspace(0.0, 0.05, 301)
    system = signal.lti([OMEGA**2], [1.0, 2.0 * damping_ratio * OMEGA, OMEGA**2])
    _, expected_um = signal.step(system, T=times_s)
    ours_um = [step_axis(axis, axis_at_rest(0.0), 1.0, float(t)).position_um for t in times_s]
    np.testing.assert_allclose(ours_um, expected_um, atol=2e-6)


def test_slew_limited_response_is_that_of_the_limited_reference() -> None:
    """Behind the slew limit the loop answers as scipy's lsim does to ramp-then-hold."""
    axis = replace(FAST, max_velocity_um_s=1000.0)
    times_s = np.linspace(0.0, 0.05, 5001)
    reference_um = np.minimum(1000.0 * times_s, 12.3)
    system = signal.lti([OMEGA**2], [1.0, 1.4 * OMEGA, OMEGA**2])
    _, expected_um, _ = signal.lsim(system, reference_um, times_s)
    ours_um = [step_axis(axis, axis_at_rest(0.0), 12.3, float(t)).position_um for t in times_s]
    np.testing.assert_allclose(ours_um, expected_um, atol=1e-4)


@given(
    damping_ratio=st.floats(0.02, 5.0),
    position_um=st.floats(0.0, 100.0),
    velocity_um_s=st.floats(-1e4, 1e4),
    command_um=st.floats(0.0, 100.0),
    cuts=st.lists(st.floats(0.0, 0.03), min_size=1, max_size=6),
)
def test_many_small_steps_equal_one_large_step(
    damping_ratio: float,
    position_um: float,
    velocity_um_s: float,
    command_um: float,
    cuts: list[float],
) -> None:
    """How often the model is asked has no influence on where it goes."""
    axis = replace(FAST, damping_ratio=damping_ratio, max_velocity_um_s=2000.0)
    begin = AxisState(position_um, velocity_um_s, position_um)
    state = begin
    for dt_s in cuts:
        state = step_axis(axis, state, command_um, dt_s)
    at_once = step_axis(axis, begin, command_um, math.fsum(cuts))
    np.testing.assert_allclose(state, at_once, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize('dt_s', [1.0, 1e3, 1e9])
@pytest.mark.parametrize('damping_ratio', [0.01, 1.0, 10.0])
def test_any_time_step_is_stable(dt_s: float, damping_ratio: float) -> None:
    """After a step of seconds or of years the axis stands at the command."""
    axis = replace(FAST, damping_ratio=damping_ratio)
    state = step_axis(axis, axis_at_rest(0.0), 40.0, dt_s)
    assert state.position_um == pytest.approx(40.0, abs=0.01)
    assert state.reference_um == 40.0


def test_lag_behind_a_ramp_is_two_damping_over_omega() -> None:
    """Following a ramp of rate q, the position lags the reference by 2zq/w and keeps its rate."""
    axis = replace(FAST, max_velocity_um_s=500.0)
    state = step_axis(axis, axis_at_rest(0.0), 1e5, 0.2)
    assert state.reference_um == pytest.approx(100.0)
    assert state.reference_um - state.position_um == pytest.approx(2.0 * 0.7 * 500.0 / OMEGA)
    assert state.velocity_um_s == pytest.approx(500.0)


def test_reference_never_exceeds_the_velocity_limit() -> None:
    """A full-travel step takes travel / limit, not less, and the stage overshoots by < 5 %."""
    axis = replace(FAST, lower_um=0.0, upper_um=100.0, max_velocity_um_s=3500.0)
    state = axis_at_rest(0.0)
    fastest_um_s = 0.0
    for k in range(100):
        before = state
        state = step_axis(axis, state, 100.0, 0.001)
        assert state.reference_um - before.reference_um <= 3.5 + 1e-12
        fastest_um_s = max(fastest_um_s, state.velocity_um_s)
        assert (state.reference_um == 100.0) == ((k + 1) * 3.5 >= 100.0)
    assert fastest_um_s <= 3500.0 * 1.05


def test_a_slower_slew_limit_wins() -> None:
    """The limit of a step is the smaller of the axis' own and the one given."""
    axis = replace(FAST, max_velocity_um_s=1000.0)
    assert step_axis(axis, axis_at_rest(0.0), 50.0, 0.01, 200.0).reference_um == 2.0
    assert step_axis(axis, axis_at_rest(0.0), 50.0, 0.01, 9999.0).reference_um == 10.0


@pytest.mark.parametrize(('command_um', 'end_um'), [(1e9, 100.0), (-1e9, 0.0)])
def test_command_saturates_at_the_travel(command_um: float, end_um: float) -> None:
    """A command beyond the travel leads to its end."""
    axis = replace(FAST, lower_um=0.0, upper_um=100.0)
    assert step_axis(axis, axis_at_rest(50.0), command_um, 1.0).position_um == pytest.approx(
        end_um
    )


def test_sensor_noise_has_the_stated_spread_and_no_bias() -> None:
    """20 000 readings, seed 7: deviation within 3 %, mean within 4 standard errors."""
    axis = replace(FAST, noise_rms_um=0.002)
    draws = np.random.default_rng(7).standard_normal(20_000)
    readings_um = np.array([read_sensor(axis, axis_at_rest(50.0), float(x)) for x in draws])
    assert readings_um.std() == pytest.approx(0.002, rel=0.03)
    assert readings_um.mean() == pytest.approx(50.0, abs=4.0 * 0.002 / math.sqrt(20_000))


def test_sensor_reads_multiples_of_its_resolution() -> None:
    """Readings are the nearest multiple of the resolution: error at most half a step."""
    axis = replace(FAST, resolution_um=0.01)
    for truth_um in np.linspace(-1.0, 1.0, 777):
        reading_um = read_sensor(axis, axis_at_rest(float(truth_um)), 0.0)
        assert abs(reading_um - truth_um) <= 0.005 + 1e-12
        assert reading_um / 0.01 == pytest.approx(round(reading_um / 0.01), abs=1e-9)


def test_the_preset_settles_within_10_ms() -> None:
    """The representative stage is within 1 % of a 1 µm step after 10 ms, as its bandwidth says."""
    for axis in REPRESENTATIVE_100_UM_XYZ:
        state = step_axis(axis, axis_at_rest(50.0), 51.0, 0.010)
        assert state.position_um == pytest.approx(51.0, abs=0.01)


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('lower_um', 200.0),
        ('lower_um', -math.inf),
        ('upper_um', math.nan),
        ('max_velocity_um_s', 0.0),
        ('natural_frequency_Hz', -1.0),
        ('damping_ratio', math.inf),
        ('noise_rms_um', -0.1),
        ('resolution_um', math.nan),
    ],
)
def test_impossible_axes_are_refused(field: str, value: float) -> None:
    """Every field outside its range is refused."""
    good = replace(FAST, lower_um=0.0, upper_um=100.0)
    with pytest.raises(InvalidParameter, match='travel' if 'er_um' in field else field):
        replace(good, **{field: value})


@pytest.mark.parametrize('dt_s', [-1e-9, math.nan, math.inf])
def test_time_does_not_go_back(dt_s: float) -> None:
    """A time step that is negative or no number is refused."""
    with pytest.raises(InvalidParameter, match='time step'):
        step_axis(FAST, axis_at_rest(0.0), 1.0, dt_s)
