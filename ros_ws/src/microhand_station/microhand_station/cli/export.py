# SPDX-License-Identifier: Apache-2.0
"""`microhand export`: the messages of a record as tables. Needs no ROS."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from microhand_station.analysis.csv_export import Slice, export_csv
from microhand_station.analysis.record_index import record_index
from microhand_station.cli.answer import answer, json_option
from microhand_station.cli.reading import reading


@click.command(short_help='Write the messages of a record as CSV tables.')
@click.argument('record', type=click.Path(path_type=Path), metavar='RUN.mcap')
@click.option(
    '--csv',
    'folder',
    type=click.Path(file_okay=False, path_type=Path),
    metavar='DIR',
    required=True,
    help='Folder for the tables; made if it is missing.',
)
@click.option(
    '--from', 'from_s', type=float, metavar='S', help='Leave out what was recorded before.'
)
@click.option('--to', 'to_s', type=float, metavar='S', help='Leave out what was recorded after.')
@click.option(
    '--topic', 'topics', multiple=True, metavar='TOPIC', help='Only this one; may be repeated.'
)
@json_option
def export(
    record: Path,
    folder: Path,
    from_s: float | None,
    to_s: float | None,
    topics: tuple[str, ...],
    as_json: bool,
) -> None:
    """Write the messages of a record as CSV files: one tidy table per topic.

    Units stand in the heads, as in `position.x [m]`. The first column is the time since the first
    message of the record; --from and --to count from there, too. A record that ended in a crash is
    read as far as it goes.

    \b
    Examples:
      microhand export runs/demo/demo.mcap --csv tables
      microhand export runs/demo/demo.mcap --csv roll --from 4.7 --to 9 --topic finger_1/state
    """

    def work() -> dict[str, Any]:
        part = Slice(-math.inf if from_s is None else from_s, math.inf if to_s is None else to_s)
        with reading('looking', as_json) as progress:
            index = record_index(record, progress)
        with reading('writing', as_json) as progress:
            tables, damaged = export_csv(record, index, folder, topics, part, progress)
        return {
            'tables': [
                {'topic': table.topic, 'file': str(table.path), 'rows': table.rows}
                for table in tables
            ],
            'damaged_messages': damaged,
        }

    answer(as_json, ('tables', 'damaged_messages'), work, _show)


def _show(console: Console, result: dict[str, Any]) -> None:
    """Print which files there are."""
    table = Table(box=SIMPLE)
    table.add_column('topic')
    table.add_column('rows', justify='right')
    table.add_column('file', overflow='fold')
    for one in result['tables']:
        table.add_row(one['topic'], str(one['rows']), one['file'])
    console.print(table)
    if result['damaged_messages']:
        console.print(f'{result["damaged_messages"]} messages are damaged and left out')
