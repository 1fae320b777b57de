# SPDX-License-Identifier: Apache-2.0
"""`microhand recover`: what is readable of a broken record. Needs no ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from rich.console import Console

from microhand_station.cli.answer import answer, json_option
from microhand_station.cli.reading import reading
from microhand_station.recording.recover import recover as recover_record


@click.command(short_help='Save what is readable of a broken record.')
@click.argument('broken', type=click.Path(path_type=Path), metavar='BROKEN.mcap')
@click.argument('out', type=click.Path(path_type=Path), metavar='OUT.mcap')
@json_option
def recover(broken: Path, out: Path, as_json: bool) -> None:
    """Copy every readable message of a record that was not finished into a sound file.

    A record is broken if the recorder was killed, or its disk was full. BROKEN stays as it is.

    \b
    Example:
      microhand recover runs/killed/killed.mcap saved.mcap
    """

    def work() -> dict[str, Any]:
        with reading('reading', as_json) as progress:
            messages = recover_record(broken, out, progress)
        return {'messages': messages, 'file': str(out)}

    answer(as_json, ('messages', 'file'), work, _show)


def _show(console: Console, result: dict[str, Any]) -> None:
    """Print how much was saved."""
    console.print(f'{result["messages"]} messages saved in {result["file"]}')
