# SPDX-License-Identifier: Apache-2.0
"""What a stage driver does at any moment: modes, commands and faults, without ROS and threads.

::

              set_servo(false)           chunk                 home
       OFF <------------------> HOLDING -------> STREAMING    HOLDING -------> HOMING
              set_servo(true)      ^               |             ^               |
                                   |  end of stream|             |  home reached |
                                   +---------------+             +---------------+

       any but FAULT --stop--> STOPPED                           --reset--> HOLDING or OFF
       any           --refused chunk, stream run dry--> FAULT    --reset--> HOLDING or OFF
       any           --stage fails or is silent-------> FAULT    --reset--> HOLDING
       STREAMING     --contact, stream is guarded-----> HOLDING

Whatever ends a stream early, the command brakes along its path and then holds. A stage that fails
is not commanded any more, because nobody knows where it is, until `reset` takes it over anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stage_driver_sim.brake import Brake
from stage_driver_sim.chunk import Chunk
from stage_driver_sim.contact_guard import ContactGuard, ContactReport
from stage_driver_sim.errors import (
    ContactSilent,
    LeftoverChunk,
    NotAllowed,
    StageError,
    StageFailed,
    StreamBroken,
)
from stage_driver_sim.protocol import Stage, StageLimits, Vector
from stage_driver_sim.setpoint_stream import (
    Phase,
    SetpointStream,
    StreamCommand,
    accept_chunk,
)
from stage_driver_sim.snapshot import Event, Mode, Snapshot

VELOCITY_FILTER_S = 0.005
"""Time constant of the velocity estimate: turns 1 nm of noise at 1 kHz into 0.4 µm/s."""

NOWHERE_UM: Vector = np.full(3, np.nan)
NOWHERE_UM.setflags(write=False)


@dataclass(frozen=True)
class ControllerSettings:
    """How a driver brakes, and when it calls a stage on target.

    Parameters
    ----------
    deceleration_um_s2 : float
        Of every stop, along the path [µm/s²].
    on_target_window_um : float
        Largest distance from the command, per axis [µm].
    on_target_dwell_s : float
        How long the stage has to stay inside the window [s].
    """

    deceleration_um_s2: float
    on_target_window_um: float
    on_target_dwell_s: float


class StageController:
    """Follows streams, brakes, homes and refuses, on top of any `Stage`.

    Taking over a stage closes its servo and holds it where it is.

    Parameters
    ----------
    stage : Stage
        The stage; nobody else commands it.
    name : str
        Begins every message, e.g. ``finger_1``.
    settings : ControllerSettings
        Braking and the on-target window.
    now_s : float
        Time [s] on the clock of all later calls.
    """

    def __init__(
        self, stage: Stage, *, name: str, settings: ControllerSettings, now_s: float
    ) -> None:
        self._stage = stage
        self._name = name
        self._settings = settings
        self._mode = Mode.HOLDING
        self._lost = False
        self._stream: SetpointStream | None = None
        self._brake: Brake | None = None
        self._guard = ContactGuard()
        self._contact_um: Vector | None = None
        self._underruns = 0
        self._dropped = 0
        self._error_code = 0
        self._error_msg = ''
        self._events: list[Event] = []
        self._velocity_um_s: Vector = np.zeros(3)
        self._in_window_since_s = math.inf
        self._take_over(now_s)

    @property
    def limits(self) -> StageLimits:
        """What the stage can do."""
        return self._stage.limits

    @property
    def moving(self) -> bool:
        """True: the command is, or is about to be, on its way."""
        return self._brake is not None or self._mode in (Mode.STREAMING, Mode.HOMING)

    def tick(self, now_s: float) -> Snapshot:
        """Measure, command and report; to be called at a steady rate.

        Parameters
        ----------
        now_s : float
            Time [s].
        """
        command_um = self._held_um
        try:
            self._measure(now_s)
            command_um = self._command_at(now_s)
            if self._stage.servo_on and not self._lost and self._mode is not Mode.HOMING:
                self._stage.command_um(command_um, now_s)
        except StageError as error:
            self._lose(error, now_s)
            command_um = self._held_um
        return Snapshot(
            time_s=self._last_s,
            mode=self._mode,
            position_um=self._last_um,
            velocity_um_s=self._velocity_um_s,
            command_um=command_um,
            on_target=self._is_on_target(command_um),
            stream=0 if self._stream is None else self._stream.number,
            received=0 if self._stream is None else self._stream.received,
            underruns=self._underruns,
            dropped=self._dropped,
            error_code=self._error_code,
            error_msg=self._error_msg,
            guard_tripped=self._contact_um is not None,
            contact_um=NOWHERE_UM if self._contact_um is None else self._contact_um,
        )

    def accept(self, chunk: Chunk, now_s: float) -> None:
        """Add a chunk to its stream; one that does not fit is a fault, a leftover is dropped."""
        if self._mode in (Mode.FAULT, Mode.STOPPED):
            self._dropped += 1
            return
        try:
            stream = accept_chunk(
                self._stream,
                chunk,
                running=self._mode is Mode.STREAMING,
                limits=self._stage.limits,
                held_um=self._held_um,
                now_s=now_s,
            )
            if stream is self._stream:
                self._dropped += 1
                return
            if self._mode is not Mode.STREAMING:
                self._require_rest(f'stream {chunk.stream} begins')
        except LeftoverChunk:
            self._dropped += 1
        except StageError as error:
            self.fail(error, now_s)
        else:
            self._contact_um = None
            self._stream = stream
            self._mode = Mode.STREAMING

    def note_contact(self, report: ContactReport) -> None:
        """Take in what is reported about contact; it ends a guarded stream at the next tick."""
        self._guard.note(report)

    def refuse(self, error: StageError, now_s: float) -> None:
        """Treat a chunk that could not even be read like one that does not fit."""
        if self._mode in (Mode.FAULT, Mode.STOPPED):
            self._dropped += 1
        else:
            self.fail(error, now_s)

    def fail(self, error: StageError, now_s: float) -> None:
        """Brake, hold, and refuse motion until `reset`; the first error stays."""
        if self._mode is Mode.FAULT:
            return
        self._end_motion(now_s)
        self._mode = Mode.FAULT
        self._error_code = error.code
        self._error_msg = f'{self._name}: {error}'
        self._events.append(Event(now_s, self._error_code, self._error_msg))

    def stop(self, now_s: float) -> None:
        """Brake, hold, and refuse motion until `reset`. A fault stays a fault."""
        if self._mode in (Mode.FAULT, Mode.STOPPED):
            return
        self._end_motion(now_s)
        self._mode = Mode.STOPPED
        self._events.append(Event(now_s, 0, f'{self._name}: stopped'))

    def home(self, now_s: float) -> None:
        """Set off for home.

        Raises
        ------
        NotAllowed
            The stage is not holding at rest.
        """
        self._require_rest('home')
        self._stage.home(now_s)
        self._mode = Mode.HOMING

    def reset(self, now_s: float) -> None:
        """Forget a stop or a fault; without one it changes nothing.

        Raises
        ------
        StageFailed
            The stage that failed still does.
        """
        if self._mode not in (Mode.FAULT, Mode.STOPPED):
            return
        if self._lost:
            self._take_over(now_s)
        self._mode = Mode.HOLDING if self._stage.servo_on else Mode.OFF
        self._error_code = 0
        self._error_msg = ''
        self._events.append(Event(now_s, 0, f'{self._name}: reset'))

    def set_servo(self, enabled: bool, now_s: float) -> None:
        """Close the loop where the stage is, or open it.

        Raises
        ------
        NotAllowed
            The loop is to be opened while the stage moves.
        """
        if enabled == self._stage.servo_on:
            return
        if self.moving:
            raise NotAllowed(f'servo off in mode {self._mode.name}; allowed: at rest')
        self._stage.set_servo(enabled, now_s)
        self._held_um = self._inside(self._stage.measure_um(now_s))
        if self._mode in (Mode.OFF, Mode.HOLDING):
            self._mode = Mode.HOLDING if enabled else Mode.OFF

    def take_events(self) -> list[Event]:
        """Return the events since the last call, oldest first."""
        events, self._events = self._events, []
        return events

    def _command_at(self, now_s: float) -> Vector:
        """Return the command of this moment [µm]; end what has reached its end."""
        if self._mode is Mode.HOMING:
            if self._stage.is_homing(now_s):
                return self._stage.limits.home_um
            self._held_um = self._stage.limits.home_um
            self._mode = Mode.HOLDING
        if self._mode is Mode.STREAMING and self._stream is not None:
            wanted = self._stream.command_at(now_s)
            if wanted.phase is Phase.WAITING:
                return self._held_um
            if self._stream.guarded:
                self._end_at_contact(self._stream, now_s)
            if self._mode is Mode.STREAMING and wanted.phase is Phase.RUNNING:
                return self._inside(wanted.position_um)
            self._end_stream(self._stream, wanted, now_s)
        if self._brake is not None:
            self._held_um = self._inside(self._brake.position_at(now_s))
            if now_s >= self._brake.end_s:
                self._brake = None
        return self._held_um

    def _end_at_contact(self, stream: SetpointStream, now_s: float) -> None:
        """Brake and hold if something has been met."""
        try:
            self._contact_um = self._guard.contact_um(stream.begin_s, now_s)
        except ContactSilent as error:
            self.fail(error, now_s)
        if self._contact_um is not None:
            self._end_motion(now_s)
            self._mode = Mode.HOLDING

    def _end_stream(self, stream: SetpointStream, wanted: StreamCommand, now_s: float) -> None:
        """Hold at the end of a stream; one that ran dry is a fault."""
        if self._mode is not Mode.STREAMING:
            return  # braking already
        if wanted.phase is Phase.DONE:
            self._held_um = self._inside(wanted.position_um)
            self._mode = Mode.HOLDING
            return
        self._underruns += 1
        self.fail(
            StreamBroken(
                f'stream {stream.number} ran dry after setpoint {stream.received - 1}, '
                'its end not announced'
            ),
            now_s,
        )

    def _end_motion(self, now_s: float) -> None:
        """Begin to brake from whatever moves the stage."""
        if self._mode is Mode.HOMING:
            try:
                self._held_um = self._inside(self._stage.stop(now_s))
            except StageFailed:
                self._lost = True  # the next tick says so
        elif self._mode is Mode.STREAMING and self._stream is not None:
            wanted = self._stream.command_at(now_s)
            if wanted.phase is not Phase.WAITING:
                begin_s = min(now_s, self._stream.times_s[-1])
                self._brake = Brake(
                    begin_s,
                    wanted.position_um,
                    wanted.velocity_um_s,
                    self._settings.deceleration_um_s2,
                )

    def _require_rest(self, wish: str) -> None:
        if self._mode is not Mode.HOLDING or self.moving:
            raise NotAllowed(f'{wish} in mode {self._mode.name}; allowed: HOLDING, at rest')

    def _inside(self, position_um: Vector) -> Vector:
        """Return the nearest position inside the travel."""
        limits = self._stage.limits
        inside_um: Vector = np.minimum(np.maximum(position_um, limits.lower_um), limits.upper_um)
        return inside_um

    def _take_over(self, now_s: float) -> None:
        """Close the servo of a stage, and hold it where it is."""
        self._stage.set_servo(True, now_s)
        self._last_um = self._stage.measure_um(now_s)
        self._last_s = self._stage.measured_s
        self._held_um = self._inside(self._last_um)
        self._lost = False

    def _lose(self, error: StageError, now_s: float) -> None:
        """Command nothing any more: the stage failed, and whether it moves is unknown."""
        if self._lost and self._mode is Mode.FAULT:
            return
        self._lost = True
        self._brake = None
        self._held_um = self._inside(self._last_um)
        self._velocity_um_s = np.zeros(3)
        if self._mode is not Mode.FAULT:
            self._mode = Mode.HOLDING  # there is no motion to end
            self.fail(error, now_s)

    def _measure(self, now_s: float) -> None:
        """Take in where the stage is; low-pass the difference quotient of its readings."""
        position_um = self._stage.measure_um(now_s)
        measured_s = self._stage.measured_s
        self._guard.remember(measured_s, position_um)
        dt_s = measured_s - self._last_s
        if dt_s > 0.0:
            share = -math.expm1(-dt_s / VELOCITY_FILTER_S)
            quotient_um_s = (position_um - self._last_um) / dt_s
            self._velocity_um_s = self._velocity_um_s + share * (
                quotient_um_s - self._velocity_um_s
            )
        self._last_um, self._last_s = position_um, measured_s

    def _is_on_target(self, command_um: Vector) -> bool:
        away_um = float(np.abs(self._last_um - command_um).max())
        near = away_um <= self._settings.on_target_window_um
        if not near or self._lost or not self._stage.servo_on:
            self._in_window_since_s = math.inf
            return False
        self._in_window_since_s = min(self._in_window_since_s, self._last_s)
        return self._last_s - self._in_window_since_s >= self._settings.on_target_dwell_s
