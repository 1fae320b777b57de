# SPDX-License-Identifier: Apache-2.0
"""What the sequencer may do when: its states, and the events that lead from one to another."""

from __future__ import annotations

from enum import Enum, IntEnum, auto

from microhand_planner.core.errors import RunFailed

BUSY = 302
EMERGENCY_STOP = 305
NOT_ALLOWED = 308


class State(IntEnum):
    """States of the sequencer; the values are those of ``microhand_msgs_py/msg/SequencerState``.

    ::

                start             begin             pause
        IDLE ──────────▶ STARTING ──────▶ RUNNING ◀───────▶ PAUSED
         ▲                  │              │   │     resume   │
         │       stop       │     done     │   │ stop         │ stop
         ├◀─────────────────┘◀─────────────┘   ▼              ▼
         │                                  STOPPING ◀────────┘
         ├◀──── done ──────────────────────────┘
         │
         └◀──── reset ──── EMERGENCY ◀──── emergency, from every state

    ``stop`` is a cancel of the caller or a fault; ``done`` means that the stages stand.
    ``reset`` is also allowed in IDLE: it clears faults of the stages.
    """

    IDLE = 0
    STARTING = 1
    """Checks the plan, the stages and the recorder; nothing moves yet."""
    RUNNING = 2
    PAUSED = 3
    """Stands at the end of a step."""
    STOPPING = 4
    """Ramps down to a hold."""
    EMERGENCY = 5
    """Latched until reset."""


class Event(Enum):
    """What can happen to the sequencer."""

    START = auto()
    BEGIN = auto()
    PAUSE = auto()
    RESUME = auto()
    STOP = auto()
    DONE = auto()
    EMERGENCY = auto()
    RESET = auto()


TRANSITIONS = {
    (State.IDLE, Event.START): State.STARTING,
    (State.STARTING, Event.BEGIN): State.RUNNING,
    (State.STARTING, Event.STOP): State.IDLE,
    (State.RUNNING, Event.PAUSE): State.PAUSED,
    (State.PAUSED, Event.RESUME): State.RUNNING,
    (State.RUNNING, Event.STOP): State.STOPPING,
    (State.PAUSED, Event.STOP): State.STOPPING,
    (State.RUNNING, Event.DONE): State.IDLE,
    (State.STOPPING, Event.DONE): State.IDLE,
    (State.EMERGENCY, Event.RESET): State.IDLE,
    (State.IDLE, Event.RESET): State.IDLE,
    **{(state, Event.EMERGENCY): State.EMERGENCY for state in State},
}


def next_state(state: State, event: Event) -> State:
    """Return the state after an event.

    Raises
    ------
    RunFailed
        The event does not fit the state: code BUSY if a run is under way already,
        EMERGENCY_STOP if the emergency stop is latched, else NOT_ALLOWED.

    Examples
    --------
    >>> next_state(State.RUNNING, Event.PAUSE).name
    'PAUSED'
    """
    if (state, event) in TRANSITIONS:
        return TRANSITIONS[state, event]
    if state is State.EMERGENCY:
        raise RunFailed('the emergency stop is latched; reset it first', EMERGENCY_STOP)
    if event is Event.START:
        raise RunFailed(f'another plan is being executed ({state.name.lower()})', BUSY)
    raise RunFailed(
        f'{event.name.lower()} does not fit the state {state.name.lower()}', NOT_ALLOWED
    )
