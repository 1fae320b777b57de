# SPDX-License-Identifier: Apache-2.0
"""The process `view`: listens to the station, and serves its page.

One thread spins ROS (that of `StationClient`), viser's answer the browsers, and the main thread
shows what is known, some twenty times a second, while anybody looks.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node

from microhand_node.run_node import stop_at_signals
from microhand_planner.core.errors import MicrohandError
from microhand_station.client import StationClient
from microhand_station.config import StationConfig, read_config
from microhand_station.view.address import DEFAULT_HOST, DEFAULT_PORT, TOKEN_VARIABLE, ViewAddress
from microhand_station.view.figures import Figure
from microhand_station.view.listener import Listener
from microhand_station.view.page import Page
from microhand_station.view.page_server import open_page_server
from microhand_station.view.part_store import PartStore
from microhand_station.view.station_commands import StationCommands
from microhand_station.view.twin_mesh import TwinMesh

FRAME_S = 0.04
"""Between two pictures [s]."""
PACE_S = 0.005
"""Rest of the thread that listens, after each message [s]: states come faster than pictures."""
UNWATCHED_S = 0.2
"""How often it is checked whether somebody looks [s]."""
PARAMETERS: tuple[tuple[str, str | int, str], ...] = (
    ('config', '', 'path of the station file; empty: the defaults'),
    ('host', DEFAULT_HOST, 'of this machine, to listen at; others than 127.0.0.1 need a token'),
    ('port', DEFAULT_PORT, 'to listen at; 0: any that is free'),
    ('address_file', '', 'gets the address of the page as soon as it can be opened; empty: none'),
)


def main(args: Sequence[str] | None = None) -> int:
    """Serve the page until SIGINT or SIGTERM; 2 if the address is refused."""
    stopping = stop_at_signals()
    try:
        with StationClient(
            name='view', arguments=sys.argv if args is None else args, pace_s=PACE_S
        ) as client:
            _serve(client, stopping)
    except ParameterException as error:
        sys.stderr.write(f'{error}\n')
        return 2
    except MicrohandError as error:
        sys.stderr.write(f'{error}\n')
        return error.exit_status
    return 0


def _serve(client: StationClient, stopping: threading.Event) -> None:
    """Show the station until it is time to stop."""
    values = _read_parameters(client.node)
    path = str(values['config'])
    config = read_config(Path(path)) if path else StationConfig()
    address = ViewAddress(
        str(values['host']), int(values['port']), os.environ.get(TOKEN_VARIABLE, '')
    )
    listener = Listener(client.node, config)
    parts, in_twin = PartStore(client.node), TwinMesh(client.node)

    def figure(sha256: str) -> Figure | None:
        return parts.figure(sha256) or in_twin.figure()

    name = client.node.get_namespace().strip('/')
    server = open_page_server(address, f'microhand {name}'.strip())
    page = Page(server, StationCommands(client), parts, figure, listener.snapshot)
    try:
        _tell_address(str(values['address_file']), address.url(server.get_port()))
        while not stopping.is_set():
            began_s = time.monotonic()
            watched = page.is_watched()
            if watched:
                page.show(listener.snapshot(), began_s)
            period_s = FRAME_S if watched else UNWATCHED_S
            stopping.wait(max(0.0, began_s + period_s - time.monotonic()))
    finally:
        page.close()


def _read_parameters(node: Node) -> dict[str, str | int]:
    """Declare the parameters and return their values."""
    for name, default, description in PARAMETERS:
        node.declare_parameter(name, default, ParameterDescriptor(description=description))
    return {name: node.get_parameter(name).value for name, _, _ in PARAMETERS}


def _tell_address(file: str, url: str) -> None:
    """Say where the page is, to people and to the process that started this one."""
    sys.stdout.write(f'view: {url}\n')
    sys.stdout.flush()
    if file:
        partial = Path(f'{file}.partial')
        partial.write_text(url, encoding='utf-8')
        partial.replace(file)  # whoever waits for it finds all of it


if __name__ == '__main__':
    sys.exit(main())
