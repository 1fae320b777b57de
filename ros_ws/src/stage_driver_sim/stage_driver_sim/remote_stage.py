# SPDX-License-Identifier: Apache-2.0
"""A stage that takes its time to answer, in a thread of its own: no call of the driver waits.

The thread sends the latest command and reads the position at a steady rate; the control loop gets
the latest reading, and its time. When the stage falls silent the thread goes on to look for it.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent import futures
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from stage_driver_sim.errors import NotAllowed, StageError, StageSilent
from stage_driver_sim.protocol import Stage, StageLimits, Vector

SILENCE_S = 0.5
"""A stage whose latest reading is older does not answer [s]."""
ORDER_S = 0.45
"""Longest wait for a stage to stop, to home, or to switch its servo [s]."""
RETRY_S = 0.5
"""Between two attempts to find a stage that has fallen silent [s]."""

Result = TypeVar('Result')


@dataclass(frozen=True, eq=False)
class Reading:
    """What the thread saw last."""

    time_s: float
    position_um: Vector
    servo_on: bool
    homing: bool


class RemoteStage:
    """Runs a stage of slow answers; see `Stage`.

    Parameters
    ----------
    open_stage : callable
        Gets the time [s], returns the stage, and raises if there is none; also called to find it
        again.
    period_s : float
        Time between two commands, and between two readings [s]; longer if the stage takes longer.

    Raises
    ------
    StageError
        There is no stage.
    """

    def __init__(self, open_stage: Callable[[float], Stage], *, period_s: float) -> None:
        self._open_stage = open_stage
        self._period_s = period_s
        self._stage = open_stage(time.monotonic())
        self._hardware_id = self._stage.hardware_id
        self._limits = self._stage.limits
        self._reading = self._look()
        self._returned_s = self._reading.time_s
        self._wanted_um: Vector | None = None
        self._sent_um: Vector | None = None
        self._failure: StageError | None = None
        self._orders: deque[Callable[[Stage, float], None]] = deque()
        self._cycles = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='remote stage')
        self._thread.start()

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
        return self._reading.servo_on

    @property
    def measured_s(self) -> float:
        """When the latest reading was taken [s]."""
        return self._returned_s

    @property
    def cycles(self) -> int:
        """How often it has been read since it was opened."""
        return self._cycles

    def set_servo(self, enabled: bool, now_s: float) -> None:
        """Close or open the loop, and wait until it is so."""
        self._wanted_um = None
        self._have_done(lambda stage, at_s: stage.set_servo(enabled, at_s))
        self._failure = None  # of before; since then the stage has answered

    def command_um(self, position_um: Vector, now_s: float) -> None:
        """Have a position sent with the next cycle; a later one replaces it."""
        self._limits.check_positions(position_um)
        self._require_answer(now_s)
        if not self._reading.servo_on:
            raise NotAllowed('the servo is off')
        if self._reading.homing:
            raise NotAllowed('the stage is homing')
        self._wanted_um = np.array(position_um, dtype=np.float64)

    def measure_um(self, now_s: float) -> Vector:
        """Return the latest reading [µm]; `measured_s` is its time."""
        self._require_answer(now_s)
        reading = self._reading
        self._returned_s = reading.time_s
        return reading.position_um

    def home(self, now_s: float) -> None:
        """Set off for home."""
        self._wanted_um = None
        self._have_done(lambda stage, at_s: stage.home(at_s))

    def is_homing(self, now_s: float) -> bool:
        """Return whether a `home` is still under way, as the latest reading has it."""
        self._require_answer(now_s)
        return self._reading.homing

    def stop(self, now_s: float) -> Vector:
        """Stop at once, and return the position held."""
        self._wanted_um = None
        return self._have_done(lambda stage, at_s: stage.stop(at_s))

    def close(self) -> None:
        """Let go of the stage, and return when the thread is gone."""
        self._stopping.set()
        self._thread.join()
        self._stage.close()

    def _require_answer(self, now_s: float) -> None:
        """Raise what has gone wrong since the last call, or that nothing is heard any more."""
        failure = self._failure
        if failure is not None:
            if not isinstance(failure, StageSilent):
                self._failure = None  # told once; the stage goes on answering
            raise failure
        silent_s = now_s - self._reading.time_s
        if silent_s > SILENCE_S:
            raise StageSilent(
                f'the stage has not answered for {silent_s:.2f} s; allowed: up to {SILENCE_S:g} s'
            )

    def _have_done(self, order: Callable[[Stage, float], Result]) -> Result:
        """Have the thread do `order`, and return its result."""
        if isinstance(self._failure, StageSilent):
            raise self._failure
        answer: futures.Future[Result] = futures.Future()

        def act(stage: Stage, at_s: float) -> None:
            if not answer.set_running_or_notify_cancel():
                return  # who asked for it has given up: it must not be done behind his back
            try:
                result = order(stage, at_s)
                self._reading = self._look()
            except StageSilent as error:
                answer.set_exception(error)
                raise
            except StageError as error:
                answer.set_exception(error)
            else:
                answer.set_result(result)

        self._orders.append(act)
        try:
            return answer.result(timeout=ORDER_S)
        except futures.TimeoutError:
            answer.cancel()
            raise StageSilent(f'the stage did not answer within {ORDER_S:g} s') from None

    def _look(self) -> Reading:
        """Read the stage; the time is the middle of question and answer."""
        asked_s = time.monotonic()
        position_um = self._stage.measure_um(asked_s)
        answered_s = time.monotonic()
        homing = self._stage.is_homing(answered_s)
        return Reading(0.5 * (asked_s + answered_s), position_um, self._stage.servo_on, homing)

    def _run(self) -> None:
        deadline_s = time.monotonic()
        while not self._stopping.is_set():
            try:
                if isinstance(self._failure, StageSilent):
                    self._find_again()
                else:
                    self._cycle()
            except StageSilent as error:
                self._failure = error
                self._stage.close()
            except StageError as error:
                self._failure = error
            retrying = isinstance(self._failure, StageSilent)
            now_s = time.monotonic()
            # Cycles that are late are left out, not made up for.
            deadline_s = max(deadline_s + (RETRY_S if retrying else self._period_s), now_s)
            self._stopping.wait(deadline_s - now_s)

    def _cycle(self) -> None:
        """Do what was ordered, send what is wanted, and read where the stage is."""
        while self._orders:
            self._sent_um = None
            self._orders.popleft()(self._stage, time.monotonic())
        wanted_um = self._wanted_um
        if wanted_um is not None and not self._same(wanted_um):
            self._stage.command_um(wanted_um, time.monotonic())
            self._sent_um = wanted_um
        self._reading = self._look()
        self._cycles += 1

    def _same(self, wanted_um: Vector) -> bool:
        return self._sent_um is not None and bool((self._sent_um == wanted_um).all())

    def _find_again(self) -> None:
        """Look for the stage; it must be the one that it was."""
        self._orders.clear()  # whoever waited for them has been told that it is silent
        self._wanted_um = self._sent_um = None
        try:
            stage = self._open_stage(time.monotonic())
        except StageError as error:
            raise StageSilent(str(error)) from error
        if stage.hardware_id != self._hardware_id:
            stage.close()
            raise StageSilent(
                f'{stage.hardware_id!r} answers; allowed: {self._hardware_id!r} as before'
            )
        self._stage = stage
        self._reading = self._look()
        self._failure = None
