# SPDX-License-Identifier: Apache-2.0
"""`microhand bench`: how long plans take on this machine. Needs no ROS."""

from __future__ import annotations

from typing import Any

import click
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from microhand_planner.core.catalogue import find_part
from microhand_planner.evaluation.speed import BenchRow, bench_size
from microhand_planner.evaluation.speed import bench as measured
from microhand_station.cli.answer import answer, json_option
from microhand_station.cli.row_progress import collected


@click.command(short_help='Measure how long plans take on this machine.')
@json_option
def bench(as_json: bool) -> None:
    """Measure the planner: medians of several runs, about a minute.

    \b
    plan                    the object of the paper's Table 4, its sections in memory; all
                            decompositions and permutations, and the motions of the fingers
    plan from mesh file     the same, from reading the file
    plan to random goals    50 orientations, one run each
    Table 3's dearest goal  one planar rotation after which each finger is back on its place
    plan in a new process   from starting Python to its end

    Other work on the machine makes the figures worse: look at the fastest run as well.

    \b
    Example:
      microhand bench --json
    """

    def work() -> dict[str, Any]:
        rows = collected('bench', bench_size(), measured(find_part), as_json)
        return {'rows': [_as_json(row) for row in rows]}

    answer(as_json, ('rows',), work, _show)


def _as_json(row: BenchRow) -> dict[str, Any]:
    """Return a row as JSON."""
    return {
        'case': row.case,
        'object': row.object_name,
        'step_deg': row.step_deg,
        'runs': row.timing.runs,
        'median_s': row.timing.median_s,
        'fastest_s': row.timing.fastest_s,
        'slowest_s': row.timing.slowest_s,
        'paper_s': row.paper_s,
        'times_faster': row.times_faster,
    }


def _show(console: Console, result: dict[str, Any]) -> None:
    """Print the rows as a table."""
    table = Table(title='Wall times in ms', box=SIMPLE)
    table.add_column('case', no_wrap=True)
    table.add_column('object')
    for name in ('Δθ', 'runs', 'median', 'fastest', 'slowest', 'paper/ours'):
        table.add_column(name, justify='right')
    for row in result['rows']:
        known = row['paper_s'] is not None
        table.add_row(
            row['case'],
            row['object'],
            f'{row["step_deg"]:g}°',
            str(row['runs']),
            *(f'{1e3 * row[name]:.2f}' for name in ('median_s', 'fastest_s', 'slowest_s')),
            f'{row["times_faster"]:.0f}' if known else '',
        )
    console.print(table)
