# SPDX-License-Identifier: Apache-2.0
"""The piezo model, each of its effects against a formula that can be worked out by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal

from stage_driver_sim.axis_parameters import AxisParameters
from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.model import ModelState, StageModel, at_rest, creep_on, make_model, step
from stage_driver_sim.presets import PRESETS, REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.servo import SAMPLE_S

PRESET = REPRESENTATIVE_100_UM_XYZ[0]
QUIET = replace(PRESET, noise_rms_um=0.0, resolution_um=0.0)
BARE = replace(QUIET, hysteresis=0.0, creep_per_decade=0.0, max_velocity_um_s=1e12)
"""Mechanics and servo alone."""
STATIC = replace(BARE, resonance_damping=1.0, max_velocity_um_s=5000.0)
"""Mechanics that come to rest soon: to look at the piezo alone."""
RNG = np.random.default_rng(11)
MIDDLE_UM = np.full(3, 50.0)
SETTLED = 2000
"""Samples after which mechanics and servo are at rest: 0.1 s."""


def stage_of(axis: AxisParameters) -> tuple[StageModel, ModelState]:
    """Return a stage of three such axes, and its state in the middle of the travel."""
    model = make_model([axis] * 3)
    return model, at_rest(model, MIDDLE_UM)


def displaced_um(axis: AxisParameters, voltages_um: Sequence[float]) -> list[float]:
    """Return where an axis comes to rest, open loop, at each of the voltages in turn."""
    model, state = stage_of(axis)
    positions_um = []
    for voltage_um in voltages_um:
        state = step(model, state, np.full(3, voltage_um), SETTLED, RNG, servo_on=False)
        positions_um.append(float(state.position_um[0]))
    return positions_um


def response_um(
    axis: AxisParameters, command_um: float, samples: int, **how: Any
) -> NDArray[np.float64]:
    """Return the positions (samples,) after a step of the command from the middle."""
    model, state = stage_of(axis)
    positions_um = np.zeros(samples)
    for k in range(samples):
        state = step(model, state, np.full(3, command_um), 1, RNG, **how)
        positions_um[k] = state.position_um[0]
    return positions_um


@pytest.mark.parametrize('width', [0.0, 0.10, 0.12, 0.15])
def test_the_loop_over_the_travel_is_as_wide_as_stated_and_as_long_as_the_travel(
    width: float,
) -> None:
    """Open loop from end to end and back: branches `width` x 100 µm apart in the middle."""
    axis = replace(STATIC, hysteresis=width)
    _, upper_um, falling_um, lower_um, rising_um, again_um = displaced_um(
        axis, [0.0, 100.0, 50.0, 0.0, 50.0, 100.0]
    )
    assert falling_um - rising_um == pytest.approx(100.0 * width, abs=1e-6)
    assert (lower_um, upper_um) == pytest.approx((0.0, 100.0), abs=1e-6)
    assert again_um == pytest.approx(upper_um, abs=1e-9)


def test_small_loops_are_narrow() -> None:
    """A loop of a tenth of the travel is about a tenth as wide for its size: 1 to 2 %."""
    axis = replace(STATIC, hysteresis=0.12)
    _, top_um, falling_um, bottom_um, rising_um, _ = displaced_um(
        axis, [45.0, 55.0, 50.0, 45.0, 50.0, 55.0]
    )
    assert (falling_um - rising_um) / (top_um - bottom_um) == pytest.approx(0.012 / 0.78, rel=0.1)


@given(turns_um=st.lists(st.floats(20.0, 80.0), min_size=2, max_size=6))
@settings(deadline=None, max_examples=30)
def test_loops_close_where_they_began(turns_um: list[float]) -> None:
    """Madelung's rules: an excursion inside an excursion leaves no trace once it is passed."""
    axis = replace(STATIC, hysteresis=0.12)
    inside_um = [min(max(turn_um, 25.0), 75.0) for turn_um in turns_um]
    plain = displaced_um(axis, [20.0, 80.0, 20.0, 80.0])
    visited = displaced_um(axis, [20.0, 80.0, 20.0, *inside_um, 80.0])
    assert visited[-1] == pytest.approx(plain[-1], abs=1e-9)


