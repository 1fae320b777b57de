# SPDX-License-Identifier: Apache-2.0
"""`microhand analyze`: what a recorded run says, as figures and as a page. Needs no ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from microhand_station.analysis.findings import as_json as figures
from microhand_station.analysis.findings import findings
from microhand_station.analysis.report import write_report
from microhand_station.analysis.report_text import verdict
from microhand_station.analysis.run import Run
from microhand_station.cli.answer import answer, json_option
from microhand_station.cli.reading import reading

KEYS = ('report', 'held', 'tracking_error_um', 'object_error_deg', 'final_error_deg', 'events')


@click.command(short_help='Write a report of a recorded run, or compare two.')
@click.argument('record', type=click.Path(path_type=Path), metavar='RUN.mcap')
@click.option(
    '-o',
    '--output',
    type=click.Path(dir_okay=False, path_type=Path),
    metavar='REPORT.html',
    help='Page to write; an existing one is replaced.  [default: RUN.html beside the record]',
)
@click.option(
    '--compare',
    type=click.Path(path_type=Path),
    metavar='OTHER.mcap',
    help='Set another run beside this one.',
)
@json_option
def analyze(record: Path, output: Path | None, compare: Path | None, as_json: bool) -> None:
    """Write a report of a recorded run: a page that any browser opens, without a network.

    What was asked, what was planned, whether it held, where it was worst; object and fingers in
    space over time; positions, errors and forces beside it. Also of runs that ended in a crash:
    the page says what is missing.

    \b
    Examples:
      microhand analyze runs/demo/demo.mcap
      microhand analyze runs/demo/demo.mcap --json
      microhand analyze today.mcap --compare yesterday.mcap -o both.html
      microhand analyze examples/reorientation.mcap -o look.html     # a run that is shipped
    """

    def work() -> dict[str, Any]:
        with reading('reading', as_json) as progress:
            run = Run.open(record, progress)
            other = None if compare is None else Run.open(compare, progress)
        found = findings(run)
        page = record.with_suffix('.html') if output is None else output
        write_report(run, page, compare=other, found=found)
        sentence, _ = verdict(run, found)
        result = {'verdict': sentence, 'report': str(page), **figures(run, found)}
        if other is not None:
            result['compared'] = figures(other, findings(other))
        return result

    answer(as_json, KEYS, work, _show)


def _show(console: Console, result: dict[str, Any]) -> None:
    """Print the verdict, the worst moments and where the page is."""
    console.print(f'{result["verdict"]}.', style='bold', soft_wrap=True)
    for text in (result['failure'], *result['missing']):
        if text:
            console.print(text, style='yellow', soft_wrap=True)
    table = Table(box=SIMPLE)
    for name in ('where it was worst', 'value', 'time', 'step'):
        table.add_column(name, justify='left' if name.startswith('where') else 'right')
    units = {'deg': '°', 'um': ' µm', 'uN': ' µN', 'share': ''}
    for name, worst in result['worst'].items():
        if worst is None:
            continue
        unit, value = next(iter(worst.items()))
        step = '' if worst['step'] is None else str(worst['step'])
        shown = f'{value:.3g}{units[unit]}'
        table.add_row(name.replace('_', ' '), shown, f'{worst["time_s"]:.2f} s', step)
    for finger, largest_um in result['max_tracking_error_um'].items():
        table.add_row(f'tracking error of finger {finger}', f'{largest_um:.3g} µm', '', '')
    if table.row_count:
        console.print(table)
    console.print(f'report  {result["report"]}', soft_wrap=True)
