# SPDX-License-Identifier: Apache-2.0
"""`microhand reproduce`: the tables of Kumar et al. 2021 beside ours. Needs no ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import click
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from microhand_planner.core.catalogue import find_part
from microhand_planner.evaluation.paper_figures import FRICTIONS, TABLE_2, TABLE_3, TABLE_4
from microhand_planner.evaluation.table2 import ORIENTATIONS, Table2Row, table2
from microhand_planner.evaluation.table3 import Table3Row, table3
from microhand_planner.evaluation.table4 import Table4Row, table4
from microhand_station.cli.answer import answer, json_option
from microhand_station.cli.row_progress import collected

Row = dict[str, Any]

ROTATIONS = 3
STYLE: dict[str, Any] = {'box': SIMPLE, 'padding': (0, 1, 0, 0)}


class PaperTable(NamedTuple):
    """One table: how many rows, where they come from, and how people see them."""

    size: int
    rows: Callable[[], Iterator[Row]]
    show: Callable[[Console, list[Row]], None]


@click.command(short_help='Print a table of the paper beside ours.')
@click.argument('table', type=click.Choice(['table2', 'table3', 'table4']))
@json_option
def reproduce(table: str, as_json: bool) -> None:
    """Compute a table of the paper and print its figures beside ours.

    \b
    table2  how friction and adhesion decide how many grasps are stable (half a minute)
    table3  the ellipsoid's second rotation, to each of its six goals
    table4  whole rotations of the three objects, with and without adhesion

    \b
    Example:
      microhand reproduce table3
    """
    chosen = TABLES[table]

    def work() -> dict[str, Any]:
        return {'table': table, 'rows': collected(table, chosen.size, chosen.rows(), as_json)}

    answer(
        as_json,
        ('table', 'rows'),
        work,
        lambda console, result: chosen.show(console, result['rows']),
    )


def _rows2() -> Iterator[Row]:
    """Return table 2 as JSON rows."""
    return (_row2(row) for row in table2(find_part))


def _row2(row: Table2Row) -> Row:
    paper = row.paper
    paper_share = [count / paper.with_adhesion for count in paper.without_adhesion]
    return {
        'object': row.object_name,
        'line': row.line,
        'contacts': row.contacts,
        'friction': list(FRICTIONS),
        'with_adhesion_millions': row.with_adhesion,
        'without_adhesion_millions': list(row.without_adhesion),
        'share': list(row.share),
        'paper_with_adhesion_millions': paper.with_adhesion,
        'paper_without_adhesion_millions': list(paper.without_adhesion),
        'paper_share': paper_share,
    }


def _show2(console: Console, rows: list[Row]) -> None:
    """Print table 2; each line of ours with the paper's below."""
    table = Table(
        title='Table 2: stable grasps in millions, with adhesion, and without at µ', **STYLE
    )
    for name in ('object', 'line', 'c', '', 'adhesion'):
        table.add_column(name, justify='right' if name in ('c', 'adhesion') else 'left')
    for friction in FRICTIONS:
        table.add_column(f'µ = {friction:g}', justify='right')
    for row in rows:
        names = row['object'], row['line'], str(row['contacts'])
        for first_cells, who, key in ((names, 'ours', ''), (('', '', ''), 'paper', 'paper_')):
            counts = zip(row[f'{key}without_adhesion_millions'], row[f'{key}share'], strict=True)
            table.add_row(
                *first_cells,
                who,
                f'{row[f"{key}with_adhesion_millions"]:.4g}',
                *(f'{count:.4g} {share:4.0%}' for count, share in counts),
            )
    console.print(table)
    console.print(
        f'Grasps of two and three fingers, fingers told apart, in {ORIENTATIONS} orientations.\n'
        'Of the paper, one row is for both lines of the ellipsoid, one for L2 of both objects.'
    )


def _rows3() -> Iterator[Row]:
    """Return table 3 as JSON rows."""
    return (_row3(row) for row in table3())