def test_hysteresis_does_not_depend_on_speed() -> None:
    """The same voltages, five times slower, lead to the same positions."""
    axis = replace(STATIC, hysteresis=0.12)
    slow = replace(axis, max_velocity_um_s=1000.0)
    voltages_um = [80.0, 30.0, 60.0]
    np.testing.assert_allclose(
        displaced_um(axis, voltages_um), displaced_um(slow, voltages_um), atol=1e-9
    )


@pytest.mark.parametrize('per_decade', [0.01, 0.015, 0.02])
def test_creep_grows_by_the_stated_share_per_decade(per_decade: float) -> None:
    """Open loop after a step: L(10 t) - L(t) is `per_decade` of L(0.1 s), from 1 s to hours."""
    model, state = stage_of(replace(STATIC, creep_per_decade=per_decade))
    state = step(model, state, MIDDLE_UM + 20.0, SETTLED, RNG, servo_on=False)
    first_um = state.position_um[0] - 50.0
    assert first_um == pytest.approx(20.0, rel=2.0 * per_decade)
    elapsed_s, crept_um = SETTLED * SAMPLE_S, []
    for until_s in (1.0, 10.0, 100.0, 1e3, 1e4):
        state = creep_on(model, state, until_s - elapsed_s)
        elapsed_s = until_s
        crept_um.append(float(state.position_um[0]))
    decades = [(after - before) / first_um for before, after in pairwise(crept_um)]
    np.testing.assert_allclose(decades, per_decade, rtol=0.01)


def test_resting_is_stepping_without_change() -> None:
    """`creep_on` leads where as many samples at constant voltage lead."""
    model, state = stage_of(replace(STATIC, hysteresis=0.12, creep_per_decade=0.015))
    state = step(model, state, MIDDLE_UM + 20.0, SETTLED, RNG, servo_on=False)
    stepped = step(model, state, MIDDLE_UM + 20.0, 40_000, RNG, servo_on=False)
    rested = creep_on(model, state, 40_000 * SAMPLE_S)
    # Mechanics that follow creep are half a nanometre late: that is not computed while resting.
    np.testing.assert_allclose(rested.position_um, stepped.position_um, atol=0.001)
    np.testing.assert_allclose(rested.crept_um, stepped.crept_um, atol=1e-9)


@pytest.mark.parametrize('damping', [0.02, 0.7, 1.0, 1.5])
def test_the_mechanics_ring_as_their_transfer_function(damping: float) -> None:
    """Open loop, a step of the voltage: scipy's step response of w²/(s² + 2 z w s + w²)."""
    axis = replace(BARE, resonance_Hz=350.0, resonance_damping=damping)
    w = 2.0 * math.pi * 350.0
    system = signal.lti([w**2], [1.0, 2.0 * damping * w, w**2])
    times_s = SAMPLE_S * np.arange(401)
    _, expected_um = signal.step(system, T=times_s)
    ours_um = response_um(axis, 60.0, 400, servo_on=False)
    np.testing.assert_allclose(ours_um - 50.0, 10.0 * expected_um[1:], atol=1e-5)


def test_a_frequency_sweep_finds_the_resonance() -> None:
    """Open loop at each frequency: amplitude |w²/(w² - v² + 2i z w v)|, at its peak 1/(2 z)."""
    axis = replace(BARE, resonance_Hz=739.0, resonance_damping=0.02)
    frequencies_Hz = np.array([100.0, 500.0, 700.0, 725.0, 739.0, 753.0, 780.0, 1500.0])
    amplitudes = []
    for frequency_Hz in frequencies_Hz:
        model, state = stage_of(axis)
        period = 1.0 / (frequency_Hz * SAMPLE_S)
        tail = round(round(0.02 / SAMPLE_S / period) * period)
        times = np.arange(1600 + tail)
        swing = np.sin(2.0 * np.pi * times / period)
        positions_um = np.zeros(len(times))
        for k in times:
            state = step(model, state, MIDDLE_UM + swing[k], 1, RNG, servo_on=False)
            positions_um[k] = state.position_um[0] - 50.0
        phasor = np.exp(-2j * np.pi * times / period)
        amplitudes.append(2.0 * abs(np.mean((positions_um * phasor)[1600:])))
    ratio = frequencies_Hz / 739.0
    expected = 1.0 / np.abs(1.0 - ratio**2 + 2j * 0.02 * ratio)
    np.testing.assert_allclose(amplitudes, expected, rtol=0.03)
    assert frequencies_Hz[int(np.argmax(amplitudes))] == 739.0
    assert max(amplitudes) == pytest.approx(25.0, rel=0.03)


