# SPDX-License-Identifier: Apache-2.0
"""The command `microhand`: finds the subcommand, and turns every failure into one line."""

from __future__ import annotations

import importlib
import sys
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path

import click

from microhand_planner.core.errors import MicrohandError

COMMANDS = (
    'plan',
    'planar',
    'verify',
    'station',
    'demo',
    'analyze',
    'replay',
    'export',
    'recover',
    'reproduce',
    'bench',
)
"""Each is the function of that name in the module of that name beside this one."""

SETTINGS = {'help_option_names': ['-h', '--help'], 'max_content_width': 100}
BAD_REQUEST = 2
FAILED = 4
INTERRUPTED = 130


class Commands(click.Group):
    """Imports a subcommand when it is wanted: planning needs no ROS."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names, in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a subcommand, or None if there is no such."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f'microhand_station.cli.{cmd_name}')
        command: click.Command = getattr(module, cmd_name)
        return command


@click.group(cls=Commands, context_settings=SETTINGS)
@click.version_option(package_name='microhand_station')
def microhand() -> None:
    """Plan and run the reorientation of a micro-object held by three fingers.

    \b
    Start here:
      microhand demo                     a whole simulated station, once
    or step by step:
      microhand plan ellipsoid --euler-zyz 80 220 100 -o turn.json
      microhand verify turn.json         would it hold? A physics engine says
      microhand station --view           a station with a page in the browser
      microhand analyze RUN.mcap         how a recorded run went

    `microhand COMMAND --help` has examples of each command. With --json, commands print one JSON
    object for programs.

    Exit status: 0 done; 2 bad request; 3 no plan; 4 the run failed; 130 interrupted. What is wrong
    is said in one line on stderr: the field, its value and what is allowed.
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    try:
        status = microhand.main(
            args=None if arguments is None else list(arguments),
            prog_name='microhand',
            standalone_mode=False,
        )
    except MicrohandError as error:
        return _fail(str(error), error.exit_status)
    except click.ClickException as error:
        return _fail(error.format_message(), BAD_REQUEST)
    except (click.Abort, KeyboardInterrupt):
        return _fail('interrupted', INTERRUPTED)
    except Exception as error:
        log = _write_log()
        return _fail(f'unforeseen {type(error).__name__}: {error}; details: {log}', FAILED)
    return status if isinstance(status, int) else 0


def _fail(message: str, status: int) -> int:
    """Print one line on stderr and return the exit status."""
    click.echo(f'microhand: {" ".join(message.split())}', err=True)
    return status


def _write_log() -> Path:
    """Write the traceback of the present error where the user can find it."""
    with tempfile.NamedTemporaryFile(
        'w', prefix='microhand_', suffix='.log', delete=False, encoding='utf-8'
    ) as log:
        traceback.print_exc(file=log)
    return Path(log.name)


if __name__ == '__main__':
    sys.exit(main())
