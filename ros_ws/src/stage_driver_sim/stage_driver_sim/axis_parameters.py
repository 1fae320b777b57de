# SPDX-License-Identifier: Apache-2.0
"""What one axis of a piezo stage is like: travel, piezo, mechanics, servo and sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stage_driver_sim.errors import InvalidParameter

RANGES = {
    'natural_frequency_Hz': (0.1, 1000.0),
    'damping_ratio': (0.3, 10.0),
    'resonance_Hz': (20.0, 5000.0),
    'resonance_damping': (0.001, 2.0),
    'hysteresis': (0.0, 0.3),
    'creep_per_decade': (0.0, 0.03),
}


@dataclass(frozen=True)
class AxisParameters:
    """What one axis does.

    Parameters
    ----------
    lower_um, upper_um : float
        Ends of the closed-loop travel [µm].
    max_velocity_um_s : float
        Slew limit of the reference that the servo follows; open loop, of the voltage [µm/s].
    natural_frequency_Hz : float
        Undamped natural frequency of the closed loop [Hz]: about its bandwidth.
    damping_ratio : float
        Damping of the closed loop [-]; 1 is critical.
    noise_rms_um : float
        Standard deviation of the white noise of one sensor reading [µm]; 0: none.
    resolution_um : float
        Step of the sensor reading [µm]; 0: continuous.
    resonance_Hz : float
        Undamped frequency of the first mechanical resonance [Hz].
    resonance_damping : float
        Its damping ratio [-].
    hysteresis : float
        Width of the open-loop curve of the whole travel, as a share of the travel [-]; 0: none.
    creep_per_decade : float
        How much a step of the voltage grows per decade of time, as a share of the step [-].

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
    resonance_Hz: float
    resonance_damping: float
    hysteresis: float
    creep_per_decade: float

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not (math.isfinite(self.lower_um) and math.isfinite(self.upper_um)):
            raise InvalidParameter(f'travel is {self.lower_um} to {self.upper_um} µm, not finite')
        if self.lower_um >= self.upper_um:
            raise InvalidParameter(
                f'travel is {self.lower_um} to {self.upper_um} µm; allowed: lower < upper'
            )
        if not 0.0 < self.max_velocity_um_s < math.inf:
            raise InvalidParameter(
                f'max_velocity_um_s is {self.max_velocity_um_s}; allowed: a number > 0'
            )
        for field in ('noise_rms_um', 'resolution_um'):
            value = getattr(self, field)
            if not 0.0 <= value < math.inf:
                raise InvalidParameter(f'{field} is {value}; allowed: a number >= 0')
        for field, (low, high) in RANGES.items():
            value = getattr(self, field)
            if not low <= value <= high:
                raise InvalidParameter(f'{field} is {value}; allowed: {low:g} to {high:g}')

    @property
    def middle_um(self) -> float:
        """Middle of the travel [µm]."""
        return 0.5 * (self.lower_um + self.upper_um)

    @property
    def half_travel_um(self) -> float:
        """Half the travel [µm]."""
        return 0.5 * (self.upper_um - self.lower_um)
