# SPDX-License-Identifier: Apache-2.0
"""The page: one scene and one state of the station for all browsers, and controls for each."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import viser

from microhand_station.view import status_text
from microhand_station.view.controls import Controls
from microhand_station.view.page_server import PageServer
from microhand_station.view.part_store import PartStore
from microhand_station.view.scene import CAMERA_UM, Figures, StationScene
from microhand_station.view.snapshot import Snapshot
from microhand_station.view.station_commands import StationCommands

BRAND: tuple[int, int, int] = (25, 113, 194)
PANEL_PIXELS = 330
TEXT_PERIOD_S = 0.2
"""Words change no faster than they can be read [s]."""


class Page:
    """Shows what is known of the station to whoever looks.

    Parameters
    ----------
    server : PageServer
        Serves the page.
    commands : StationCommands
        What it may ask for.
    parts : PartStore
        Objects that can be asked for.
    figure : callable
        Returns how a part is drawn, by its hash.
    look : callable
        Returns the station as it is now.
    """

    def __init__(
        self,
        server: PageServer,
        commands: StationCommands,
        parts: PartStore,
        figure: Figures,
        look: Callable[[], Snapshot],
    ) -> None:
        self._server = server
        self._commands = commands
        self._parts = parts
        self._look = look
        self._lock = threading.Lock()
        self._browsers: dict[int, Controls] = {}
        self._texts_s = -math.inf
        server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=BRAND, control_width='medium'
        )
        server.initial_camera.position = CAMERA_UM
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        self._scene = StationScene(server.scene, figure)
        panel = server.gui.add_panel()
        with panel.add_tab('Station', viser.Icon.ACTIVITY):
            self._cards = [server.gui.add_html('') for _ in range(4)]
        panel.dock_left()
        panel.set_width(PANEL_PIXELS)
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(PANEL_PIXELS)
        server.on_client_connect(self._welcome)

    def is_watched(self) -> bool:
        """Forget the browsers that have left, and return whether any is there."""
        here = self._server.get_clients()
        with self._lock:
            for number in self._browsers.keys() - here.keys():
                self._browsers.pop(number).leave()
        return bool(here)

    def show(self, snapshot: Snapshot, now_s: float) -> None:
        """Show the station as it is now."""
        self._server.do(lambda: self._show(snapshot, now_s))

    def _show(self, snapshot: Snapshot, now_s: float) -> None:
        pausing = self._commands.is_pausing(snapshot)
        with self._server.atomic():
            self._scene.show(snapshot)
        with self._lock:
            browsers = list(self._browsers.values())
        for controls in browsers:
            controls.refresh(snapshot, pausing=pausing)
        if now_s - self._texts_s >= TEXT_PERIOD_S:
            self._texts_s = now_s
            texts = (
                status_text.sequencer_card(snapshot, pausing),
                status_text.object_card(snapshot),
                status_text.fingers_card(snapshot),
                status_text.notes_card(snapshot.notes),
            )
            for card, text in zip(self._cards, texts, strict=True):
                card.content = text

    def close(self) -> None:
        """Let all browsers go."""
        with self._lock:
            for controls in self._browsers.values():
                controls.leave()
            self._browsers.clear()
        self._server.stop()

    def _welcome(self, client: viser.ClientHandle) -> None:
        """Give a browser its controls."""
        names = self._parts.names()

        def build() -> None:
            controls = Controls(
                client, self._commands, self._parts, names, self._look, self._server.do
            )
            with self._lock:
                self._browsers[client.client_id] = controls

        self._server.do(build)
