# SPDX-License-Identifier: Apache-2.0
"""What only a simulation can promise: the same run again, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.model import axis_at_rest, step_axis
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.simulated_stage import HOMING_VELOCITY_UM_S, SimulatedStage

HOME_UM = np.full(3, 50.0)


def stage_with_seed(seed: int) -> SimulatedStage:
    """Return a stage, servo on, at home at time 0."""
    stage = SimulatedStage(
        REPRESENTATIVE_100_UM_XYZ, home_um=HOME_UM, rng=np.random.default_rng(seed), now_s=0.0
    )
    stage.set_servo(True, 0.0)
    return stage


def run(stage: SimulatedStage) -> NDArray[np.float64]:
    """Return the readings of a staircase, shape (200, 3)."""
    readings_um = []
    for k in range(200):
        stage.command_um(HOME_UM + 0.05 * k, 0.001 * k)
        readings_um.append(stage.measure_um(0.001 * k + 0.0005))
    return np.array(readings_um)


def test_equal_seeds_give_equal_runs() -> None:
    """The seed decides the noise, and nothing else is random."""
    np.testing.assert_array_equal(run(stage_with_seed(1)), run(stage_with_seed(1)))
    assert (run(stage_with_seed(1)) != run(stage_with_seed(2))).any()


def test_noise_of_the_axes_is_independent() -> None:
    """10 000 readings at rest, seed 3: spread of the preset on each axis, no correlation."""
    stage = stage_with_seed(3)
    readings_um = np.array([stage.measure_um(0.001 * k) for k in range(10_000)])
    expected_um = np.hypot(0.001, 0.001 / np.sqrt(12.0))  # noise and rounding to 1 nm
    np.testing.assert_allclose(readings_um.std(axis=0), expected_um, rtol=0.03)
    correlation = np.corrcoef(readings_um.T) - np.eye(3)
    assert np.abs(correlation).max() < 0.04  # four standard errors


def test_it_moves_as_its_model_does() -> None:
    """Between calls the stage is the axis model with the command of the last call."""
    stage, state = stage_with_seed(1), axis_at_rest(50.0)
    commands_um = (53.0, 51.0, 58.0)
    for k, command_um in enumerate(commands_um):
        stage.command_um(np.full(3, command_um), 0.003 * k)
        state = step_axis(REPRESENTATIVE_100_UM_XYZ[0], state, command_um, 0.003)
    assert stage.measure_um(0.009)[0] == pytest.approx(state.position_um, abs=0.006)


def test_homing_is_slow() -> None:
    """Homing 20 µm takes 20 µm / homing velocity, not the shortest time."""
    stage = stage_with_seed(1)
    stage.command_um(HOME_UM + 20.0, 0.0)
    stage.measure_um(1.0)
    stage.home(1.0)
    expected_s = 20.0 / HOMING_VELOCITY_UM_S
    assert stage.is_homing(1.0 + 0.99 * expected_s)
    assert not stage.is_homing(1.0 + 1.01 * expected_s)


def test_a_stop_never_turns_the_stage_around() -> None:
    """The stage runs on to where its reference was: by the lag of its loop, never backwards."""
    stage = stage_with_seed(1)
    stage.command_um(HOME_UM + 30.0, 0.0)
    at_stop_um = stage.measure_um(0.007)
    held_um = stage.stop(0.007)
    lag_um = 3500.0 * 2.0 * 0.7 / (2.0 * np.pi * 150.0)
    np.testing.assert_allclose(held_um - at_stop_um, lag_um, rtol=0.1)
    positions_um = [stage.measure_um(0.007 + 0.001 * k) for k in range(20)]
    assert (np.array(positions_um) > at_stop_um - 0.01).all()


def test_time_does_not_go_back() -> None:
    """A clock that runs backwards is an error, not a negative step."""
    stage = stage_with_seed(1)
    stage.measure_um(1.0)
    with pytest.raises(InvalidParameter, match='time went back'):
        stage.measure_um(0.9)
