# SPDX-License-Identifier: Apache-2.0
"""The right panel of one browser: a request, and buttons for what may be done now."""

from __future__ import annotations

import math
import threading
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import viser
from viser import GuiButtonHandle

from microhand_planner.core.errors import MicrohandError
from microhand_planner.core.plan import Plan
from microhand_station.client_answers import ExecutionResult
from microhand_station.view import status_text
from microhand_station.view.buttons import Buttons, allowed_buttons
from microhand_station.view.part_store import PartStore
from microhand_station.view.request_fields import RequestFields
from microhand_station.view.request_form import Held, Request, check_start, to_request
from microhand_station.view.scene import PlannedWays
from microhand_station.view.snapshot import Snapshot
from microhand_station.view.station_commands import StationCommands

NOTICE_S = 12.0
"""How long a notice stays [s]."""
CANCELLED = 202
STOPPED = 'The run was stopped. The fingers stand, and hold what they held.'
NOTHING_YET = 'Ask for a plan; nothing moves before it is executed.'


@dataclass(frozen=True)
class Found:
    """A plan that waits to be executed."""

    plan: Plan
    request: Request


class Controls:
    """What one browser may ask for. Its plan is its own; the station is everybody's.

    Parameters
    ----------
    client : viser.ClientHandle
        The browser.
    commands : StationCommands
        The station.
    parts : PartStore
        Objects that can be asked for.
    names : sequence of str
        Those of the catalogue.
    look : callable
        Returns the station as it is now.
    do : callable
        Has the thread that sends messages change the page; it makes this object, too.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        commands: StationCommands,
        parts: PartStore,
        names: Sequence[str],
        look: Callable[[], Snapshot],
        do: Callable[[Callable[[], None]], None],
    ) -> None:
        self._client = client
        self._commands = commands
        self._parts = parts
        self._look = look
        self._do = do
        self._gone = threading.Event()
        self._found: Found | None = None
        self._buttons = Buttons()
        self._ways = PlannedWays(client.scene, '/found')
        gui = client.gui
        with gui.add_folder('Request'):
            self._fields = RequestFields(gui, names)
            self._plan = self._add('Plan', viser.Icon.ROUTE, self._make_plan)
        self._message = gui.add_html(status_text.quiet_text(NOTHING_YET))
        with gui.add_folder('Run'):
            self._execute = self._add(
                'Execute', viser.Icon.PLAYER_PLAY, self._execute_plan, 'green'
            )
            self._pause = self._add('Pause', viser.Icon.PLAYER_PAUSE, commands.pause)
            self._resume = self._add('Resume', viser.Icon.PLAYER_TRACK_NEXT, commands.resume)
            self._stop = self._add('Stop', viser.Icon.PLAYER_STOP, commands.stop, 'orange')
            self._reset = self._add('Reset', viser.Icon.REFRESH, commands.reset)
        self._emergency = self._add(
            'EMERGENCY STOP', viser.Icon.HAND_STOP, commands.emergency_stop, 'red'
        )
        self.refresh(look(), pausing=False)

    def refresh(self, snapshot: Snapshot, *, pausing: bool) -> None:
        """Enable the buttons that fit the present state."""
        if self._gone.is_set():
            return
        allowed = allowed_buttons(snapshot, has_plan=self._found is not None, pausing=pausing)
        for handle, enabled in (
            (self._execute, allowed.execute),
            (self._pause, allowed.pause),
            (self._resume, allowed.resume),
            (self._stop, allowed.stop),
            (self._reset, allowed.reset),
            (self._emergency, allowed.emergency_stop),
        ):
            handle.disabled = not enabled

    def leave(self) -> None:
        """Touch the page no more: the browser is gone. What it asked for goes on."""
        self._gone.set()

    def _add(
        self, label: str, icon: Any, action: Callable[[], None], color: Any = None
    ) -> GuiButtonHandle:
        """Add a button; whatever goes wrong in its action is told in words."""
        button = self._client.gui.add_button(label, icon=icon, color=color)

        def press(_: object) -> None:
            try:
                action()
            except MicrohandError as error:
                if error.code == CANCELLED:
                    self._say(status_text.quiet_text(STOPPED))
                else:
                    self._complain(label, str(error))
            except Exception as error:
                traceback.print_exc()
                self._complain(label, f'unforeseen {type(error).__name__}: {error}')

        button.on_click(press)
        return button

    def _make_plan(self) -> None:
        """Have the request planned, and show what comes of it."""
        self._forget_plan()
        self._say(status_text.quiet_text('planning …'))
        self._enable_plan(False)
        try:
            values = self._fields.values()
            sha256 = self._parts.load(values.object_name, values.unit_um).sha256
            snapshot = self._look()
            request = to_request(values, sha256, _held(snapshot))
            answer = self._commands.plan(request)
        finally:
            self._enable_plan(True)
        figure = self._parts.figure(sha256)
        start = None if request.start_tip_um is not None else request.start
        self._change(lambda: self._ways.show(answer.plan, figure, start))
        self._found = Found(answer.plan, request)
        self._say(
            status_text.plan_text(answer.plan, answer.planning_time_s, answer.goal_error_rad)
        )

    def _execute_plan(self) -> None:
        """Execute the plan that was found, and tell how it ended."""
        found = self._found
        if found is None:
            return
        self._forget_plan()
        check_start(found.request, _held(self._look()))
        self._say(status_text.quiet_text('executing; the left panel says how far it is'))
        result = self._commands.execute(found.plan, found.request)
        self._say(status_text.good_text(_told(result)))
        self._notify('Done', _told(result), 'green')

    def _forget_plan(self) -> None:
        """Take back the plan that waits."""
        self._found = None
        self._change(self._ways.clear)

    def _enable_plan(self, enabled: bool) -> None:
        def enable() -> None:
            self._plan.disabled = not enabled

        self._change(enable)

    def _complain(self, label: str, text: str) -> None:
        """Tell of a failure, twice: where one looks, and where it stays."""
        self._say(status_text.bad_text(f'{label.capitalize()}: {text}'))
        self._notify(f'{label.capitalize()} failed', text, 'red')

    def _say(self, html: str) -> None:
        def say() -> None:
            self._message.content = html

        self._change(say)

    def _notify(self, title: str, body: str, color: Any) -> None:
        def notify() -> None:
            self._client.add_notification(title, body, color=color, auto_close_seconds=NOTICE_S)

        self._change(notify)

    def _change(self, change: Callable[[], None]) -> None:
        """Change the page, if it is still there."""
        if not self._gone.is_set():
            self._do(change)


def _held(snapshot: Snapshot) -> Held | None:
    """Return the object that the fingers hold; None: they hold none that is known."""
    grasp_um = snapshot.grasp_um
    if grasp_um is None or snapshot.thing is None or snapshot.plan is None:
        return None
    return Held(snapshot.plan.object_sha256, snapshot.thing.pose, grasp_um)


def _told(result: ExecutionResult) -> str:
    """Return how an execution ended, for people."""
    text = f'Executed in {result.duration_s:.1f} s.'
    if result.held is not None and result.final_error_rad is not None:
        text += ' The object is held' if result.held else ' The object is lost'
        text += f', {math.degrees(result.final_error_rad):.2f}° off the goal.'
    return text if result.record_file is None else f'{text} Record: {result.record_file}'
