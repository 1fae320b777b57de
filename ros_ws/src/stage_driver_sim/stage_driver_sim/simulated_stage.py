# SPDX-License-Identifier: Apache-2.0
"""A stage that exists only as its model: `Stage` over three `AxisParameters`.

The model advances when the stage is called, over the sampling periods of its controller that have
passed: how often it is called has no influence on its motion. Readings are those of the latest
sample, as from a real controller.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stage_driver_sim.axis_parameters import AxisParameters
from stage_driver_sim.errors import InvalidParameter, NotAllowed
from stage_driver_sim.model import at_rest, creep_on, hold, make_model, step
from stage_driver_sim.protocol import StageLimits, Vector
from stage_driver_sim.servo import SAMPLE_S

HOMING_VELOCITY_UM_S = 1000.0
LONGEST_COMPUTED_S = 10.0
"""After a longer pause all but these last seconds are taken as rest [s]: only creep counts."""
ARRIVED_UM = 1e-9


class SimulatedStage:
    """A closed-loop XYZ stage; see `Stage` for what each call promises.

    Parameters
    ----------
    axes : sequence of 3 AxisParameters
        x, y, z.
    home_um : (3,) ndarray
        Home position [µm]; the stage powers up there.
    rng : numpy.random.Generator
        Source of the sensor noise.
    now_s : float
        Time of power-up [s].
    hardware_id : str
        Name of the device.
    max_acceleration_um_s2 : float
        Stated in its limits [µm/s²]; infinite: not limited.

    Examples
    --------
    >>> from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
    >>> stage = SimulatedStage(
    ...     REPRESENTATIVE_100_UM_XYZ,
    ...     home_um=np.array([50.0, 50.0, 50.0]),
    ...     rng=np.random.default_rng(1),
    ...     now_s=0.0,
    ... )
    >>> stage.set_servo(True, now_s=0.0)
    >>> stage.command_um(np.array([60.0, 50.0, 50.0]), now_s=0.0)
    >>> bool(abs(stage.measure_um(now_s=0.1)[0] - 60.0) < 0.01)
    True
    """

    def __init__(
        self,
        axes: Sequence[AxisParameters],
        *,
        home_um: Vector,
        rng: np.random.Generator,
        now_s: float,
        hardware_id: str = 'simulated',
        max_acceleration_um_s2: float = math.inf,
    ) -> None:
        self._model = make_model(axes)
        self._limits = StageLimits(
            lower_um=self._model.lower_um,
            upper_um=self._model.upper_um,
            home_um=home_um,
            max_velocity_um_s=min(axis.max_velocity_um_s for axis in axes),
            max_acceleration_um_s2=max_acceleration_um_s2,
        )
        self._hardware_id = hardware_id
        self._rng = rng
        self._state = at_rest(self._model, self._limits.home_um)
        self._target_um: Vector = self._limits.home_um
        self._begin_s = now_s
        self._now_s = now_s
        self._samples = 0
        self._servo_on = False
        self._homing = False
        self._slew_um_s: Vector = np.full(3, math.inf)
        # Loads, or compiles, the model now rather than in the middle of a motion.
        step(self._model, self._state, self._target_um, 0, rng)

    @property
    def hardware_id(self) -> str:
        """Name of the device."""
        return self._hardware_id

    @property
    def limits(self) -> StageLimits:
        """What the stage can do."""
        return self._limits

    @property
    def servo_on(self) -> bool:
        """True: the position loop is closed."""
        return self._servo_on

    @property
    def measured_s(self) -> float:
        """When the latest reading was taken [s]."""
        return self._now_s

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which axes have not been led to their target yet, (3,)."""
        return np.abs(self._state.reference_um - self._target_um) > ARRIVED_UM

    def limit_velocity(self, velocity_um_s: Vector, now_s: float) -> None:
        """Move no faster than this from now on, per axis [µm/s]; infinite: as fast as it can."""
        self._advance(now_s)
        self._slew_um_s = np.array(velocity_um_s, dtype=np.float64)

    def set_servo(self, enabled: bool, now_s: float) -> None:
        """Close or open the loop; open, the amplifier keeps its voltage, the stage its place."""
        self._advance(now_s)
        if enabled != self._servo_on:
            self._state = hold(self._state, where_um=self._state.reading_um)
            self._hold()
        self._servo_on = enabled

    def command_um(self, position_um: Vector, now_s: float) -> None:
        """Go to a position at once."""
        self._limits.check_positions(position_um)
        if not self._servo_on:
            raise NotAllowed('the servo is off')
        self._advance(now_s)
        if self._homing:
            raise NotAllowed('the stage is homing')
        self._target_um = np.array(position_um, dtype=np.float64)

    def measure_um(self, now_s: float) -> Vector:
        """Return the latest sensor readings [µm]."""
        self._advance(now_s)
        return self._state.reading_um

    def home(self, now_s: float) -> None:
        """Set off for home, all axes at `HOMING_VELOCITY_UM_S`."""
        if not self._servo_on:
            raise NotAllowed('the servo is off')
        self._advance(now_s)
        self._target_um = self._limits.home_um
        self._homing = True

    def is_homing(self, now_s: float) -> bool:
        """Return whether a `home` is still under way."""
        self._advance(now_s)
        return self._homing

    def stop(self, now_s: float) -> Vector:
        """Freeze the reference of the loop where it is."""
        self._advance(now_s)
        self._hold()
        return self._target_um

    def close(self) -> None:
        """Nothing to let go of."""

    def _hold(self) -> None:
        self._target_um = self._state.reference_um
        self._homing = False

    def _advance(self, now_s: float) -> None:
        """Carry the model to the last sample before `now_s`, with the command in force."""
        if now_s < self._now_s:
            raise InvalidParameter(f'time went back by {self._now_s - now_s:g} s')
        self._now_s = now_s
        # A sample that is due this very moment is done: times are sums with rounding errors.
        due = math.floor((now_s - self._begin_s) / SAMPLE_S + 1e-6)
        samples = due - self._samples
        if samples <= 0:
            return
        self._samples = due
        rest = samples - round(LONGEST_COMPUTED_S / SAMPLE_S)
        if rest > 0:
            self._state = creep_on(self._model, self._state, rest * SAMPLE_S)
            samples -= rest
        self._state = step(
            self._model,
            self._state,
            self._target_um if self._servo_on else self._state.voltage_um,
            samples,
            self._rng,
            servo_on=self._servo_on,
            slew_um_s=HOMING_VELOCITY_UM_S if self._homing else self._slew_um_s,
        )
        self._homing = self._homing and bool(self.moving.any())
