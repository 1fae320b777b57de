# SPDX-License-Identifier: Apache-2.0
"""A piezo stage and its digital controller, sample by sample: command → voltage → position.

For each axis, once per sampling period of the controller::

    command -> slew limit -> servo -> amplifier -> hysteresis -> creep -> mechanics -> position
                               ^                                                         |
                               +---- reading <- quantisation <- noise <------------------+

With the servo off, the command is the voltage itself. A voltage is given in µm: as the position
that it would lead to without hysteresis and creep. `step` is pure: state and noise are arguments.
What it computes with is laid out in arrays, axis by axis, and compiled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from stage_driver_sim.axis_parameters import AxisParameters
from stage_driver_sim.creep import design_creep
from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.hysteresis import design_hysteresis
from stage_driver_sim.protocol import AXES, Vector
from stage_driver_sim.resonance import sample_oscillator
from stage_driver_sim.servo import SAMPLE_S, design_servo

Array = NDArray[np.float64]

OVERDRIVE = 0.2
"""The amplifier reaches beyond the voltages of the travel, by this share of it, at both ends: so
that the servo can make up for hysteresis and creep (-20 to 120 V for a nominal 0 to 100 V)."""


class StageModel(NamedTuple):
    """What a stage of three axes is like, per sample of its controller; see `make_model`."""

    middle_um: Vector
    lower_um: Vector
    upper_um: Vector
    slew_um: Vector
    """Largest change of reference or voltage per sample."""
    voltage_um: Array
    """(3, 2) lowest and highest voltage."""
    servo: Array
    """(3, 4) gain, pole, a1, a2."""
    elastic: Vector
    thresholds_um: Array
    """(3, n) of the play operators."""
    weights: Array
    """(3, n) of the play operators."""
    creep_shares: Array
    """(m,) how much of its way a relaxation makes in one sample."""
    creep_weights: Array
    """(3, m)."""
    mechanics: Array
    """(3, 4) xx, xv, vx, vv."""
    noise_um: Vector
    resolution_um: Vector


class ModelState(NamedTuple):
    """All that the future of a stage depends on; (3,) per axis unless stated."""

    position_um: Vector
    """True position."""
    velocity_um_s: Vector
    """True velocity."""
    reading_um: Vector
    """What the sensor read last."""
    reference_um: Vector
    """Slew-limited command that the servo follows."""
    voltage_um: Vector
    voltage_step_um: Vector
    """The latest change of the voltage."""
    errors_um: Array
    """(3, 2) the latest two control errors."""
    plays_um: Array
    """(3, n) where the play operators are."""
    crept_um: Array
    """(3, m) where the relaxations are."""


def make_model(axes: Sequence[AxisParameters]) -> StageModel:
    """Return the model of a stage with the given axes, x, y, z.

    Raises
    ------
    InvalidParameter
        Not three axes, or a servo that cannot be; the message names the axis.
    """
    if len(axes) != len(AXES):
        raise InvalidParameter(f'{len(axes)} axes given; allowed: {len(AXES)}')
    rows = []
    for name, axis in zip(AXES, axes, strict=True):
        plays = design_hysteresis(axis.hysteresis, axis.half_travel_um)
        mechanics = sample_oscillator(axis.resonance_Hz, axis.resonance_damping, SAMPLE_S)
        try:
            servo = design_servo(
                axis.natural_frequency_Hz,
                axis.damping_ratio,
                mechanics,
                (plays.elastic, plays.steepest),
            )
        except InvalidParameter as error:
            raise InvalidParameter(f'{name}: {error}') from error
        beyond_um = 2.0 * OVERDRIVE * axis.half_travel_um
        rows.append(
            (
                axis.middle_um,
                axis.lower_um,
                axis.upper_um,
                axis.max_velocity_um_s * SAMPLE_S,
                (axis.lower_um - beyond_um, axis.upper_um + beyond_um),
                (servo.gain, servo.pole, servo.a1, servo.a2),
                plays.elastic,
                plays.thresholds_um,
                plays.weights,
                design_creep(axis.creep_per_decade).weights,
                (mechanics.xx, mechanics.xv, mechanics.vx, mechanics.vv),
                axis.noise_rms_um,
                axis.resolution_um,
            )
        )
    columns = [np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)]
    shares = -np.expm1(-SAMPLE_S / design_creep(0.0).times_s)
    model = StageModel._make([*columns[:9], shares, *columns[9:]])
    for array in model:
        array.setflags(write=False)
    return model


def at_rest(model: StageModel, position_um: Vector) -> ModelState:
    """Return the state of a stage that has stood at a position for long, depolarised.

    Its play operators are in the middle of their play, as after a voltage that swung and died
    away, and nothing creeps any more.

    Parameters
    ----------
    model : StageModel
        The stage.
    position_um : (3,) ndarray
        Where it stands [µm].
    """
    position_um = np.array(position_um, dtype=np.float64)
    drawn_um = (position_um - model.middle_um) / (1.0 + model.creep_weights.sum(axis=1))
    voltage_um = model.middle_um + drawn_um / (model.elastic + model.weights.sum(axis=1))
    return ModelState(
        position_um=position_um,
        velocity_um_s=np.zeros(3),
        reading_um=position_um.copy(),
        reference_um=position_um.copy(),
        voltage_um=voltage_um,
        voltage_step_um=np.zeros(3),
        errors_um=np.zeros((3, 2)),
        plays_um=np.repeat(voltage_um[:, np.newaxis], model.weights.shape[1], axis=1),
        crept_um=np.repeat(
            (model.middle_um + drawn_um)[:, np.newaxis], len(model.creep_shares), axis=1
        ),
    )


def hold(state: ModelState, *, where_um: Vector) -> ModelState:
    """Return the state of a controller that closes or opens its loop: it begins anew.

    Parameters
    ----------
    state : ModelState
        Of the stage.
    where_um : (3,) ndarray
        The reference of the servo from now on [µm].
    """
    return state._replace(
        reference_um=np.array(where_um, dtype=np.float64),
        voltage_step_um=np.zeros(3),
        errors_um=np.zeros((3, 2)),
    )


def step(
    model: StageModel,
    state: ModelState,
    command_um: Vector,
    samples: int,
    rng: np.random.Generator,
    *,
    servo_on: bool = True,
    slew_um_s: float | Vector = math.inf,
) -> ModelState:
    """Return the state `samples` sampling periods later, the command being constant meanwhile.

    Many short steps make one long step, to the last bit.

    Parameters
    ----------
    model : StageModel
        The stage.
    state : ModelState
        State now.
    command_um : (3,) ndarray
        Position, servo on, or voltage, servo off [µm]; beyond travel or amplifier it saturates.
    samples : int
        How many periods of `SAMPLE_S`, >= 0.
    rng : numpy.random.Generator
        Source of the sensor noise: three numbers per sample.
    servo_on : bool
        Whether the loop is closed.
    slew_um_s : float or (3,) ndarray
        A slower slew limit for this step [µm/s].

    Raises
    ------
    InvalidParameter
        `samples` is negative.
    """
    if samples < 0:
        raise InvalidParameter(f'samples is {samples}; allowed: an integer >= 0')
    command_um = np.array(command_um, dtype=np.float64)
    noise = rng.standard_normal((samples, 3))
    slew_um = np.minimum(model.slew_um, np.multiply(slew_um_s, SAMPLE_S))
    return _advance(model, state, command_um, noise, servo_on, slew_um)


def creep_on(model: StageModel, state: ModelState, duration_s: float) -> ModelState:
    """Return the state after a long rest in which only creep goes on, the voltage being constant.

    Parameters
    ----------
    model : StageModel
        The stage.
    state : ModelState
        State now.
    duration_s : float
        How long [s].
    """
    drawn_um = model.middle_um + model.elastic * (state.voltage_um - model.middle_um)
    drawn_um += (model.weights * (state.plays_um - model.middle_um[:, np.newaxis])).sum(axis=1)
    left = np.power(1.0 - model.creep_shares, duration_s / SAMPLE_S)
    crept_um = drawn_um[:, np.newaxis] + left * (state.crept_um - drawn_um[:, np.newaxis])
    moved_um = (model.creep_weights * (crept_um - state.crept_um)).sum(axis=1)
    return state._replace(position_um=state.position_um + moved_um, crept_um=crept_um)


@nb.njit(cache=True, nogil=True)
def _advance(
    model: StageModel,
    state: ModelState,
    command_um: Vector,
    noise: Array,
    servo_on: bool,
    slew_um: Vector,
) -> ModelState:
    """Carry on sample by sample; `noise` (n, 3) in standard deviations."""
    position_um = state.position_um.copy()
    velocity_um_s = state.velocity_um_s.copy()
    reading_um = state.reading_um.copy()
    reference_um = state.reference_um.copy()
    voltage_um = state.voltage_um.copy()
    voltage_step_um = state.voltage_step_um.copy()
    errors_um = state.errors_um.copy()
    plays_um = state.plays_um.copy()
    crept_um = state.crept_um.copy()
    for axis in range(3):
        x, v, u = position_um[axis], velocity_um_s[axis], voltage_um[axis]
        du, e1, e2 = voltage_step_um[axis], errors_um[axis, 0], errors_um[axis, 1]
        reference, reading = reference_um[axis], reading_um[axis]
        middle, resolution = model.middle_um[axis], model.resolution_um[axis]
        gain, pole, a1, a2 = model.servo[axis]
        xx, xv, vx, vv = model.mechanics[axis]
        lowest, highest = model.voltage_um[axis]
        slew = slew_um[axis]
        target = command_um[axis]
        if servo_on:
            target = min(max(target, model.lower_um[axis]), model.upper_um[axis])
        for k in range(len(noise)):
            reading = x + model.noise_um[axis] * noise[k, axis]
            if resolution > 0.0:
                reading = resolution * np.round(reading / resolution)
            if servo_on:
                reference += min(max(target - reference, -slew), slew)
                e = reference - reading
                du = pole * du + gain * (e + a1 * e1 + a2 * e2)
                e2, e1 = e1, e
            else:
                du = min(max(target - u, -slew), slew)
            # An amplifier at its end remembers what it did, not what was wanted of it.
            before = u
            u = min(max(u + du, lowest), highest)
            du = u - before

            drawn = middle + model.elastic[axis] * (u - middle)
            for i in range(model.weights.shape[1]):
                r = model.thresholds_um[axis, i]
                plays_um[axis, i] = max(u - r, min(u + r, plays_um[axis, i]))
                drawn += model.weights[axis, i] * (plays_um[axis, i] - middle)
            pulled = drawn
            for j in range(len(model.creep_shares)):
                crept_um[axis, j] += model.creep_shares[j] * (drawn - crept_um[axis, j])
                pulled += model.creep_weights[axis, j] * (crept_um[axis, j] - middle)

            away = x - pulled
            x = pulled + xx * away + xv * v
            v = vx * away + vv * v
        position_um[axis], velocity_um_s[axis], voltage_um[axis] = x, v, u
        voltage_step_um[axis], errors_um[axis, 0], errors_um[axis, 1] = du, e1, e2
        reference_um[axis], reading_um[axis] = reference, reading
    return ModelState(
        position_um,
        velocity_um_s,
        reading_um,
        reference_um,
        voltage_um,
        voltage_step_um,
        errors_um,
        plays_um,
        crept_um,
    )
