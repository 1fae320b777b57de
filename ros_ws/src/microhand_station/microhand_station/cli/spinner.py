# SPDX-License-Identifier: Apache-2.0
"""What a command is doing while nothing else can be seen, and Ctrl-C while it does."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from microhand_station.cli.answer import news_console

Result = TypeVar('Result')


@contextmanager
def spinner(as_json: bool) -> Iterator[Callable[[str], None]]:
    """Show on stderr what is being done, and for how long; only to people at a terminal.

    Parameters
    ----------
    as_json : bool
        A program listens: show nothing.

    Yields
    ------
    callable
        Takes what is being done now.
    """
    console = news_console(as_json)
    columns = (SpinnerColumn(), TextColumn('{task.description}'), TimeElapsedColumn())
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task('', total=None)

        def tell(text: str) -> None:
            progress.update(task, description=text)
            progress.refresh()  # at once: short work is over before the next frame

        yield tell


def searching(say: Callable[[str], None]) -> Callable[[int], None]:
    """Return a callable that takes the states that a search has expanded, and shows them.

    Parameters
    ----------
    say : callable
        From `spinner`.
    """
    shown = 0

    def tell(expanded: int) -> None:
        nonlocal shown
        if expanded != shown:
            shown = expanded
            say(f'searching: {expanded:,} states expanded'.replace(',', ' '))

    return tell


def interruptible(work: Callable[[Callable[[], bool]], Result]) -> Result:
    """Do work in a thread, so that Ctrl-C is heard while compiled code runs.

    Python hears signals between two of its own instructions only, and in the main thread only; a
    long search would end first.

    Parameters
    ----------
    work : callable
        Is given a callable that says whether to stop.

    Raises
    ------
    KeyboardInterrupt
        The user pressed Ctrl-C; the work was told to stop, and has.
    """
    stop = threading.Event()
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix='work') as pool:
        future = pool.submit(work, stop.is_set)
        try:
            return future.result()
        except KeyboardInterrupt:
            stop.set()
            raise
