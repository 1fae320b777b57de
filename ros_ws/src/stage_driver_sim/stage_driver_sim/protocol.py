# SPDX-License-Identifier: Apache-2.0
"""What every stage can do, simulated or real: the one interface below the driver.

Lengths are µm in the frame of the stage, times are seconds of one steady clock that the caller
reads. Axes are x, y, z in this order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stage_driver_sim.errors import InvalidNumber, InvalidParameter, TravelExceeded

AXES = 'xyz'
ROUNDING_UM = 1e-6
"""How far a position may miss the travel by converting from metres."""

Vector = NDArray[np.float64]
"""Three values, one per axis."""


@dataclass(frozen=True, eq=False)
class StageLimits:
    """What a stage can do.

    Parameters
    ----------
    lower_um, upper_um : (3,) ndarray
        Ends of the travel [µm].
    home_um : (3,) ndarray
        Where `home` goes [µm], inside the travel.
    max_velocity_um_s : float
        Velocity limit of each axis [µm/s].
    max_acceleration_um_s2 : float
        Acceleration limit of each axis [µm/s²]; infinite: not limited.

    Raises
    ------
    InvalidParameter
        Lower above upper, home outside, or a limit that is not positive.
    """

    lower_um: Vector
    upper_um: Vector
    home_um: Vector
    max_velocity_um_s: float
    max_acceleration_um_s2: float = np.inf
    _edges_um: list[list[float]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check and freeze."""
        for name in ('lower_um', 'upper_um', 'home_um'):
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.shape != (3,) or not np.isfinite(values).all():
                raise InvalidParameter(f'{name} is {values}; allowed: three finite numbers')
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        edges_um = np.array([self.lower_um - ROUNDING_UM, self.upper_um + ROUNDING_UM])
        object.__setattr__(self, '_edges_um', edges_um.tolist())
        for axis, lower, upper, home in zip(
            AXES, self.lower_um, self.upper_um, self.home_um, strict=True
        ):
            if lower >= upper:
                raise InvalidParameter(
                    f'{axis}: travel is {lower:g} to {upper:g} µm; allowed: lower < upper'
                )
            if not lower <= home <= upper:
                raise InvalidParameter(
                    f'{axis}: home is {home:g} µm; allowed: {lower:g} to {upper:g} µm'
                )
        if not 0.0 < self.max_velocity_um_s < np.inf:
            raise InvalidParameter(
                f'max_velocity is {self.max_velocity_um_s:g} µm/s; allowed: a number > 0'
            )
        if not self.max_acceleration_um_s2 > 0.0:
            raise InvalidParameter(
                f'max_acceleration is {self.max_acceleration_um_s2:g} µm/s²; allowed: a number > 0'
            )

    def _has_inside(self, position_um: Vector) -> bool:
        """Return whether all is well with one position; asked a thousand times a second."""
        if len(position_um) != 3:
            return False
        x, y, z = position_um.tolist()
        (x0, y0, z0), (x1, y1, z1) = self._edges_um
        return x0 <= x <= x1 and y0 <= y <= y1 and z0 <= z <= z1

    def check_positions(self, positions_um: NDArray[np.float64]) -> None:
        """Raise unless all positions are numbers inside the travel.

        Parameters
        ----------
        positions_um : (3,) or (n, 3) ndarray
            Positions [µm], stage frame.

        Raises
        ------
        InvalidNumber
            NaN or infinity.
        TravelExceeded
            A position outside the travel; the message names axis, demand and limit.
        """
        if positions_um.ndim == 1 and self._has_inside(positions_um):
            return
        rows = np.atleast_2d(positions_um)
        if not np.isfinite(rows).all():
            row, column = np.argwhere(~np.isfinite(rows))[0]
            raise InvalidNumber(
                f'{AXES[column]}: position {row} is {rows[row, column]}; allowed: a finite number'
            )
        lower_um, upper_um = self._edges_um
        outside = (rows < lower_um) | (rows > upper_um)
        if outside.any():
            row, column = np.argwhere(outside)[0]
            raise TravelExceeded(
                f'{AXES[column]}: position {row} is {rows[row, column]:.6g} µm; '
                f'allowed: {self.lower_um[column]:g} to {self.upper_um[column]:g} µm'
            )


class Stage(Protocol):
    """A three-axis stage. Every call is short: it starts or asks, it never waits for motion.

    A stage powers up with its servo off. `now_s` never decreases from call to call. Every call may
    raise `StageFailed`: the stage reports a failure, or does not answer; whether it then still
    moves is unknown.
    """

    @property
    def hardware_id(self) -> str:
        """Type and serial number, for diagnostics and the record."""

    @property
    def limits(self) -> StageLimits:
        """What the stage can do; constant."""

    @property
    def servo_on(self) -> bool:
        """True: the position loop is closed."""

    @property
    def measured_s(self) -> float:
        """When the position that `measure_um` returned last was measured [s]."""

    def set_servo(self, enabled: bool, now_s: float) -> None:
        """Close or open the position loop. The stage stays where it is."""

    def command_um(self, position_um: Vector, now_s: float) -> None:
        """Go to a position at once; a later command replaces it.

        Raises
        ------
        InvalidNumber, TravelExceeded
            Position not inside the travel; the command before stays in force.
        NotAllowed
            The servo is off or the stage is homing.
        """

    def measure_um(self, now_s: float) -> Vector:
        """Return the measured position [µm], the latest that is known; see `measured_s`."""

    def home(self, now_s: float) -> None:
        """Set off for the home position, at a speed that is safe for it.

        Raises
        ------
        NotAllowed
            The servo is off.
        """

    def is_homing(self, now_s: float) -> bool:
        """Return whether a `home` is still under way."""

    def stop(self, now_s: float) -> Vector:
        """Stop at once, end homing, and return the position [µm] held from now on."""

    def close(self) -> None:
        """Let go of the stage; nothing may be called after that."""
