# SPDX-License-Identifier: Apache-2.0
"""Which buttons may be pressed when."""

from __future__ import annotations

from dataclasses import dataclass

from microhand_station.sequencer.stage_watch import Mode
from microhand_station.sequencer.states import State
from microhand_station.view.snapshot import Snapshot


@dataclass(frozen=True)
class Buttons:
    """True: the button may be pressed."""

    execute: bool = False
    pause: bool = False
    resume: bool = False
    stop: bool = False
    emergency_stop: bool = True
    reset: bool = False


def allowed_buttons(snapshot: Snapshot, *, has_plan: bool, pausing: bool) -> Buttons:
    """Return what the sequencer would not refuse.

    Parameters
    ----------
    snapshot : Snapshot
        The station now.
    has_plan : bool
        A plan waits to be executed.
    pausing : bool
        The run has been asked to pause, and goes on to the end of its step.
    """
    state = snapshot.state
    running = state is State.RUNNING
    stuck = any(
        stage is not None and stage.mode in (Mode.STOPPED, Mode.FAULT) for stage in snapshot.stages
    )
    return Buttons(
        execute=state is State.IDLE and has_plan,
        pause=running and not pausing,
        resume=state is State.PAUSED or (running and pausing),
        stop=state in (State.STARTING, State.RUNNING, State.PAUSED),
        emergency_stop=state is not State.EMERGENCY,
        reset=state is State.EMERGENCY or (state is State.IDLE and stuck),
    )
