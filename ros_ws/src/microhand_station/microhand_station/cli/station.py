# SPDX-License-Identifier: Apache-2.0
"""`microhand station`: run a simulated station until it is interrupted."""

from __future__ import annotations

import sys
import time
from typing import Any

import click

from microhand_station.bringup.signals import interruptible
from microhand_station.bringup.station import RunningStation
from microhand_station.cli.station_options import station_choice, station_options
from microhand_station.view.address import (
    DEFAULT_HOST,
    DEFAULT_PORT,
    TOKEN_RULE,
    TOKEN_VARIABLE,
    ViewAddress,
)

LOOK_S = 0.2


@click.command(short_help='Run a simulated station that waits for requests.')
@station_options
@click.option('--view', is_flag=True, help='Show the station on a page in the browser.')
@click.option(
    '--view-port',
    type=int,
    metavar='PORT',
    help=f'Of the page; 0: any that is free.  [default: {DEFAULT_PORT}]',
)
@click.option(
    '--view-host',
    metavar='HOST',
    help='Address of this machine that the page listens at; any but the default needs a token  '
    f'[{DEFAULT_HOST}].',
)
@click.option(
    '--view-token',
    envvar=TOKEN_VARIABLE,
    metavar='TOKEN',
    help=f'Secret to open the page with: {TOKEN_RULE}; also by {TOKEN_VARIABLE}.',
)
@click.option(
    '--restart/--no-restart',
    'restarts',
    default=True,
    show_default=True,
    help='Start processes again that died.',
)
def station(
    view: bool,
    view_port: int | None,
    view_host: str | None,
    view_token: str | None,
    restarts: bool,
    **options: Any,
) -> None:
    """Run a simulated station: planner, sequencer, recorder, three stage drivers and a twin.

    Each is a process of its own, with its log in the folder of the run. `station ready` says that
    requests are answered: from the page (--view), from other ROS nodes, or from Python by
    microhand_station.client. A process that dies is started again, up to three times a minute;
    stages that stopped wait for a reset. Ctrl-C ends all.

    \b
    Examples:
      microhand station
      microhand station --view                # and a page that shows it, and asks it for runs
      microhand station --config ours.yaml    # other stages, fingers, contact speed, friction
      microhand station --namespace left      # beside another one, by names
      microhand station --domain-id 7         # beside another one, by domain
    and then, where ROS 2 is installed:
      ros2 service call /planner/list_objects microhand_msgs_py/srv/ListObjects
    """
    choice = station_choice('station', **options)
    address = None
    if view or view_port is not None or view_host is not None:
        address = ViewAddress(
            DEFAULT_HOST if view_host is None else view_host,
            DEFAULT_PORT if view_port is None else view_port,
            view_token or '',
        )
    station = RunningStation(
        choice.config, choice.folder, choice.domain_id, _say, address, restarts
    )
    try:
        with interruptible(), station:
            root = f'/{choice.config.namespace.strip("/")}'.rstrip('/')
            _say(f'logs and records: {choice.folder}')
            _say(f'station ready: {root}/planner/plan_rotation, {root}/sequencer/reorient')
            if address is not None:
                hint = ' (add ?token=... the first time)' if address.token else ''
                _say(f'view: {station.view_url}{hint}')
            while True:
                station.look()
                time.sleep(LOOK_S)
    except KeyboardInterrupt:
        for trouble in station.troubles:
            _say(trouble)
        sys.exit(1 if station.troubles else 0)


def _say(text: str) -> None:
    """Print a line at once: programs may be listening."""
    click.echo(text)
    sys.stdout.flush()
