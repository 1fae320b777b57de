# SPDX-License-Identifier: Apache-2.0
"""The options that say which station to run, shared by `station` and `demo`."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import click

from microhand_station.config import StationConfig, read_config


@dataclass(frozen=True)
class StationChoice:
    """Which station to run, and where.

    Parameters
    ----------
    config : StationConfig
        What it consists of.
    folder : Path
        For its logs and records; new for each start.
    domain_id : int or None
        ROS domain; None: that of the environment.
    """

    config: StationConfig
    folder: Path
    domain_id: int | None


_OPTIONS = (
    click.option(
        '--config',
        type=click.Path(path_type=Path),
        metavar='FILE',
        help='Station file (YAML); default: three 200 µm stages around the origin.',
    ),
    click.option(
        '--namespace',
        metavar='NAME',
        help='Put all names of nodes and topics below NAME, for stations side by side.',
    ),
    click.option(
        '--domain-id',
        type=click.IntRange(0, 101),
        metavar='N',
        help='ROS domain, for stations that shall not see each other; default: ROS_DOMAIN_ID.',
    ),
    click.option(
        '--run-dir',
        type=click.Path(path_type=Path),
        default=Path('runs'),
        show_default=True,
        help='Folder for records, reports and logs.',
    ),
    click.option(
        '--speed', type=float, metavar='FACTOR', help='Move so many times as fast as configured.'
    ),
)


def station_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options to a command; `station_choice` reads their values."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def station_choice(
    kind: str,
    *,
    config: Path | None,
    namespace: str | None,
    domain_id: int | None,
    run_dir: Path,
    speed: float | None,
) -> StationChoice:
    """Return the station that the options describe.

    Parameters
    ----------
    kind : str
        Begins the name of the folder.
    config, namespace, domain_id, run_dir, speed
        Values of the options.

    Raises
    ------
    BadRequest
        Names the option or the key of the station file that is wrong.
    """
    chosen = read_config(config) if config is not None else StationConfig()
    if namespace is not None:
        chosen = dataclasses.replace(chosen, namespace=namespace)
    if speed is not None:
        motion = dataclasses.replace(chosen.motion, speed=chosen.motion.speed * speed)
        chosen = dataclasses.replace(chosen, motion=motion)
    now = datetime.now(timezone.utc)
    name = f'{kind}_{now:%Y%m%dT%H%M%SZ}_{os.getpid()}'
    return StationChoice(chosen, (run_dir / name).absolute(), domain_id)