def _row3(row: Table3Row) -> Row:
    return {
        'goal': list(row.goal),
        'cost_deg': row.cost_deg,
        'reconfigurations': row.reconfigurations,
        'expanded': row.expanded,
        'time_s': row.time_s,
        'paper_cost_deg': row.paper.cost_deg,
        'paper_reconfigurations': row.paper.reconfigurations,
        'paper_time_s': row.paper.time_with_ties_broken_s,
    }


def _show3(console: Console, rows: list[Row]) -> None:
    """Print table 3."""
    table = Table(title="Table 3: the ellipsoid's second rotation, from [1 38 0 1]", **STYLE)
    table.add_column('goal [i j k l]')
    for name in ('cost', 'reconfig.', 'expanded', 'time'):
        table.add_column(name, justify='right')
    for row in rows:
        table.add_row(
            ' '.join(map(str, row['goal'])),
            f'{_degrees(row["cost_deg"])} ({_degrees(row["paper_cost_deg"])})',
            f'{_count(row["reconfigurations"])} ({_count(row["paper_reconfigurations"])})',
            str(row['expanded']),
            f'{_time(row["time_s"])} ({_time(row["paper_time_s"])})',
        )
    console.print(table)
    console.print('In brackets: the paper. Reconfigurations: placements and removals.')


def _rows4() -> Iterator[Row]:
    """Return table 4 as JSON rows."""
    return (_row4(row) for row in table4(find_part))


def _row4(row: Table4Row) -> Row:
    return {
        'object': row.object_name,
        'rotation': row.rotation,
        'axis': row.axis,
        'angle_deg': row.angle_deg,
        'adhesion': row.adhesion,
        'reconfigurations': row.reconfigurations,
        'cost_deg': row.cost_deg,
        'expanded': row.expanded,
        'waiting': row.waiting,
        'time_s': row.time_s,
        'paper_reconfigurations': row.paper.reconfigurations,
        'paper_visited': row.paper.visited,
        'paper_waiting': row.paper.waiting,
        'paper_time_s': row.paper.time_s,
    }


def _show4(console: Console, rows: list[Row]) -> None:
    """Print table 4."""
    table = Table(title='Table 4: rotations about z, y and z', pad_edge=False, **STYLE)
    table.add_column('rotation', no_wrap=True)
    table.add_column('sticks')
    for name in ('reconfig.', 'visited', 'waiting', 'time'):
        table.add_column(name, justify='right')
    for row in rows:
        table.add_row(
            f'{row["object"]} {row["angle_deg"]:g}° {row["axis"]}',
            'yes' if row['adhesion'] else 'no',
            f'{_count(row["reconfigurations"])} ({_count(row["paper_reconfigurations"])})',
            f'{row["expanded"]} ({row["paper_visited"]})',
            f'{row["waiting"]} ({row["paper_waiting"]})',
            f'{_time(row["time_s"])} ({_time(row["paper_time_s"])})',
            end_section=row['rotation'] == ROTATIONS,
        )
    console.print(table)
    console.print(
        'In brackets: the paper. NPA: no path available. Waiting: states that were\n'
        'still to be visited; our search creates most of them later than the paper does.'
    )


def _count(number: int | None) -> str:
    return 'NPA' if number is None else str(number)


def _degrees(cost_deg: float | None) -> str:
    return 'NPA' if cost_deg is None else f'{cost_deg:.0f}°'


def _time(time_s: float) -> str:
    if time_s < 0.0995:
        return f'{1e3 * time_s:.2g} ms'
    return f'{time_s:.3g} s' if time_s < 100.0 else f'{time_s:.0f} s'


TABLES = {
    'table2': PaperTable(len(TABLE_2), _rows2, _show2),
    'table3': PaperTable(len(TABLE_3), _rows3, _show3),
    'table4': PaperTable(2 * ROTATIONS * len(TABLE_4), _rows4, _show4),
}
