# SPDX-License-Identifier: Apache-2.0
"""What a GCS controller answers: commands → what its stage does, and replies.

Knows no sockets and no clock. A line of which a part cannot be executed is not executed at all,
and leaves its error for ``ERR?``, which gives it once ([MS249E]_ in `syntax`). Errors have no
other answer: a query that is wrong gets none. Of its own it adds ``FLT <fault>`` and ``FLT?``:
what goes wrong, see `faults`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from stage_driver_sim.errors import StageFailed, StageSilent
from stage_driver_sim.faults import Fault, FaultSettings, FaultyStage
from stage_driver_sim.gcs import error_codes
from stage_driver_sim.gcs.syntax import LONGEST_LINE, MOTION, READY, STOP, reply_lines
from stage_driver_sim.protocol import ROUNDING_UM, Vector
from stage_driver_sim.simulated_stage import SimulatedStage

AXES = ('1', '2', '3')
ON_TARGET_UM = 0.05

Numbers = NDArray[np.float64]


class CommandError(Exception):
    """A command that the controller does not execute; `code` is for ``ERR?``."""

    def __init__(self, code: int) -> None:
        super().__init__(error_codes.describe(code))
        self.code = code


class SimulatedController:
    r"""A controller of three axes, ``1 2 3``, around a simulated stage.

    The stage has one servo for its axes: they move when it is on for all three.

    Parameters
    ----------
    stage : SimulatedStage
        Owned from now on; its velocity limit is the largest that ``VEL`` takes.

    Examples
    --------
    >>> from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
    >>> stage = SimulatedStage(
    ...     REPRESENTATIVE_100_UM_XYZ,
    ...     home_um=np.full(3, 50.0),
    ...     rng=np.random.default_rng(1),
    ...     now_s=0.0,
    ... )
    >>> controller = SimulatedController(stage)
    >>> controller.handle('MOV 1 60', now_s=0.0), controller.handle('ERR?', now_s=0.0)
    (b'', b'5\n')
    """

    def __init__(self, stage: SimulatedStage) -> None:
        self._plant = stage
        self._stage = FaultyStage(stage)
        self._fault = FaultSettings()
        self._servo = np.zeros(3, dtype=np.bool_)
        self._velocity_um_s: Vector = np.full(3, stage.limits.max_velocity_um_s)
        self._target_um: Vector = np.array(stage.limits.home_um)
        self._error = error_codes.NO_ERROR
        self._setters: dict[str, Callable[[Numbers, Numbers, float], None]] = {
            'SVO': self._set_servo,
            'MOV': self._move,
            'VEL': self._set_velocity,
        }
        self._getters: dict[str, Callable[[float], Sequence[float]]] = {
            'SVO?': lambda now_s: self._servo.astype(np.float64).tolist(),
            'MOV?': lambda now_s: self._target_um.tolist(),
            'VEL?': lambda now_s: self._velocity_um_s.tolist(),
            'POS?': lambda now_s: self._stage.measure_um(now_s).tolist(),
            'ONT?': lambda now_s: (~self._on_its_way(now_s)).astype(np.float64).tolist(),
            'TMN?': lambda now_s: stage.limits.lower_um.tolist(),
            'TMX?': lambda now_s: stage.limits.upper_um.tolist(),
        }

    def set_fault(self, settings: FaultSettings, now_s: float) -> None:
        """Let something go wrong with the stage from now on, or nothing any more."""
        self._fault = settings
        self._stage.set_fault(settings, now_s)

    def handle(self, command: str, now_s: float) -> bytes:
        """Execute a command; return its reply, empty if it has none.

        Parameters
        ----------
        command : str
            One line without LF, or one of the characters that are commands.
        now_s : float
            Time [s].
        """
        try:
            return self._handle(command, now_s)
        except CommandError as error:
            self._error = error.code
        except StageSilent:
            pass
        except StageFailed:
            self._error = error_codes.POSITION_OUT_OF_LIMITS
        return b''

    def _handle(self, command: str, now_s: float) -> bytes:
        if command == STOP:
            return self._stop(now_s)
        if command == MOTION:
            bits = int(self._on_its_way(now_s) @ [1, 2, 4])
            return reply_lines(f'{bits:x}')
        if command == READY:
            return reply_lines('\xb1')
        if len(command) > LONGEST_LINE:
            raise CommandError(error_codes.TOO_LONG)
        mnemonic, *arguments = command.split() or ['']
        mnemonic = mnemonic.upper()
        if self._fault.fault is Fault.SILENT and mnemonic not in ('FLT', 'FLT?'):
            return b''
        if mnemonic in self._getters:
            return self._query(mnemonic, arguments, now_s)
        if mnemonic in self._setters:
            axes, values = _pairs(arguments)
            self._setters[mnemonic](axes, values, now_s)
            return b''
        match (mnemonic, *arguments):
            case ('',):
                return b''
            case ('*IDN?',):
                return reply_lines(f'microhand, {self._plant.hardware_id}, 0, 0.1.0')
            case ('CSV?',):
                return reply_lines('2.0')
            case ('SAI?',):
                return reply_lines(*AXES)
            case ('ERR?',):
                code, self._error = self._error, error_codes.NO_ERROR
                return reply_lines(str(code))
            case ('STP', *_):
                return self._stop(now_s)
            case ('FLT?',):
                return reply_lines(self._fault.fault.value)
            case ('FLT', name):
                return self._change_fault(name, now_s)
        raise CommandError(error_codes.UNKNOWN_COMMAND)

    def _query(self, mnemonic: str, arguments: Sequence[str], now_s: float) -> bytes:
        axes = [_axis(name) for name in arguments] or range(len(AXES))
        values = self._getters[mnemonic](now_s)
        shape = '.0f' if mnemonic in ('SVO?', 'ONT?') else '.6f'
        return reply_lines(*(f'{AXES[axis]}={values[axis]:{shape}}' for axis in axes))

    def _set_servo(self, axes: Numbers, values: Numbers, now_s: float) -> None:
        if not np.isin(values, (0.0, 1.0)).all():
            raise CommandError(error_codes.SYNTAX)
        self._servo[axes.astype(int)] = values == 1.0
        self._stage.set_servo(bool(self._servo.all()), now_s)
        self._target_um = self._stage.measure_um(now_s).copy()

    def _move(self, axes: Numbers, values: Numbers, now_s: float) -> None:
        if not self._stage.servo_on:
            raise CommandError(error_codes.NO_SERVO)
        target_um = self._target_um.copy()
        target_um[axes.astype(int)] = values
        limits = self._stage.limits
        low_um, high_um = limits.lower_um - ROUNDING_UM, limits.upper_um + ROUNDING_UM
        if ((target_um < low_um) | (target_um > high_um)).any():
            raise CommandError(error_codes.POSITION_OUT_OF_LIMITS)
        self._target_um = target_um
        self._stage.command_um(target_um, now_s)

    def _set_velocity(self, axes: Numbers, values: Numbers, now_s: float) -> None:
        if (values <= 0.0).any() or (values > self._stage.limits.max_velocity_um_s).any():
            raise CommandError(error_codes.VELOCITY_OUT_OF_LIMITS)
        self._velocity_um_s = self._velocity_um_s.copy()
        self._velocity_um_s[axes.astype(int)] = values
        self._plant.limit_velocity(self._velocity_um_s, now_s)

    def _stop(self, now_s: float) -> bytes:
        self._target_um = self._stage.stop(now_s).copy()
        self._error = error_codes.STOPPED
        return b''

    def _on_its_way(self, now_s: float) -> NDArray[np.bool_]:
        away_um = np.abs(self._stage.measure_um(now_s) - self._target_um)
        return self._plant.moving | (away_um > ON_TARGET_UM)

    def _change_fault(self, name: str, now_s: float) -> bytes:
        try:
            fault = Fault(name.lower())
        except ValueError:
            raise CommandError(error_codes.SYNTAX) from None
        self.set_fault(FaultSettings(fault), now_s)
        return b''


def _axis(name: str) -> int:
    """Return the number, from 0, of an axis."""
    if name not in AXES:
        raise CommandError(error_codes.INVALID_AXIS)
    return AXES.index(name)


def _pairs(arguments: Sequence[str]) -> tuple[Numbers, Numbers]:
    """Return axes, from 0, and values of ``<axis> <value> <axis> <value> ...``."""
    if not arguments or len(arguments) % 2:
        raise CommandError(error_codes.SYNTAX)
    axes = [float(_axis(name)) for name in arguments[::2]]
    try:
        values = np.array([float(text) for text in arguments[1::2]])
    except ValueError:
        raise CommandError(error_codes.SYNTAX) from None
    if not np.isfinite(values).all():
        raise CommandError(error_codes.SYNTAX)
    return np.array(axes), values
