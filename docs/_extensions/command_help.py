# SPDX-License-Identifier: Apache-2.0
"""The help of the commands, as the commands print it."""

from __future__ import annotations

import click

from microhand_station.cli import app

WIDTH = 88


def command_line() -> str:
    """Return the help of `microhand` and of each of its commands."""
    root = click.Context(app.microhand, info_name='microhand', max_content_width=WIDTH)
    root.terminal_width = WIDTH
    parts = [f'## microhand\n\n```text\n{root.get_help()}\n```\n']
    for name in app.COMMANDS:
        command = app.microhand.get_command(root, name)
        if command is None:
            raise ValueError(f'no command {name}')
        help_text = command.get_help(click.Context(command, parent=root, info_name=name))
        parts.append(f'## microhand {name}\n\n```text\n{help_text}\n```\n')
    return '\n'.join(parts)
