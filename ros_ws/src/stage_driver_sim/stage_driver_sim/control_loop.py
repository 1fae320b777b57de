# SPDX-License-Identifier: Apache-2.0
"""The thread that owns the stage: ticks its controller at absolute deadlines.

Nothing else touches controller and stage while it runs. Others hand it work and read what it saw;
they meet in a queue, and under one lock that is held for assignments only.

The stage comes first: what waits elsewhere, such as setpoints, is looked for between two ticks, so
that reading it delays none. While the stage rests on its target nothing depends on the exact
moment: the loop looks after it every `REST_PERIOD_S`, or as soon as there is something to do.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent import futures
from dataclasses import dataclass
from typing import TypeVar

from stage_driver_sim.controller import StageController
from stage_driver_sim.errors import StageError
from stage_driver_sim.snapshot import Event, Mode, Snapshot

LOOK_PERIOD_S = 0.002
"""Between two looks for work that waits elsewhere [s], such as contact that stops a finger.

A tick that is late by more comes after a look: a stream must not be called dry unseen."""
REST_PERIOD_S = 0.005
"""Between two ticks of a stage at rest [s]: still twice for each state that is published."""
ANSWER_TIMEOUT_S = 0.5
"""Longest wait for the loop to do what it is asked; usually it takes one period."""

Result = TypeVar('Result')


@dataclass(frozen=True)
class LoopTiming:
    """How the loop kept its deadlines since the loop was last asked.

    Parameters
    ----------
    ticks : int
        Ticks done.
    missed : int
        Ticks left out because the one before ended after their deadline.
    worst_late_s : float
        Longest delay of a tick behind its deadline [s].
    resting_s : float
        Time passed between ticks because the stage stood still on its target [s].
    wall_s, cpu_s : float
        Time passed, and processor time of the thread in it [s].
    """

    ticks: int = 0
    missed: int = 0
    worst_late_s: float = 0.0
    resting_s: float = 0.0
    wall_s: float = 0.0
    cpu_s: float = 0.0


class ControlLoop:
    """Runs a controller in a thread of its own.

    Parameters
    ----------
    controller : StageController
        Handed over: nobody else may call it until `stop` has returned.
    period_s : float
        Time between two ticks [s].
    look_for_work : callable
        Called every `LOOK_PERIOD_S`, between two ticks, in the thread of the loop: it can `tell`;
        must not raise.
    """

    def __init__(
        self,
        controller: StageController,
        *,
        period_s: float,
        look_for_work: Callable[[], None] = lambda: None,
    ) -> None:
        self._controller = controller
        self._period_s = period_s
        self._look_for_work = look_for_work
        self._work: deque[Callable[[StageController, float], object]] = deque()
        self._stopping = threading.Event()
        self._news = threading.Event()
        self._thread = threading.Thread(target=self._run, name='control loop')
        self._lock = threading.Lock()
        self._snapshot = controller.tick(time.monotonic())
        self._events: list[Event] = []
        self._timing = LoopTiming()

    def start(self) -> None:
        """Begin to tick."""
        self._thread.start()

    @property
    def thread_id(self) -> int:
        """Of the thread that ticks, as the kernel knows it; 0: not started."""
        return self._thread.native_id or 0

    def stop(self) -> None:
        """Bring the stage to rest, end the thread, and return when it is gone."""
        self._stopping.set()
        self._news.set()
        self._thread.join()

    def tell(self, action: Callable[[StageController, float], object]) -> None:
        """Have `action` done before the next tick, in the order of the calls; do not wait.

        Parameters
        ----------
        action : callable
            Gets the controller and the time [s]; must not raise.
        """
        self._work.append(action)
        self._news.set()

    def ask(self, action: Callable[[StageController, float], Result]) -> Result:
        """Have `action` done before the next tick and return its result.

        Raises
        ------
        StageError
            What the action raised, or the loop does not answer.
        """
        answer: futures.Future[Result] = futures.Future()

        def act_and_answer(controller: StageController, now_s: float) -> None:
            try:
                answer.set_result(action(controller, now_s))
            except StageError as error:
                answer.set_exception(error)

        self.tell(act_and_answer)
        try:
            return answer.result(timeout=ANSWER_TIMEOUT_S)
        except futures.TimeoutError:
            raise StageError(
                f'the control loop did not answer within {ANSWER_TIMEOUT_S:g} s'
            ) from None

    def snapshot(self) -> Snapshot:
        """Return what the latest tick saw."""
        with self._lock:
            return self._snapshot

    def take_events(self) -> list[Event]:
        """Return the events since the last call, oldest first."""
        with self._lock:
            events, self._events = self._events, []
            return events

    def take_timing(self) -> LoopTiming:
        """Return how the deadlines were kept since the last call."""
        with self._lock:
            timing, self._timing = self._timing, LoopTiming()
            return timing

    def _run(self) -> None:
        try:
            self._tick_until_stopped()
        except Exception as error:
            # Whoever reads the state must learn that nobody controls the stage any more.
            text = f'the control loop ended: {type(error).__name__}: {error}'
            with self._lock:
                self._snapshot = self._snapshot._replace(
                    mode=Mode.FAULT,
                    on_target=False,
                    error_code=StageError.code,
                    error_msg=text,
                )
                self._events.append(Event(time.monotonic(), StageError.code, text))

    def _tick_until_stopped(self) -> None:
        deadline_s = time.monotonic()
        counted_s, counted_cpu_s = deadline_s, time.thread_time()
        rested_s = 0.0
        look_s = deadline_s
        while True:
            self._work_off()
            if time.monotonic() - deadline_s > LOOK_PERIOD_S:
                self._look_for_work()
                self._work_off()
            now_s = time.monotonic()
            ending = self._stopping.is_set()
            if ending:
                self._controller.stop(now_s)
            snapshot = self._controller.tick(now_s)
            events = self._controller.take_events()

            late_s = now_s - deadline_s
            deadline_s += self._period_s
            end_s, end_cpu_s = time.monotonic(), time.thread_time()
            # Deadlines that have passed are left out: ticks in a burst would not control better.
            missed = max(0, int((end_s - deadline_s) / self._period_s) + (end_s > deadline_s))
            deadline_s += missed * self._period_s
            with self._lock:
                self._snapshot = snapshot
                self._events += events
                timing = self._timing
                self._timing = LoopTiming(
                    timing.ticks + 1,
                    timing.missed + missed,
                    max(timing.worst_late_s, late_s),
                    timing.resting_s + rested_s,
                    timing.wall_s + end_s - counted_s,
                    timing.cpu_s + end_cpu_s - counted_cpu_s,
                )
            counted_s, counted_cpu_s = end_s, end_cpu_s
            if ending and not self._controller.moving:
                return
            if end_s >= look_s:
                look_s = end_s + LOOK_PERIOD_S - 0.5 * self._period_s
                self._look_for_work()
                self._work_off()
            time.sleep(max(0.0, deadline_s - time.monotonic()))
            rested_s = 0.0
            if snapshot.on_target and not self._controller.moving:
                rested_s = self._rest()
                deadline_s += rested_s

    def _work_off(self) -> None:
        """Do what there is to do, in the order in which it was told."""
        self._news.clear()
        while self._work:
            self._work.popleft()(self._controller, time.monotonic())

    def _rest(self) -> float:
        """Wait for something to do, or for the end of the rest; return how long it took [s]."""
        begin_s = time.monotonic()
        self._news.wait(REST_PERIOD_S - self._period_s)
        return time.monotonic() - begin_s
