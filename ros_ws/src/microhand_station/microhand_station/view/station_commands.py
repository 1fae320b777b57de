# SPDX-License-Identifier: Apache-2.0
"""What the page may ask of the station."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from action_msgs.srv import CancelGoal
from microhand_msgs_py.srv import Command
from rclpy.client import Client
from rclpy.task import Future

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.parameters import SearchOptions
from microhand_planner.core.plan import FINGERS, Plan
from microhand_station.client import StationClient
from microhand_station.client_answers import ExecutionResult, PlanAnswer
from microhand_station.sequencer.states import NOT_ALLOWED, State
from microhand_station.service_call import POLL_S, call
from microhand_station.view.request_form import Request
from microhand_station.view.snapshot import Snapshot

STAGE_MISSING = 300
SEARCH_LIMIT_S = 60.0
"""The planner gives up after this: nobody in front of a page waits for longer [s]."""
CANCEL_S = 5.0
"""Longest wait for the sequencer to say that a run is being stopped [s]."""
EMERGENCY_S = 1.0
"""A sequencer that does not stop the stages within this is passed over [s]."""
ACTIONS = ('execute_plan', 'reorient')


class StationCommands:
    """Asks planner, sequencer and, in an emergency, the stage drivers; from any thread.

    Parameters
    ----------
    client : StationClient
        The connection to the station.
    """

    def __init__(self, client: StationClient) -> None:
        self._client = client
        self._pausing = threading.Event()
        node = client.node
        self._cancels = [
            node.create_client(CancelGoal, f'sequencer/{action}/_action/cancel_goal')
            for action in ACTIONS
        ]
        self._emergency = node.create_client(Command, 'sequencer/emergency_stop')
        self._stops = [
            node.create_client(Command, f'finger_{finger}/stage_driver/stop')
            for finger in range(1, FINGERS + 1)
        ]

    def is_pausing(self, snapshot: Snapshot) -> bool:
        """Return whether the run was asked to pause, and goes on to the end of its step."""
        if snapshot.state is not State.RUNNING:
            self._pausing.clear()
        return self._pausing.is_set()

    def plan(self, request: Request) -> PlanAnswer:
        """Have a reorientation planned.

        Raises
        ------
        MicrohandError
            With the planner's sentence.
        """
        return self._client.plan(
            findable(request.object_name),
            request.start,
            request.goal,
            unit_um=request.unit_um,
            options=SearchOptions(time_limit_s=SEARCH_LIMIT_S),
            start_tip_um=request.start_tip_um,
            words=request.words,
        )

    def execute(self, plan: Plan, request: Request) -> ExecutionResult:
        """Execute a plan, and wait until it is done.

        Raises
        ------
        MicrohandError
            With the sequencer's sentence.
        """
        return self._client.execute(
            plan, object_name=findable(request.object_name), unit_um=request.unit_um
        )

    def pause(self) -> None:
        """Let the run pause at the end of its step."""
        self._client.command('pause')
        self._pausing.set()

    def resume(self) -> None:
        """Let a run go on that pauses, or was asked to."""
        self._client.command('resume')
        self._pausing.clear()

    def reset(self) -> None:
        """Unlatch the emergency stop, and clear stops and faults of the stages."""
        self._client.command('reset')

    def stop(self) -> None:
        """Let the run that is under way end on a ramp, whoever started it.

        Raises
        ------
        RunFailed
            There is none.
        """
        everything = CancelGoal.Request()  # no id and no time: all goals
        answers = [
            call(
                cancel,
                everything,
                deadline_s=CANCEL_S,
                who='the sequencer',
                missing_code=STAGE_MISSING,
            )
            for cancel in self._cancels
        ]
        if not any(answer.goals_canceling for answer in answers):
            raise RunFailed('no run is under way', NOT_ALLOWED)

    def emergency_stop(self) -> None:
        """Stop all stages at once: by the sequencer, and without it if it does not answer.

        Raises
        ------
        RunFailed
            Says what did not stop, or that the sequencer was passed over.
        """
        try:
            if self._client.has_died('sequencer') or not self._emergency.service_is_ready():
                raise RunFailed('the sequencer is not there', STAGE_MISSING)
            answer = call(
                self._emergency,
                Command.Request(),
                deadline_s=EMERGENCY_S,
                who='the sequencer',
                missing_code=STAGE_MISSING,
            )
        except RunFailed as error:
            self._stop_stages()
            raise RunFailed(
                f'{error}: the stages were stopped without it', STAGE_MISSING
            ) from error
        if answer.error_code:
            raise RunFailed(answer.error_msg, answer.error_code)

    def _stop_stages(self) -> None:
        """Send the stop to all stages, then wait for their answers."""
        asked = [_ask_to_stop(stop) for stop in self._stops]
        give_up_s = time.monotonic() + EMERGENCY_S
        while any(future is not None and not future.done() for future in asked):
            if time.monotonic() > give_up_s:
                break
            time.sleep(POLL_S)
        silent = [
            str(finger)
            for finger, future in enumerate(asked, start=1)
            if future is None or not future.done() or future.result().error_code
        ]
        if silent:
            raise RunFailed(
                f'the sequencer does not answer, and finger {", ".join(silent)} did not confirm '
                'that it stops',
                STAGE_MISSING,
            )


def _ask_to_stop(stop: Client) -> Future | None:
    """Send the stop without waiting; None: nobody is there to receive it."""
    return stop.call_async(Command.Request()) if stop.service_is_ready() else None


def findable(object_name: str) -> str:
    """Return the name of an object as another process finds it: paths from the root."""
    path = Path(object_name)
    return str(path.absolute()) if path.is_file() else object_name
