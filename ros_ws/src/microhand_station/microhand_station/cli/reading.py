# SPDX-License-Identifier: Apache-2.0
"""A progress bar while a record is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

from microhand_station.cli.answer import news_console


@contextmanager
def reading(what: str, as_json: bool) -> Iterator[Callable[[int, int], None]]:
    """Show a bar on stderr, on terminals only; yield what is told bytes done and bytes in total.

    Parameters
    ----------
    what : str
        Stands before the bar.
    as_json : bool
        A program listens: no bar.
    """
    console = news_console(as_json)
    columns = (
        TextColumn('{task.description}'),
        BarColumn(),
        DownloadColumn(),
        TimeRemainingColumn(),
    )
    shown = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not shown) as progress:
        task = progress.add_task(what)
        yield lambda done, total: progress.update(task, completed=done, total=total)
