# SPDX-License-Identifier: Apache-2.0
"""A stage behind a GCS controller: `Stage` by commands and replies, one after the other.

Every call takes as long as the controller takes to answer; `RemoteStage` keeps that from the
control loop. Positions are µm, as piezo controllers give them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stage_driver_sim.errors import InvalidParameter, NotAllowed, StageFailed, StageSilent
from stage_driver_sim.gcs import error_codes
from stage_driver_sim.gcs.connection import Connection
from stage_driver_sim.gcs.syntax import STOP, axis_values, command_line
from stage_driver_sim.protocol import AXES, StageLimits, Vector

HOMING_VELOCITY_UM_S = 1000.0
CHECK_EVERY = 10
"""Positions are read so many times before the controller is asked for errors."""
TRAVEL_TOLERANCE_UM = 0.01
"""Controllers give the ends of their travel rounded."""


class GcsStage:
    """Three axes of one GCS controller; see `Stage` for what each call promises.

    Uses ``*IDN?``, ``CSV?``, ``SAI?``, ``TMN?``, ``TMX?``, ``VEL``, ``SVO``, ``SVO?``, ``MOV``,
    ``MOV?``, ``POS?``, ``ONT?``, #24 and ``ERR?``. It sends no reference move and no auto-zero
    (``FRF``, ``ATZ``): piezo stages measure absolutely, and both would move a finger unasked.

    Parameters
    ----------
    connection : Connection
        To the controller; owned from now on.
    axes : sequence of 3 str
        What the controller calls x, y and z.
    limits : StageLimits
        What the stage shall be used for; its travel within that of the controller.
    now_s : float
        Time [s].

    Raises
    ------
    InvalidParameter
        The controller has no such axes, or its travel is smaller; the message names both.
    StageFailed
        It does not answer, answers nonsense, or refuses.
    """

    def __init__(
        self, connection: Connection, *, axes: Sequence[str], limits: StageLimits, now_s: float
    ) -> None:
        self._connection = connection
        self._axes = tuple(axes)
        self._limits = limits
        self._homing = False
        self._measured_s = now_s
        self._readings = 0
        try:
            self._hardware_id = self._identify(now_s)
            self._check_travel(now_s)
            self._servo_on = all(self._values('SVO?', now_s))
            self._set_velocity(now_s)
        except Exception:
            connection.close()
            raise

    @property
    def hardware_id(self) -> str:
        """What the controller says it is."""
        return self._hardware_id

    @property
    def limits(self) -> StageLimits:
        """What the stage can do."""
        return self._limits

    @property
    def servo_on(self) -> bool:
        """True: the position loops are closed."""
        return self._servo_on

    @property
    def measured_s(self) -> float:
        """When the latest reading was taken [s]."""
        return self._measured_s

    def set_servo(self, enabled: bool, now_s: float) -> None:
        """Close or open the loops; the controller takes its position for its target."""
        self._homing = False
        flag = '1' if enabled else '0'
        self._order(now_s, command_line('SVO', *self._each(flag)))
        states = self._values('SVO?', now_s)
        self._servo_on = all(states)
        if any(bool(state) != enabled for state in states):
            raise StageFailed(f'SVO {flag} has no effect: SVO? is {states}')

    def command_um(self, position_um: Vector, now_s: float) -> None:
        """Go to a position at once; what the controller thinks of it, `measure_um` learns."""
        self._limits.check_positions(position_um)
        if not self._servo_on:
            raise NotAllowed('the servo is off')
        if self.is_homing(now_s):
            raise NotAllowed('the stage is homing')
        self._connection.exchange(self._move(position_um), 0, now_s)

    def measure_um(self, now_s: float) -> Vector:
        """Return the measured position [µm]."""
        query = command_line('POS?', *self._axes)
        self._readings += 1
        if self._readings % CHECK_EVERY:
            (reply,) = self._connection.exchange(query, 1, now_s)
        else:
            reply, error = self._connection.exchange(query + command_line('ERR?'), 2, now_s)
            _require_no_error(error)
        self._measured_s = now_s
        return np.array(axis_values('POS?', reply, self._axes))

    def home(self, now_s: float) -> None:
        """Set off for home, all axes at `HOMING_VELOCITY_UM_S` at most."""
        if not self._servo_on:
            raise NotAllowed('the servo is off')
        slow_um_s = min(HOMING_VELOCITY_UM_S, self._limits.max_velocity_um_s)
        self._order(
            now_s, command_line('VEL', *self._each(slow_um_s)) + self._move(self._limits.home_um)
        )
        self._homing = True

    def is_homing(self, now_s: float) -> bool:
        """Return whether a `home` is still under way."""
        if self._homing and all(self._values('ONT?', now_s)):
            self._end_homing(now_s)
        return self._homing

    def stop(self, now_s: float) -> Vector:
        """Stop all axes, and return the targets that the controller keeps them at."""
        query = STOP.encode() + command_line('MOV?', *self._axes) + command_line('ERR?')
        targets, error = self._connection.exchange(query, 2, now_s)
        _require_no_error(error, error_codes.STOPPED)
        if self._homing:
            self._end_homing(now_s)
        return np.array(axis_values('MOV?', targets, self._axes))

    def close(self) -> None:
        """End the connection; the controller holds its position."""
        self._connection.close()

    def _end_homing(self, now_s: float) -> None:
        self._order(now_s, command_line('VEL', *self._each(self._limits.max_velocity_um_s)))
        self._homing = False

    def _identify(self, now_s: float) -> str:
        """Return who answers, once it is sure that it speaks GCS 2 and has the axes."""
        questions = b''.join(map(command_line, ('*IDN?', 'CSV?', 'SAI?', 'ERR?')))
        identity, version, axes, _ = self._connection.exchange(questions, 4, now_s)
        if version != ['2.0']:
            raise StageSilent(f'CSV? was answered {"; ".join(version)[:80]!r}; allowed: 2.0')
        missing = [axis for axis in self._axes if axis not in axes]
        if missing:
            raise InvalidParameter(
                f'gcs_axes is {" ".join(self._axes)!r}; '
                f'allowed: three of the axes that the controller has, {" ".join(axes)}'
            )
        return ' '.join(identity)[:100]

    def _check_travel(self, now_s: float) -> None:
        """Check that the controller reaches what the limits promise."""
        lowest, highest = self._values('TMN?', now_s), self._values('TMX?', now_s)
        for name, low, high, lower, upper in zip(
            AXES, lowest, highest, self._limits.lower_um, self._limits.upper_um, strict=True
        ):
            if lower < low - TRAVEL_TOLERANCE_UM or upper > high + TRAVEL_TOLERANCE_UM:
                raise InvalidParameter(
                    f'{name}: travel is {lower:g} to {upper:g} µm; '
                    f'allowed: within the {low:g} to {high:g} µm of the controller'
                )

    def _set_velocity(self, now_s: float) -> None:
        velocity_um_s = self._limits.max_velocity_um_s
        try:
            self._order(now_s, command_line('VEL', *self._each(velocity_um_s)))
        except StageSilent:
            raise
        except StageFailed as error:
            raise InvalidParameter(
                f'max_velocity is {velocity_um_s:g} µm/s: {error}; '
                'allowed: what the controller takes'
            ) from error

    def _move(self, position_um: Vector) -> bytes:
        numbers = position_um.tolist()
        pairs = [word for pair in zip(self._axes, numbers, strict=True) for word in pair]
        return command_line('MOV', *pairs)

    def _each(self, value: str | float) -> list[str | float]:
        """Return axis and value, for every axis."""
        return [word for axis in self._axes for word in (axis, value)]

    def _values(self, query: str, now_s: float) -> list[float]:
        (reply,) = self._connection.exchange(command_line(query, *self._axes), 1, now_s)
        return axis_values(query, reply, self._axes)

    def _order(self, now_s: float, commands: bytes) -> None:
        """Send commands that have no reply; raise what the controller objects to."""
        (error,) = self._connection.exchange(commands + command_line('ERR?'), 1, now_s)
        _require_no_error(error)


def _require_no_error(reply: Sequence[str], *expected: int) -> None:
    """Raise what a reply to ``ERR?`` reports, unless it was to be expected."""
    try:
        (text,) = reply
        code = int(text)
    except ValueError:
        raise StageSilent(
            f'ERR? was answered {"; ".join(reply)[:80]!r}; allowed: an integer'
        ) from None
    if code not in (error_codes.NO_ERROR, *expected):
        raise StageFailed(error_codes.describe(code))
