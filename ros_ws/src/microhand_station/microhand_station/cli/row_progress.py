# SPDX-License-Identifier: Apache-2.0
"""A progress bar for tables that are computed row by row."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from microhand_station.cli.answer import news_console

Row = TypeVar('Row')


def collected(name: str, size: int, rows: Iterator[Row], as_json: bool) -> list[Row]:
    """Collect rows as they come, with a bar on stderr unless a program listens.

    Parameters
    ----------
    name : str
        What is computed.
    size : int
        Number of rows.
    rows : iterator
        The rows.
    as_json : bool
        No bar.
    """
    columns = (
        TextColumn('{task.description}'),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=news_console(as_json), transient=True) as progress:
        return list(progress.track(rows, total=size, description=name))
