# SPDX-License-Identifier: Apache-2.0
"""State and orders of the sequencer, shared by the thread that spins and the one that executes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from microhand_planner.core.errors import RunFailed
from microhand_station.sequencer.states import EMERGENCY_STOP, Event, State, next_state

CANCELLED = 202


class RunControl:
    """The present state, and what the caller wants of the run that is under way.

    Every method may be called from any thread.

    Parameters
    ----------
    on_change : callable
        Called with each new state, in the thread that caused it.
    """

    def __init__(self, on_change: Callable[[State], None]) -> None:
        self._on_change = on_change
        self._changed = threading.Condition(threading.RLock())
        self._state = State.IDLE
        self._cancel = False
        self._pause = False

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    @property
    def pause_wanted(self) -> bool:
        """Whether the caller wants the run to pause."""
        return self._pause

    @property
    def emergency(self) -> bool:
        """Whether the emergency stop is latched."""
        return self._state is State.EMERGENCY

    def fire(self, event: Event) -> State:
        """Go to the next state.

        Raises
        ------
        RunFailed
            The event does not fit the present state.
        """
        with self._changed:
            self._state = next_state(self._state, event)
            if event is Event.START:
                self._cancel = self._pause = False
            self._on_change(self._state)
            self._changed.notify_all()
            return self._state

    def finish(self) -> None:
        """Be idle again after a run, wherever it ended; an emergency stop stays latched."""
        with self._changed:
            if self._state in (State.STARTING, State.RUNNING, State.PAUSED):
                self.fire(Event.DONE if self._state is State.RUNNING else Event.STOP)
            if self._state is State.STOPPING:
                self.fire(Event.DONE)

    def cancel(self) -> None:
        """Ask the run to end."""
        with self._changed:
            self._cancel = True
            self._changed.notify_all()

    def pause(self) -> None:
        """Ask the run to pause at the end of the step.

        Raises
        ------
        RunFailed
            NOT_ALLOWED: there is no run to pause.
        """
        with self._changed:
            next_state(self._state, Event.PAUSE)
            self._pause = True
            self._changed.notify_all()

    def resume(self) -> None:
        """Let a paused run go on, or take back the wish to pause.

        Raises
        ------
        RunFailed
            NOT_ALLOWED: nothing is paused.
        """
        with self._changed:
            if not (self._state is State.RUNNING and self._pause):
                next_state(self._state, Event.RESUME)
            self._pause = False
            self._changed.notify_all()

    def check_orders(self) -> None:
        """Return if the run may go on.

        Raises
        ------
        RunFailed
            EMERGENCY_STOP or CANCELLED.
        """
        if self.emergency:
            raise RunFailed('the emergency stop was pressed', EMERGENCY_STOP)
        if self._cancel:
            raise RunFailed('the caller cancelled the run', CANCELLED)

    def wait(self, until_s: float) -> None:
        """Return at `until_s` of the monotonic clock, or earlier on an order or a new state."""
        with self._changed:
            self._changed.wait(max(0.0, until_s - time.monotonic()))
