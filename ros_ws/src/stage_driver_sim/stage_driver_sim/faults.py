# SPDX-License-Identifier: Apache-2.0
"""A stage that misbehaves on demand: any `Stage`, with a fault between it and its driver.

What each fault looks like from outside, on the topic ``state``:

========  =========================================================================================
fault     effect
========  =========================================================================================
none      none
stuck     `position` stays where it is, `command` goes on, `on_target` becomes false; no error
silent    mode FAULT, STAGE_FAULT; `position` and stamp are those of the last answer
late      `position` follows `command` by `delay_s` later; `on_target` comes as much later
drifting  `position` runs away from `command`, all axes, at `drift_um_s`, up to the travel's end
limit     `position` does not come farther than `margin_um` from where the fault began; a command
          beyond ends in mode FAULT, STAGE_FAULT, with axis, limit and command in the text
========  =========================================================================================
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np

from stage_driver_sim.errors import InvalidParameter, NotAllowed, StageFailed, StageSilent
from stage_driver_sim.protocol import AXES, Stage, StageLimits, Vector


class Fault(Enum):
    """What goes wrong; see above."""

    NONE = 'none'
    STUCK = 'stuck'
    SILENT = 'silent'
    LATE = 'late'
    DRIFTING = 'drifting'
    LIMIT = 'limit'


@dataclass(frozen=True)
class FaultSettings:
    """What goes wrong, and how badly.

    Parameters
    ----------
    fault : Fault
        Which.
    delay_s : float
        Of fault late [s].
    drift_um_s : float
        Of fault drifting, per axis [µm/s].
    margin_um : float
        Of fault limit, per axis, both ways [µm].

    Raises
    ------
    InvalidParameter
        A size that is negative or no number.
    """

    fault: Fault = Fault.NONE
    delay_s: float = 0.1
    drift_um_s: float = 1.0
    margin_um: float = 0.5

    def __post_init__(self) -> None:
        """Check the sizes."""
        for field in ('delay_s', 'drift_um_s', 'margin_um'):
            value = getattr(self, field)
            if not 0.0 <= value < np.inf:
                raise InvalidParameter(f'{field} is {value}; allowed: a number >= 0')


class FaultyStage:
    """A stage behind a fault that can be changed at any time; see `Stage`.

    Parameters
    ----------
    stage : Stage
        The stage; nobody else commands it.

    Examples
    --------
    >>> from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
    >>> from stage_driver_sim.simulated_stage import SimulatedStage
    >>> stage = FaultyStage(
    ...     SimulatedStage(
    ...         REPRESENTATIVE_100_UM_XYZ,
    ...         home_um=np.full(3, 50.0),
    ...         rng=np.random.default_rng(1),
    ...         now_s=0.0,
    ...     )
    ... )
    >>> stage.set_fault(FaultSettings(Fault.SILENT), now_s=1.0)
    >>> stage.measure_um(now_s=1.1)
    Traceback (most recent call last):
    stage_driver_sim.errors.StageSilent: the stage does not answer
    """

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._settings = FaultSettings()
        self._begin_s = 0.0
        self._begin_um: Vector = np.zeros(3)
        self._wanted_um: Vector | None = None
        self._pending: deque[tuple[float, Vector]] = deque()
        self._never_home = False

    def set_fault(self, settings: FaultSettings, now_s: float) -> None:
        """Let something go wrong from now on, or nothing any more."""
        if settings == self._settings:
            return
        self._settings = settings
        self._begin_s = now_s
        self._begin_um = self._stage.measure_um(now_s)
        self._pending.clear()
        self._never_home = False
        if settings.fault is Fault.STUCK:
            self._never_home = self._stage.is_homing(now_s)
            self._stage.stop(now_s)

    @property
    def hardware_id(self) -> str:
        """Name of the device."""
        return self._stage.hardware_id

    @property
    def limits(self) -> StageLimits:
        """What the stage can do, when nothing is wrong."""
        return self._stage.limits

    @property
    def servo_on(self) -> bool:
        """True: the position loop is closed."""
        return self._stage.servo_on

    @property
    def measured_s(self) -> float:
        """When the latest reading was taken [s]."""
        return self._stage.measured_s

    def set_servo(self, enabled: bool, now_s: float) -> None:
        """Close or open the loop."""
        self._require_answer()
        self._wanted_um = None
        self._pending.clear()
        self._stage.set_servo(enabled, now_s)

    def command_um(self, position_um: Vector, now_s: float) -> None:
        """Go to a position, as far as the fault allows it."""
        if self._settings.fault is Fault.NONE:
            self._stage.command_um(position_um, now_s)
            self._wanted_um = position_um
            return
        self._require_answer()
        self.limits.check_positions(position_um)
        if not self.servo_on:
            raise NotAllowed('the servo is off')
        if self.is_homing(now_s):
            raise NotAllowed('the stage is homing')
        self._wanted_um = np.array(position_um, dtype=np.float64)
        match self._settings.fault:
            case Fault.STUCK:
                return
            case Fault.LATE:
                self._pending.append((now_s + self._settings.delay_s, self._wanted_um))
                self._carry_on(now_s)
            case Fault.LIMIT:
                reached_um = self._short_of_limit(self._wanted_um)
                self._stage.command_um(reached_um, now_s)
                self._require_within(self._wanted_um, reached_um)
            case Fault.DRIFTING:
                self._carry_on(now_s)

    def measure_um(self, now_s: float) -> Vector:
        """Return the latest sensor readings [µm]."""
        self._require_answer()
        self._carry_on(now_s)
        return self._stage.measure_um(now_s)

    def home(self, now_s: float) -> None:
        """Set off for home."""
        self._require_answer()
        if self._settings.fault is Fault.LIMIT:
            home_um = self.limits.home_um
            self._require_within(home_um, self._short_of_limit(home_um))
        self._wanted_um = None
        self._pending.clear()
        if self._settings.fault is Fault.STUCK and self.servo_on:
            self._never_home = True
        else:
            self._stage.home(now_s)

    def is_homing(self, now_s: float) -> bool:
        """Return whether a `home` is still under way."""
        self._require_answer()
        return self._never_home or self._stage.is_homing(now_s)

    def stop(self, now_s: float) -> Vector:
        """Stop at once."""
        self._require_answer()
        self._wanted_um = None
        self._pending.clear()
        self._never_home = False
        return self._stage.stop(now_s)

    def close(self) -> None:
        """Let go of the stage."""
        self._stage.close()

    def _require_answer(self) -> None:
        if self._settings.fault is Fault.SILENT:
            raise StageSilent('the stage does not answer')

    def _carry_on(self, now_s: float) -> None:
        """Do what a fault does by itself."""
        if self._settings.fault is Fault.NONE or not self.servo_on or self._stage.is_homing(now_s):
            return
        if self._settings.fault is Fault.LATE:
            while self._pending and self._pending[0][0] <= now_s:
                self._stage.command_um(self._pending.popleft()[1], now_s)
        elif self._settings.fault is Fault.DRIFTING:
            held_um = self._begin_um if self._wanted_um is None else self._wanted_um
            run_away_um = held_um + self._settings.drift_um_s * (now_s - self._begin_s)
            limits = self.limits
            inside_um = np.minimum(np.maximum(run_away_um, limits.lower_um), limits.upper_um)
            self._stage.command_um(inside_um, now_s)

    def _short_of_limit(self, position_um: Vector) -> Vector:
        margin_um = self._settings.margin_um
        low_um, high_um = self._begin_um - margin_um, self._begin_um + margin_um
        short_um: Vector = np.minimum(np.maximum(position_um, low_um), high_um)
        return short_um

    def _require_within(self, wanted_um: Vector, reached_um: Vector) -> None:
        axis = int(np.abs(wanted_um - reached_um).argmax())
        if wanted_um[axis] != reached_um[axis]:
            raise StageFailed(
                f'{AXES[axis]}: ran into its limit at {reached_um[axis]:.3f} µm, '
                f'commanded {wanted_um[axis]:.3f} µm'
            )