def test_a_small_step_of_the_servo_has_rise_time_and_overshoot_of_its_loop() -> None:
    """At 150 Hz and damping 0.7: overshoot e^(-pi z / sqrt(1 - z²)) = 4.6 %, rise 2.15 / w."""
    risen = response_um(QUIET, 50.1, 600) / 0.1 - 500.0
    times_s = SAMPLE_S * np.arange(1, 601)
    assert risen.max() - 1.0 == pytest.approx(0.046, abs=0.008)
    rise_s = times_s[np.argmax(risen > 0.9)] - times_s[np.argmax(risen > 0.1)]
    assert rise_s == pytest.approx(2.15 / (2.0 * np.pi * 150.0), rel=0.04)
    w = 2.0 * np.pi * 150.0
    _, expected = signal.step(signal.lti([w**2], [1.0, 1.4 * w, w**2]), T=times_s)
    np.testing.assert_allclose(risen, expected, atol=0.06)  # held and sampled: 75 µs late


def test_the_servo_lags_a_ramp_by_two_damping_over_omega() -> None:
    """Following a ramp the reading is 2 z / w late: 1.49 ms, without hysteresis exactly."""
    axis = replace(BARE, max_velocity_um_s=200.0)
    model, state = stage_of(axis)
    state = step(model, state, MIDDLE_UM + 40.0, 2000, RNG)
    lag_um = state.reference_um - state.reading_um
    np.testing.assert_allclose(lag_um, 200.0 * 1.4 / (2.0 * np.pi * 150.0), rtol=1e-3)


def test_the_servo_makes_hysteresis_and_creep_disappear() -> None:
    """Closed loop, up and down over 80 µm: within 2 nm of each command, by other voltages."""
    model, state = stage_of(QUIET)
    voltages_um = []
    for command_um in (90.0, 50.0, 10.0, 50.0):
        state = step(model, state, np.full(3, command_um), 5 * SETTLED, RNG)
        np.testing.assert_allclose(state.position_um, command_um, atol=0.002)
        voltages_um.append(float(state.voltage_um[0]))
    assert voltages_um[3] - voltages_um[1] > 5.0  # what the servo made up for


@pytest.mark.parametrize('name', PRESETS)
def test_every_preset_settles_on_its_command(name: str) -> None:
    """Each preset comes to rest on target, to a nanometre and its noise."""
    model = make_model(PRESETS[name])
    state = at_rest(model, model.middle_um)
    state = step(model, state, model.middle_um + 5.0, 40_000, np.random.default_rng(1))
    np.testing.assert_allclose(state.position_um, model.middle_um + 5.0, atol=0.005)


def test_sensor_noise_has_the_stated_spread_and_no_bias() -> None:
    """20 000 readings at rest, seed 7: deviation within 3 %; the stage itself stays quieter."""
    model, state = stage_of(replace(PRESET, noise_rms_um=0.002, resolution_um=0.0))
    rng = np.random.default_rng(7)
    readings_um, truths_um = [], []
    for _ in range(7000):
        state = step(model, state, MIDDLE_UM, 1, rng)
        readings_um.append(state.reading_um)
        truths_um.append(state.position_um)
    noise_um = np.array(readings_um)
    noise_um[1:] -= np.array(truths_um)[:-1]  # a sample reads first and acts then
    noise_um[0] -= MIDDLE_UM
    assert noise_um.std() == pytest.approx(0.002, rel=0.03)
    assert abs(noise_um.mean()) < 4.0 * 0.002 / math.sqrt(noise_um.size)
    assert np.std(truths_um) < 0.25 * 0.002


def test_sensor_reads_multiples_of_its_resolution() -> None:
    """Readings are the nearest multiple of the resolution: error at most half a step."""
    model, _ = stage_of(replace(QUIET, resolution_um=0.01))
    for truth_um in np.linspace(49.0, 51.0, 77):
        state = at_rest(model, np.full(3, truth_um))
        (reading_um, *_) = step(model, state, state.voltage_um, 1, RNG, servo_on=False).reading_um
        assert abs(reading_um - truth_um) <= 0.005 + 1e-12
        assert reading_um / 0.01 == pytest.approx(round(reading_um / 0.01), abs=1e-9)


