# SPDX-License-Identifier: Apache-2.0
"""The thread that owns the physics: follows the stages as closely as their reports come in."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from concurrent import futures
from typing import TypeVar

from microhand_planner.core.errors import MicrohandError, RunFailed
from microhand_planner.core.pose import FloatArray
from microhand_twin.ros.live_world import LiveWorld, ObjectReport
from microhand_twin.ros.tip_tracks import TipTracks

STAGE_MISSING = 300

LONGEST_STEP_S = 0.01
"""Between two setpoints of the fingers the ways are taken to be straight [s]."""
ANSWER_S = 5.0
"""Longest wait for the thread to do what it is asked [s]; usually one report of the stages."""
IDLE_S = 0.05

Result = TypeVar('Result')


class Follower:
    """Advances a `LiveWorld` to the time up to which all stages have reported.

    Parameters
    ----------
    on_advance : callable
        Called after each advance with the time [s] and the report of the object, None if there
        is none; in the thread of the physics.
    on_trouble : callable
        Called with a sentence when the thread ends by an error.
    """

    def __init__(
        self,
        on_advance: Callable[[float, ObjectReport | None], None],
        on_trouble: Callable[[str], None],
    ) -> None:
        self._on_advance = on_advance
        self._on_trouble = on_trouble
        self._changed = threading.Condition()
        self._tracks = TipTracks()
        self._orders: deque[Callable[[], None]] = deque()
        self._stopping = False
        self._now_s = -math.inf
        self._world: LiveWorld | None = None
        self._thread = threading.Thread(target=self._run, name='physics')

    def start(self) -> None:
        """Begin to follow."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread, and return when it is gone."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join()

    def hear(self, finger: int, time_s: float, tip_um: FloatArray) -> None:
        """Take in where a finger, from 1, was commanded to by its stage; from any thread."""
        with self._changed:
            self._tracks.add(finger - 1, time_s, tip_um)
            until_s = self._tracks.until_s
            if until_s is not None and until_s > self._now_s:
                self._changed.notify_all()

    def wait_until_heard(self, deadline_s: float) -> None:
        """Return when all stages have reported.

        Raises
        ------
        RunFailed
            STAGE_MISSING: names the fingers that have not within `deadline_s`.
        """
        with self._changed:
            self._changed.wait_for(lambda: not self._tracks.silent, deadline_s)
            silent = self._tracks.silent
        if silent:
            fingers = ', '.join(map(str, silent))
            raise RunFailed(f'finger {fingers}: nothing heard of its stage', STAGE_MISSING)

    def ask(self, action: Callable[[LiveWorld | None], Result]) -> Result:
        """Have `action` done with the present world, between two advances; return its result.

        Raises
        ------
        MicrohandError
            What the action raised, or the thread does not answer.
        """
        answer: futures.Future[Result] = futures.Future()

        def act() -> None:
            try:
                answer.set_result(action(self._world))
            except MicrohandError as error:
                answer.set_exception(error)

        self._order(act)
        try:
            return answer.result(timeout=ANSWER_S)
        except futures.TimeoutError:
            raise RunFailed(f'the physics did not answer within {ANSWER_S:g} s') from None

    def adopt(self, world: LiveWorld) -> None:
        """Go on with another world; return when it is so."""

        def take(_: LiveWorld | None) -> None:
            self._world = world

        self.ask(take)

    def _order(self, act: Callable[[], None]) -> None:
        with self._changed:
            self._orders.append(act)
            self._changed.notify_all()

    def _run(self) -> None:
        try:
            self._follow_until_stopped()
        except Exception as error:
            # the station learns of it by the silence that follows
            self._on_trouble(f'the physics ended: {type(error).__name__}: {error}')
            raise

    def _follow_until_stopped(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(self._has_work, IDLE_S)
                if self._stopping:
                    return
                way = self._way()
            if self._obey():
                way = way[-1:]
            for time_s, tips_um in way:
                self._advance(time_s, tips_um)
                if self._stopping or self._obey():
                    break

    def _obey(self) -> bool:
        """Do what was ordered; return whether the world is another one now.

        That one begins now: it need not catch up with what happened before.
        """
        before = self._world
        while self._orders:
            self._orders.popleft()()
        return self._world is not before

    def _has_work(self) -> bool:
        until_s = self._tracks.until_s
        news = until_s is not None and until_s > self._now_s
        return self._stopping or bool(self._orders) or news

    def _way(self) -> list[tuple[float, FloatArray]]:
        """Return where the tips were since the last advance, in short steps."""
        until_s = self._tracks.until_s
        if until_s is None or until_s <= self._now_s:
            return []
        count = 1
        if math.isfinite(self._now_s):
            count = max(1, math.ceil((until_s - self._now_s) / LONGEST_STEP_S - 1e-6))
        begin_s = self._now_s if count > 1 else until_s
        times_s = [
            until_s - (count - i) / count * (until_s - begin_s) for i in range(1, count + 1)
        ]
        way = [(time_s, self._tracks.at(time_s)) for time_s in times_s]
        self._now_s = until_s
        self._tracks.forget_before(until_s)
        return way

    def _advance(self, time_s: float, tips_um: FloatArray) -> None:
        """Advance, and tell."""
        if self._world is not None:
            self._world.follow(tips_um, time_s)
        report = None if self._world is None else self._world.report
        self._on_advance(time_s, report)
