# SPDX-License-Identifier: Apache-2.0
"""The sequencer's state machine, compared with its drawing and with the message."""

import pytest
from microhand_msgs_py.msg import ErrorCode, SequencerState

from microhand_planner.core.errors import RunFailed
from microhand_station.sequencer import states
from microhand_station.sequencer.states import Event, State, next_state

ARROWS = """
IDLE START STARTING
STARTING BEGIN RUNNING
STARTING STOP IDLE
RUNNING DONE IDLE
RUNNING PAUSE PAUSED
PAUSED RESUME RUNNING
RUNNING STOP STOPPING
PAUSED STOP STOPPING
STOPPING DONE IDLE
EMERGENCY RESET IDLE
IDLE RESET IDLE
IDLE EMERGENCY EMERGENCY
STARTING EMERGENCY EMERGENCY
RUNNING EMERGENCY EMERGENCY
PAUSED EMERGENCY EMERGENCY
STOPPING EMERGENCY EMERGENCY
EMERGENCY EMERGENCY EMERGENCY
"""


def test_exactly_the_arrows_of_the_drawing_exist():
    """Every pair of state and event either is an arrow of the drawing, or is refused."""
    arrows = {tuple(line.split()[:2]): line.split()[2] for line in ARROWS.strip().splitlines()}
    for state in State:
        for event in Event:
            if (state.name, event.name) in arrows:
                assert next_state(state, event).name == arrows[state.name, event.name]
            else:
                with pytest.raises(RunFailed):
                    next_state(state, event)


@pytest.mark.parametrize(
    ('state', 'event', 'code'),
    [
        (State.RUNNING, Event.START, ErrorCode.BUSY),
        (State.PAUSED, Event.START, ErrorCode.BUSY),
        (State.EMERGENCY, Event.START, ErrorCode.EMERGENCY_STOP),
        (State.EMERGENCY, Event.RESUME, ErrorCode.EMERGENCY_STOP),
        (State.IDLE, Event.PAUSE, ErrorCode.NOT_ALLOWED),
    ],
)
def test_refusals_say_why_by_code(state, event, code):
    """Busy, latched and out of place are told apart."""
    with pytest.raises(RunFailed) as error:
        next_state(state, event)
    assert error.value.code == code


def test_states_and_codes_are_those_of_the_messages():
    """The pure part repeats constants of the interfaces; here they are kept in step."""
    for state in State:
        assert getattr(SequencerState, state.name) == state.value
    for name in ('BUSY', 'EMERGENCY_STOP', 'NOT_ALLOWED'):
        assert getattr(states, name) == getattr(ErrorCode, name)
