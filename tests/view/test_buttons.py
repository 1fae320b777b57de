# SPDX-License-Identifier: Apache-2.0
"""Buttons can be pressed exactly when the sequencer's state machine has a place for them."""

import numpy as np
import pytest

from microhand_planner.core.errors import RunFailed
from microhand_station.sequencer.stage_watch import Mode
from microhand_station.sequencer.states import Event, State, next_state
from microhand_station.view.buttons import Buttons, allowed_buttons
from microhand_station.view.snapshot import Snapshot, Stage


def fits(state, event):
    """Return whether the state machine takes an event."""
    try:
        next_state(state, event)
    except RunFailed:
        return False
    return True


def stages(mode):
    """Return three stages, the second in a mode."""
    holding, other = (Stage(m, True, '', np.zeros(3), 0.0) for m in (Mode.HOLDING, mode))
    return holding, other, holding


@pytest.mark.parametrize('state', list(State))
def test_the_state_machine_takes_what_can_be_pressed_and_nothing_else(state):
    """All states: the buttons are those events that `next_state` does not refuse."""
    snapshot = Snapshot(state=state, stages=stages(Mode.FAULT))
    assert allowed_buttons(snapshot, has_plan=True, pausing=False) == Buttons(
        execute=fits(state, Event.START),
        pause=fits(state, Event.PAUSE),
        resume=fits(state, Event.RESUME),
        stop=fits(state, Event.STOP),
        emergency_stop=state is not State.EMERGENCY,
        reset=fits(state, Event.RESET),
    )


def test_nothing_is_executed_without_a_plan_and_nothing_reset_without_need():
    """In order and idle, only the emergency stop is left."""
    snapshot = Snapshot(state=State.IDLE, stages=stages(Mode.STREAMING))
    assert allowed_buttons(snapshot, has_plan=False, pausing=False) == Buttons()


def test_a_wish_to_pause_can_be_taken_back():
    """Until the end of the step the run goes on, and `resume` forgets the wish."""
    allowed = allowed_buttons(Snapshot(state=State.RUNNING), has_plan=False, pausing=True)
    assert (allowed.pause, allowed.resume, allowed.stop) == (False, True, True)


def test_without_a_sequencer_only_the_emergency_stop_is_left():
    """It reaches the stages without the sequencer."""
    assert allowed_buttons(Snapshot(), has_plan=True, pausing=False) == Buttons(
        emergency_stop=True
    )
