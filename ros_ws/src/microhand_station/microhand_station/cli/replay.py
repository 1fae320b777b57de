# SPDX-License-Identifier: Apache-2.0
"""`microhand replay`: a record onto ROS topics again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from microhand_station.analysis.record_index import record_index
from microhand_station.bringup.signals import interruptible
from microhand_station.cli.answer import answer, json_option, news_console
from microhand_station.cli.reading import reading
from microhand_station.replay.player import Player, Wishes

KEYS = ('messages', 'rounds', 'topics', 'left_out')


@click.command(short_help='Publish the messages of a record again.')
@click.argument('record', type=click.Path(path_type=Path), metavar='RUN.mcap')
@click.option('--rate', type=float, default=1.0, show_default=True, help='So many times as fast.')
@click.option('--loop', is_flag=True, help='Begin anew at the end, until interrupted.')
@click.option(
    '--start', type=float, default=0.0, metavar='S', help='Begin S seconds into the record.'
)
@click.option(
    '--topic', 'topics', multiple=True, metavar='TOPIC', help='Only this one; may be repeated.'
)
@click.option(
    '--clock', is_flag=True, help='Publish /clock, and leave all times as they were recorded.'
)
@click.option('--namespace', default='', metavar='NAME', help='Put all names below NAME.')
@click.option(
    '--wait',
    type=float,
    default=1.0,
    show_default=True,
    metavar='S',
    help='Wait so long for subscribers.',
)
@json_option
def replay(record: Path, as_json: bool, **wishes: Any) -> None:
    """Publish the messages of a record again: in their order, at their pace, with their QoS.

    Times in the messages are moved to now, so that nodes take them for fresh; or, with --clock,
    left as they are, for nodes that run with use_sim_time. Before it begins it waits until every
    topic has a subscriber, but no longer than --wait says. What was latched before --start comes
    first. Nothing is replayed onto setpoints to which a stage driver listens.

    On a terminal: space pauses and goes on, n publishes the next message while paused, q ends.

    \b
    Examples:
      microhand replay runs/demo/demo.mcap --rate 0.5
      microhand replay runs/demo/demo.mcap --start 15.6 --loop --namespace again
      microhand replay runs/demo/demo.mcap --clock --topic object_state --topic plan
    """
    console = news_console(as_json)

    def work() -> dict[str, Any]:
        wanted = Wishes(
            rate=wishes['rate'],
            start_s=wishes['start'],
            loop=wishes['loop'],
            clock=wishes['clock'],
            namespace=wishes['namespace'],
            topics=wishes['topics'],
            wait_s=wishes['wait'],
        )
        with reading('looking', as_json) as progress:
            index = record_index(record, progress)
        columns = (
            TextColumn('{task.description}'),
            BarColumn(),
            TextColumn('{task.completed:.1f} of {task.total:.1f} s'),
        )
        shown = console.is_terminal
        with (
            interruptible(),
            Progress(*columns, console=console, transient=True, disable=not shown) as bar,
        ):
            task = bar.add_task('replaying', total=index.duration_s)

            def on_time(reached_s: float, paused: bool) -> None:
                text = 'paused   ' if paused else 'replaying'
                bar.update(task, completed=reached_s, description=text)

            played = Player(record, index, wanted, console.print, on_time).play()
        return vars(played)

    answer(as_json, KEYS, work, _show)


def _show(console: Console, result: dict[str, Any]) -> None:
    """Print how much was published."""
    console.print(f'{result["messages"]} messages on {len(result["topics"])} topics')
