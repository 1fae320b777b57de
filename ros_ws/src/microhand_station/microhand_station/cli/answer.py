# SPDX-License-Identifier: Apache-2.0
"""How a command answers: JSON for programs, tables for people, errors for both."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any

import click
from rich.console import Console

from microhand_planner.core.errors import MicrohandError

STATUS_OF_CODE = {200: 'no_plan_exists', 201: 'time_limit', 202: 'cancelled'}
STATUS_OF_EXIT = {2: 'bad_request', 3: 'no_plan', 4: 'run_failed'}

json_option = click.option(
    '--json', 'as_json', is_flag=True, help='Print one JSON object for programs.'
)


def news_console(as_json: bool) -> Console:
    """Return the console for what happens meanwhile: stderr, silent if a program listens."""
    return Console(stderr=True, quiet=as_json, highlight=False)


def answer(
    as_json: bool,
    keys: Iterable[str],
    work: Callable[[], dict[str, Any]],
    show: Callable[[Console, dict[str, Any]], None],
    known: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Do the work of a command and print its result.

    Parameters
    ----------
    as_json : bool
        Print the result as JSON, also when the work fails; then `keys` are null unless known.
    keys : iterable of str
        What a result has beside ``status`` and ``error``.
    work : callable
        Returns the result; raises MicrohandError.
    show : callable
        Prints the result for people.
    known : mapping
        Filled by `work` with what is worth telling even if it fails.
    """
    try:
        result = {'status': 'ok', 'error': None, **work()}
    except MicrohandError as error:
        if as_json:
            failed = {'status': status_of(error), 'error': str(error)}
            click.echo(json.dumps({**failed, **dict.fromkeys(keys), **known}))
        raise
    if as_json:
        click.echo(json.dumps(result))
    else:
        show(Console(highlight=False), result)


def status_of(error: MicrohandError) -> str:
    """Return the word for an error in JSON.

    Examples
    --------
    >>> from microhand_planner.core.errors import TimeLimitReached
    >>> status_of(TimeLimitReached('the search was cut off'))
    'time_limit'
    """
    return STATUS_OF_CODE.get(error.code, STATUS_OF_EXIT[error.exit_status])
