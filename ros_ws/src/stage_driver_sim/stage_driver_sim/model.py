# SPDX-License-Identifier: Apache-2.0
"""One closed-loop axis of a piezo stage: commanded position → true position → sensor reading.

The cascade is the usual one for a servo-controlled nanopositioner: travel limits, then a slew
limit (the amplifier's current), then a second-order closed loop::

    x'' = w^2 (u - x) - 2 z w x'        w = 2 pi f: natural frequency, z: damping ratio

with `u` the slew-limited command. `u` is linear in time between two events, and for a ramp of
rate `q` the loop has the particular solution ``x_p = u - 2 z q / w``, ``x_p' = q``: what remains
is a free oscillation about it, which the matrix exponential carries over any time step exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from stage_driver_sim.errors import InvalidParameter


@dataclass(frozen=True)
class AxisParameters:
    """What one closed-loop axis does.

    Parameters
    ----------
    lower_um, upper_um : float
        Ends of the closed-loop travel [µm].
    max_velocity_um_s : float
        Slew limit [µm/s].
    natural_frequency_Hz : float
        Undamped natural frequency of the closed loop [Hz].
    damping_ratio : float
        Damping of the closed loop [-]; 1 is critical.
    noise_rms_um : float
        Standard deviation of the white sensor noise [µm]; 0: none.
    resolution_um : float
        Step of the sensor reading [µm]; 0: continuous.

    Raises
    ------
    InvalidParameter
        A value outside its range; the message names it.
    """

    lower_um: float
    upper_um: float
    max_velocity_um_s: float
    natural_frequency_Hz: float
    damping_ratio: float
    noise_rms_um: float
    resolution_um: float

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not (math.isfinite(self.lower_um) and math.isfinite(self.upper_um)):
            raise InvalidParameter(f'travel is {self.lower_um} to {self.upper_um} µm, not finite')
        if self.lower_um >= self.upper_um:
            raise InvalidParameter(
                f'travel is {self.lower_um} to {self.upper_um} µm; allowed: lower < upper'
            )
        for field in ('max_velocity_um_s', 'natural_frequency_Hz', 'damping_ratio'):
            value = getattr(self, field)
            if not 0.0 < value < math.inf:
                raise InvalidParameter(f'{field} is {value}; allowed: a number > 0')
        for field in ('noise_rms_um', 'resolution_um'):
            value = getattr(self, field)
            if not 0.0 <= value < math.inf:
                raise InvalidParameter(f'{field} is {value}; allowed: a number >= 0')


class AxisState(NamedTuple):
    """State of one axis: all that its future depends on."""

    position_um: float
    """True position [µm]."""
    velocity_um_s: float
    """True velocity [µm/s]."""
    reference_um: float
    """Slew-limited command that the loop follows [µm]."""


def axis_at_rest(position_um: float) -> AxisState:
    """Return the state of an axis that stands at `position_um`.

    Parameters
    ----------
    position_um : float
        Where it stands [µm].

    Examples
    --------
    >>> axis_at_rest(50.0)
    AxisState(position_um=50.0, velocity_um_s=0.0, reference_um=50.0)
    """
    return AxisState(position_um, 0.0, position_um)


def step_axis(
    axis: AxisParameters,
    state: AxisState,
    command_um: float,
    dt_s: float,
    slew_um_s: float = math.inf,
) -> AxisState:
    """Return the state `dt_s` later, the command being constant meanwhile.

    The slew limit holds for the reference. The position behind an underdamped loop may exceed it
    for a moment by the loop's overshoot (5 % at a damping ratio of 0.7).

    Parameters
    ----------
    axis : AxisParameters
        The axis.
    state : AxisState
        State now.
    command_um : float
        Commanded position [µm]; beyond the travel it saturates at the end.
    dt_s : float
        Time step [s], >= 0; any length, the result is exact.
    slew_um_s : float
        A slower slew limit for this step [µm/s].

    Raises
    ------
    InvalidParameter
        `dt_s` is negative or not finite.
    """
    if not 0.0 <= dt_s < math.inf:
        raise InvalidParameter(f'time step is {dt_s} s; allowed: a number >= 0')
    target_um = min(max(command_um, axis.lower_um), axis.upper_um)
    distance_um = target_um - state.reference_um
    rate_um_s = math.copysign(min(axis.max_velocity_um_s, slew_um_s), distance_um)
    ramp_s = distance_um / rate_um_s
    if ramp_s >= dt_s:
        return _follow_ramp(axis, state, rate_um_s, dt_s)
    if ramp_s > 0.0:
        state = _follow_ramp(axis, state, rate_um_s, ramp_s)
    # `target_um` itself, not the sum of the ramp: a reference at rest must not collect rounding.
    state = AxisState(state.position_um, state.velocity_um_s, target_um)
    return _follow_ramp(axis, state, 0.0, dt_s - ramp_s)


def _follow_ramp(
    axis: AxisParameters, state: AxisState, rate_um_s: float, dt_s: float
) -> AxisState:
    """Return the state after `dt_s` of a reference moving at `rate_um_s`: exact solution."""
    w = 2.0 * math.pi * axis.natural_frequency_Hz
    z = axis.damping_ratio
    lag_um = 2.0 * z * rate_um_s / w
    offset_um = state.position_um - (state.reference_um - lag_um)
    offset_um_s = state.velocity_um_s - rate_um_s
    cosine, sine_s = _decay(w, z, dt_s)
    reference_um = state.reference_um + rate_um_s * dt_s
    return AxisState(
        position_um=reference_um
        - lag_um
        + (cosine + z * w * sine_s) * offset_um
        + sine_s * offset_um_s,
        velocity_um_s=rate_um_s
        - w * w * sine_s * offset_um
        + (cosine - z * w * sine_s) * offset_um_s,
        reference_um=reference_um,
    )


def _decay(w: float, z: float, t: float) -> tuple[float, float]:
    """Return ``e^(-zwt) cos(vt)`` and ``e^(-zwt) sin(vt)/v``, v = w sqrt(1 - z²), for any damping.

    They make up the matrix exponential of ``[[0, 1], [-w², -2zw]] t``.
    """
    if z < 1.0:
        v = w * math.sqrt(1.0 - z * z)
        envelope = math.exp(-z * w * t)
        return envelope * math.cos(v * t), envelope * math.sin(v * t) / v
    v = w * math.sqrt(z * z - 1.0)
    slow = math.exp((v - z * w) * t)
    # cosh and sinh would overflow; expm1 keeps the difference exact for v -> 0.
    fast_less_slow = math.expm1(-2.0 * v * t)
    cosine = slow * (1.0 + 0.5 * fast_less_slow)
    sine = -slow * fast_less_slow / (2.0 * v) if v > 0.0 else slow * t
    return cosine, sine


def read_sensor(axis: AxisParameters, state: AxisState, noise: float) -> float:
    """Return what the position sensor reads [µm]: truth, noise, then quantisation.

    Parameters
    ----------
    axis : AxisParameters
        The axis.
    state : AxisState
        State now.
    noise : float
        One draw of the standard normal distribution [-].

    Examples
    --------
    >>> coarse = AxisParameters(0.0, 100.0, 1e4, 150.0, 0.7, noise_rms_um=0.0, resolution_um=0.25)
    >>> read_sensor(coarse, axis_at_rest(50.3), noise=0.0)
    50.25
    """
    reading_um = state.position_um + axis.noise_rms_um * noise
    if axis.resolution_um > 0.0:
        reading_um = axis.resolution_um * round(reading_um / axis.resolution_um)
    return reading_um
