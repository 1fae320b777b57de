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

LOOK_S = 0.2


@click.command()
@station_options
def station(**options: Any) -> None:
    r"""Run a simulated station: planner, sequencer, recorder and three stage drivers.

    Each is a process of its own, with its log in the folder of the run. Ctrl-C ends them all.

    \b
    Examples:
      microhand station
      microhand station --namespace left      # beside another one, by names
      microhand station --domain-id 7         # beside another one, by domain
    and then, in another terminal:
      ros2 service call /planner/list_objects microhand_msgs_py/srv/ListObjects
    """
    choice = station_choice('station', **options)
    station = RunningStation(choice.config, choice.folder, choice.domain_id, _say)
    try:
        with interruptible(), station:
            root = f'/{choice.config.namespace.strip("/")}'.rstrip('/')
            _say(f'logs and records: {choice.folder}')
            _say(f'station ready: {root}/planner/plan_rotation, {root}/sequencer/reorient')
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
