# SPDX-License-Identifier: Apache-2.0
"""A whole station: its nodes as processes, configured, active, watched, and ended."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from urllib.parse import urlsplit

from microhand_planner.core.errors import BadRequest, RunFailed
from microhand_planner.core.plan import FINGERS
from microhand_station.bringup.lifecycle import activate
from microhand_station.bringup.name_lock import names_taken
from microhand_station.bringup.node_commands import (
    VIEW_ADDRESS_FILE,
    NodeCommand,
    node_commands,
    view_command,
)
from microhand_station.bringup.processes import NodeProcess, end_processes
from microhand_station.bringup.restart_budget import RestartBudget
from microhand_station.bringup.signals import undisturbed
from microhand_station.client import StationClient
from microhand_station.config import StationConfig, write_config
from microhand_station.sequencer.stage_watch import STAGE_MISSING
from microhand_station.service_call import POLL_S, greet
from microhand_station.view.address import TOKEN_VARIABLE, ViewAddress

START_S = 30.0
"""Longest time for the nodes to be there [s]: Python, numba and discovery on a busy machine."""


class RunningStation:
    """The processes of a station, for as long as the context lasts.

    Parameters
    ----------
    config : StationConfig
        What to start.
    folder : Path
        Made here; gets the station file, the logs and the records.
    domain_id : int or None
        ROS domain; None: that of the environment.
    on_news : callable
        Told what happens, one sentence at a time.
    view : ViewAddress, optional
        Where to show the station in a browser; by default nowhere.
    restarts : bool
        Processes that die are started again by `look`.
    """

    def __init__(
        self,
        config: StationConfig,
        folder: Path,
        domain_id: int | None,
        on_news: Callable[[str], None],
        view: ViewAddress | None = None,
        restarts: bool = False,
    ) -> None:
        self._config = config
        self._folder = folder
        self._address_file = folder / VIEW_ADDRESS_FILE
        self._on_news = on_news
        self._environment = {
            'ROS_LOG_DIR': os.environ.get('ROS_LOG_DIR', str(folder / 'ros_log')),
            **({} if domain_id is None else {'ROS_DOMAIN_ID': str(domain_id)}),
        }
        self._domain_id = domain_id
        self._view = view
        self.view_url = ''
        """Where the page of the station is; empty: there is none."""
        self._processes: list[NodeProcess] = []
        self._mourned: set[int] = set()
        self._budget = RestartBudget() if restarts else None
        self._names = contextlib.ExitStack()
        self.troubles: list[str] = []
        """What did not go well at the end; complete when the context has ended."""

    def __enter__(self) -> RunningStation:
        """Start everything, and return when every node answers and the stages hold."""
        try:
            self._names.enter_context(names_taken(self._config.namespace, self._domain_id))
            self._start()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End every process."""
        self._end()

    def look(self) -> None:
        """Tell of processes that have ended since the last look; the others stay up.

        With restarts they are started again, stage drivers activated; stages hold where they are.
        """
        for place, process in enumerate(self._processes):
            if process.exit_status is None or process.pid in self._mourned:
                continue
            self._mourned.add(process.pid)
            self._on_news(
                f'{process.name} ended with status {process.exit_status}: '
                f'{process.last_words()} (log: {process.log})'
            )
            if self._budget is None:
                continue
            if self._budget.spend(process.name, time.monotonic()):
                if process.name == 'view':
                    self._address_file.unlink(missing_ok=True)
                self._processes[place] = process.again()
                self._wait_for_again(self._processes[place])
            else:
                self._on_news(f'{process.name} died too often and is not started again')

    def _wait_for_again(self, process: NodeProcess) -> None:
        """Return when the node of a process that was started again works, or when it cannot."""
        try:
            with StationClient(self._config.namespace, self._domain_id) as client:
                if process.name == 'view':
                    self._wait_until(self._address_file.exists, 'view')
                elif process.name.startswith('finger_'):
                    self._activate(client, process.name)
                else:
                    greet(
                        client.node,
                        process.name,
                        deadline_s=START_S,
                        who=process.name,
                        missing_code=STAGE_MISSING,
                    )
        except RunFailed as error:
            self._on_news(f'{process.name} was started again, but does not work: {error}')
        else:
            self._on_news(f'{process.name} runs again; stages that stopped wait for a reset')

    def _start(self) -> None:
        """Start the processes and bring them to work."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_config(self._config, self._folder / 'station.yaml')
        except OSError as error:
            raise BadRequest(
                'run-dir', f'{self._folder} ({error.strerror})', 'a folder that can be written'
            ) from error
        with StationClient(self._config.namespace, self._domain_id) as client:
            for node in node_commands(self._config, self._folder):
                self._launch(node)
            for finger in range(1, FINGERS + 1):
                name = f'finger_{finger}'
                self._wait_for(client, f'{name}/stage_driver')
                self._activate(client, name)
            twin = ('twin',) if self._config.twin.enabled else ()
            for name in ('planner', *twin, 'sequencer', 'recorder'):
                self._wait_for(client, name)
            client.wait_until_ready(START_S)
        if self._view is not None:
            self._open_view(self._view)

    def _activate(self, client: StationClient, name: str) -> None:
        """Bring the stage driver of a finger to work."""
        activate(
            client.node,
            f'{name}/stage_driver',
            who=f'the stage driver of {name.replace("_", " ")}',
            deadline_s=START_S,
        )

    def _launch(self, node: NodeCommand, **environment: str) -> None:
        """Start a process."""
        self._processes.append(
            NodeProcess(
                node.name,
                node.module,
                node.arguments,
                self._folder / f'{node.name}.log',
                {**self._environment, **environment},
            )
        )

    def _open_view(self, address: ViewAddress) -> None:
        """Start the view, and learn where its page is."""
        command = view_command(self._config, self._folder, address)
        self._launch(command, **{TOKEN_VARIABLE: address.token})
        self._wait_until(self._address_file.exists, 'view')
        self.view_url = self._address_file.read_text(encoding='utf-8')
        # a view that is started again is to be where its page was
        port = urlsplit(self.view_url).port or address.port
        view_command(self._config, self._folder, replace(address, port=port))

    def _wait_for(self, client: StationClient, name: str) -> None:
        """Return when a node is there."""
        self._wait_until(lambda: client.count_nodes(name) > 0, name)

    def _wait_until(self, is_there: Callable[[], bool], name: str) -> None:
        """Return when something is there; raise if it does not come, or if a process ended."""
        give_up_s = time.monotonic() + START_S
        while not is_there():
            for process in self._processes:
                if process.exit_status is not None and process.pid not in self._mourned:
                    raise RunFailed(
                        f'{process.name} did not start: {process.last_words()} '
                        f'(log: {process.log})'
                    )
            if time.monotonic() > give_up_s:
                raise RunFailed(f'{name} is not there after {START_S:g} s')
            time.sleep(POLL_S)

    def _end(self) -> None:
        """End every process: first the one that moves the stages, then the others."""
        with undisturbed():
            first = [process for process in self._processes if process.name == 'sequencer']
            self.troubles += end_processes(first)
            self.troubles += end_processes(self._processes)
            self._names.close()