@pytest.mark.parametrize(('command_um', 'end_um'), [(1e9, 100.0), (-1e9, 0.0)])
def test_command_saturates_at_the_travel(command_um: float, end_um: float) -> None:
    """A command beyond the travel leads to its end."""
    model, state = stage_of(QUIET)
    state = step(model, state, np.full(3, command_um), 10 * SETTLED, RNG)
    np.testing.assert_allclose(state.position_um, end_um, atol=0.005)
    np.testing.assert_array_equal(state.reference_um, end_um)


def test_the_amplifier_saturates_and_comes_back_at_once() -> None:
    """A fifth of the travel beyond its ends there is no more voltage, and nothing winds up."""
    model, state = stage_of(QUIET)
    state = step(model, state, np.full(3, 1e6), SETTLED, RNG, servo_on=False)
    np.testing.assert_array_equal(state.voltage_um, 120.0)
    blocked = state._replace(position_um=MIDDLE_UM, velocity_um_s=np.zeros(3))
    pushing = step(model, blocked, np.full(3, 50.0), 4, RNG)
    assert (pushing.voltage_um < 120.0).all()


def test_reference_never_exceeds_the_velocity_limit() -> None:
    """A full-travel step takes travel / limit, not less; a slower limit of a step wins."""
    model = make_model([QUIET] * 3)
    state = at_rest(model, np.zeros(3))
    for k in range(1, 30):
        state = step(model, state, np.full(3, 100.0), 20, RNG)
        np.testing.assert_allclose(state.reference_um, min(3.5 * k, 100.0), atol=1e-9)
    state = step(model, at_rest(model, np.zeros(3)), MIDDLE_UM, 200, RNG, slew_um_s=200.0)
    np.testing.assert_allclose(state.reference_um, 2.0, atol=1e-9)


@given(cuts=st.lists(st.integers(0, 200), min_size=1, max_size=6), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=30)
def test_many_short_steps_equal_one_long_step(cuts: list[int], seed: int) -> None:
    """How often the model is asked has no influence on where it goes, to the last bit."""
    model, begin = stage_of(PRESET)
    rng, state = np.random.default_rng(seed), begin
    for samples in cuts:
        state = step(model, state, MIDDLE_UM + 3.0, samples, rng)
    at_once = step(model, begin, MIDDLE_UM + 3.0, sum(cuts), np.random.default_rng(seed))
    for ours, expected in zip(state, at_once, strict=True):
        np.testing.assert_array_equal(ours, expected)


def test_a_step_leaves_its_arguments_alone() -> None:
    """The model is pure: the state before is what it was."""
    model, begin = stage_of(PRESET)
    copy = ModelState(*(array.copy() for array in begin))
    step(model, begin, MIDDLE_UM + 3.0, 100, RNG)
    for ours, expected in zip(begin, copy, strict=True):
        np.testing.assert_array_equal(ours, expected)


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('lower_um', 200.0),
        ('lower_um', -math.inf),
        ('upper_um', math.nan),
        ('max_velocity_um_s', 0.0),
        ('natural_frequency_Hz', -1.0),
        ('natural_frequency_Hz', 1001.0),
        ('damping_ratio', math.inf),
        ('noise_rms_um', -0.1),
        ('resolution_um', math.nan),
        ('resonance_Hz', 0.0),
        ('resonance_damping', math.nan),
        ('hysteresis', 0.31),
        ('creep_per_decade', -0.01),
    ],
)
def test_impossible_axes_are_refused(field: str, value: float) -> None:
    """Every field outside its range is refused, with its name, its value and what is allowed."""
    with pytest.raises(InvalidParameter, match='travel' if 'er_um' in field else field):
        replace(QUIET, **{field: value})


def test_impossible_stages_are_refused() -> None:
    """A servo too fast for its sampling, or another number of axes: refused by name."""
    wild = replace(QUIET, natural_frequency_Hz=1000.0, damping_ratio=0.3, hysteresis=0.3)
    with pytest.raises(InvalidParameter, match='z: natural_frequency_Hz is 1000 with'):
        make_model([QUIET, QUIET, wild])
    with pytest.raises(InvalidParameter, match='2 axes given; allowed: 3'):
        make_model([QUIET, QUIET])


def test_time_does_not_go_back() -> None:
    """A negative number of samples is refused."""
    model, state = stage_of(QUIET)
    with pytest.raises(InvalidParameter, match='samples is -1'):
        step(model, state, MIDDLE_UM, -1, RNG)
