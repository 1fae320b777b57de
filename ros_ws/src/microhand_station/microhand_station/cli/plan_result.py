# SPDX-License-Identifier: Apache-2.0
"""What `plan` and `demo` say about a plan: keys for programs, a table for people."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from microhand_planner.core.plan import Plan
from microhand_planner.core.plan_file import plan_hash

PLAN_KEYS = (
    'cost_deg',
    'reconfigurations',
    'rotations',
    'goal_error_deg',
    'planning_time_s',
    'plan_hash',
    'tightest',
)


def plan_result(plan: Plan, goal_error_deg: float, planning_time_s: float) -> dict[str, Any]:
    """Return the values of `PLAN_KEYS`."""
    return {
        'cost_deg': plan.cost_deg,
        'reconfigurations': plan.reconfigurations,
        'rotations': [dict(vars(rotation)) for rotation in plan.rotations],
        'goal_error_deg': goal_error_deg,
        'planning_time_s': planning_time_s,
        'plan_hash': plan_hash(plan),
        'tightest': _tightest(plan),
    }


def _tightest(plan: Plan) -> dict[str, Any] | None:
    """Return the step whose grip leaves the smallest margin; None: no grip was planned."""
    if plan.tightest is None:
        return None
    number, hold = plan.tightest
    return {'step': number, 'kind': plan.steps[number].kind.value, **vars(hold)}


def show_plan(console: Console, result: dict[str, Any]) -> None:
    """Print the rotations of a plan and their sums."""
    table = Table(box=None, pad_edge=False, header_style='dim')
    headings = ('rotation', 'axis', 'angle', 'cost', 'regrasps', 'expanded', 'waiting', 'time')
    for heading in headings:
        table.add_column(heading, justify='left' if heading == 'axis' else 'right')
    for number, rotation in enumerate(result['rotations'], start=1):
        table.add_row(
            str(number),
            rotation['axis'],
            f'{rotation["angle_deg"]:.2f}°',
            f'{rotation["cost_deg"]:.0f}°',
            str(rotation['reconfigurations']),
            str(rotation['expanded']),
            str(rotation['waiting']),
            f'{1e3 * rotation["time_s"]:.1f} ms',
        )
    console.print(table)
    console.print(
        f'\ncost {result["cost_deg"]:.0f}°, {result["reconfigurations"]} placements and removals, '
        f'off the goal by {result["goal_error_deg"]:.2g}°, '
        f'planned in {result["planning_time_s"]:.2f} s',
        soft_wrap=True,
    )
    tightest = result['tightest']
    if tightest is None and result['cost_deg'] == 0.0:
        console.print('no grips to plan: the fingers take hold, and nothing turns')
    elif tightest is None:
        console.print('grips were not planned: paper mode leaves forces open')
    else:
        console.print(
            f'tightest: step {tightest["step"]} ({tightest["kind"]}), grip '
            f'{tightest["grip_uN"]:.2f} µN of {tightest["low_uN"]:.2f} to '
            f'{tightest["high_uN"]:.2f}, {tightest["margin_uN"]:.2f} µN from slipping',
            soft_wrap=True,
        )
    console.print(f'plan {result["plan_hash"]}', style='dim', soft_wrap=True)


def show_prices(console: Console, rows: list[dict[str, Any]]) -> None:
    """Print what margins cost: one line per margin factor."""
    table = Table(box=None, pad_edge=False, header_style='dim', title_justify='left')
    for heading in ('margin', 'cost', 'regrasps', 'motion', 'tightest'):
        table.add_column(heading, justify='right')
    for row in rows:
        if row['cost_deg'] is None:
            cells = ['no plan' if row['proven'] else 'time limit', '', '', '']
        else:
            cells = [
                f'{row["cost_deg"]:.0f}°',
                str(row['reconfigurations']),
                f'{row["motion_s"]:.1f} s',
                f'{row["tightest_uN"]:.2f} µN',
            ]
        table.add_row(f'{row["margin_factor"]:g}', *cells)
    console.print('\nThe price of margin: the same, planned with other shares of the friction')
    console.print(table)
