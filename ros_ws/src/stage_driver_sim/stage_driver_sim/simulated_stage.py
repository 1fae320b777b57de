# SPDX-License-Identifier: Apache-2.0
"""A stage that exists only as its model: `Stage` over three `AxisParameters`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stage_driver_sim.errors import InvalidParameter, NotAllowed
from stage_driver_sim.model import AxisParameters, axis_at_rest, read_sensor, step_axis
from stage_driver_sim.protocol import StageLimits, Vector

HOMING_VELOCITY_UM_S = 1000.0


class SimulatedStage:
    """A closed-loop XYZ stage; see `Stage` for what each call promises.

    The model advances when it is called, over the time that passed: how often it is called has no
    influence on the motion.

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
    ) -> None:
        if len(axes) != 3:
            raise InvalidParameter(f'{len(axes)} axes given; allowed: 3')
        self._axes = tuple(axes)
        self._limits = StageLimits(
            lower_um=np.array([axis.lower_um for axis in axes]),
            upper_um=np.array([axis.upper_um for axis in axes]),
            home_um=home_um,
            max_velocity_um_s=min(axis.max_velocity_um_s for axis in axes),
        )
        self._hardware_id = hardware_id
        self._rng = rng
        self._states = [axis_at_rest(float(x)) for x in self._limits.home_um]
        self._target_um = self._limits.home_um.tolist()
        self._time_s = now_s
        self._servo_on = False
        self._homing = False

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

    def set_servo(self, enabled: bool, now_s: float) -> None:
        """Close or open the loop; open, the amplifier keeps its voltage, the stage its place."""
        self._advance(now_s)
        if enabled != self._servo_on:
            self._states = [axis_at_rest(state.position_um) for state in self._states]
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
        self._target_um = position_um.tolist()

    def measure_um(self, now_s: float) -> Vector:
        """Return the sensor readings [µm], with new noise on every call."""
        self._advance(now_s)
        noise = self._rng.standard_normal(3).tolist()
        return np.array(
            [
                read_sensor(axis, state, draw)
                for axis, state, draw in zip(self._axes, self._states, noise, strict=True)
            ]
        )

    def home(self, now_s: float) -> None:
        """Set off for home, all axes at `HOMING_VELOCITY_UM_S`."""
        if not self._servo_on:
            raise NotAllowed('the servo is off')
        self._advance(now_s)
        self._target_um = self._limits.home_um.tolist()
        self._homing = True

    def is_homing(self, now_s: float) -> bool:
        """Return whether a `home` is still under way."""
        self._advance(now_s)
        return self._homing

    def stop(self, now_s: float) -> Vector:
        """Freeze the reference of the loop where it is."""
        self._advance(now_s)
        self._hold()
        return np.array(self._target_um)

    def _hold(self) -> None:
        self._target_um = [state.reference_um for state in self._states]
        self._homing = False

    def _advance(self, now_s: float) -> None:
        """Carry the model to `now_s` with the command in force."""
        dt_s = now_s - self._time_s
        if dt_s < 0.0:
            raise InvalidParameter(f'time went back by {-dt_s:g} s')
        self._time_s = now_s
        if not self._servo_on or dt_s == 0.0:
            return
        slew_um_s = HOMING_VELOCITY_UM_S if self._homing else math.inf
        self._states = [
            step_axis(axis, state, target_um, dt_s, slew_um_s)
            for axis, state, target_um in zip(
                self._axes, self._states, self._target_um, strict=True
            )
        ]
        if self._homing:
            self._homing = any(
                state.reference_um != target_um
                for state, target_um in zip(self._states, self._target_um, strict=True)
            )
