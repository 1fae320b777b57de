# SPDX-License-Identifier: Apache-2.0
"""Random reorientations, planned, and run in the physics engine under several conditions.

    python benchmarks/reorientations.py [--count 100] [--seed 2026] [--object NAME ...]

An interrupted run goes on where it was, unless settings or code have changed. The figures go to
``benchmarks/results/reorientations.json``, the table to ``docs/reference/reorientations.md``.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import json
import math
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from record import write
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.errors import MicrohandError
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, Mode, SearchOptions
from microhand_planner.core.plan import Plan
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.section_curves import SectionCurves, section_curves
from microhand_twin.true_station import TrueStation
from microhand_twin.verify import verify

TOP = Path(__file__).parent.parent
PAGE = TOP / 'docs' / 'reference' / 'reorientations.md'
PARTIAL = TOP / 'build' / 'reorientations.jsonl'
PACKAGES = ('microhand_planner', 'microhand_twin')
OBJECTS = ('ellipsoid', 'convex', 'concave')
SLIPS = 0.999  # of the friction that there is
IDLE_UN = 0.05  # a finger that presses less holds nothing
PAPER_STEP_DEG = 20.0
CLEARANCE_UM = 0.5  # as `microhand plan` has it in robust mode

CONDITIONS = {
    'as planned': 'The station is what the plan takes it for.',
    'disturbed': 'True friction is 17 % lower (0.25), the true pull-off force anything from 80 to '
    '120 %, and fingers come to the object with errors of 100 nm in each direction.',
    'paper mode': 'A plan of the paper instead, by its Eq. 4 and without planned grips: each pair '
    'of fingers presses with 5 µN. The Euler angles are rounded to multiples of 20°, all the '
    'paper has. The station is what the plan takes it for.',
    'nothing sticks': 'The plan of "as planned", but there is no adhesion in the world: what '
    'theory says is lost must be lost.',
}


@functools.cache
def curves_of(name: str, clearance_um: float) -> SectionCurves:
    """Return the sections of an object of the catalogue."""
    return section_curves(find_part(name), Finger(clearance_um=clearance_um))


def goal_of(seed: int, number: int) -> Rotation:
    """Return a random orientation; all are equally likely."""
    return Rotation.random(random_state=np.random.default_rng([seed, number]))


def robust_plan(name: str, goal: Rotation) -> Plan:
    """Plan by default."""
    curves = curves_of(name, CLEARANCE_UM)
    law, options = ContactLaw(), SearchOptions()
    return plan_reorientation(
        curves, Pose(), Pose.of((0, 0, 0), goal), curves.finger, law, options
    )


def paper_plan(name: str, goal: Rotation) -> Plan:
    """Plan as the paper does, to the nearest goal that it has."""
    curves = curves_of(name, 0.0)
    angles_deg = PAPER_STEP_DEG * np.round(goal.as_euler('ZYZ', degrees=True) / PAPER_STEP_DEG)
    rotations = tuple(
        PlanarRotation(axis, math.radians(angle))
        for axis, angle in zip('zyz', angles_deg, strict=True)
        if angle != 0.0
    )
    options = SearchOptions(math.radians(PAPER_STEP_DEG), Mode.PAPER)
    target = Pose.of((0, 0, 0), Rotation.from_euler('ZYZ', angles_deg, degrees=True))
    return plan_reorientation(
        curves, Pose(), target, curves.finger, ContactLaw(), options, GripRules(),
        decomposition=rotations,
    )  # fmt: skip


def needs_adhesion(plan: Plan) -> bool:
    """Return whether the planned forces leave the friction cones of contacts that do not stick."""
    for step in plan.steps:
        if step.force_uN is None:
            continue
        inward_uN = -np.sum(step.force_uN * step.normal, axis=-1)
        along_uN = np.linalg.norm(step.force_uN + inward_uN[..., None] * step.normal, axis=-1)
        presses = np.linalg.norm(step.force_uN, axis=-1) > IDLE_UN
        if np.any((along_uN > plan.law.friction * inward_uN) & presses):
            return True
    return False


def station_of(condition: str, rng: np.random.Generator, stiffness: float) -> TrueStation:
    """Return the station of a condition."""
    law = ContactLaw()
    station = TrueStation(law, (stiffness,) * 3)
    if condition == 'disturbed':
        pull_off_uN = law.pull_off_uN * rng.uniform(0.8, 1.2)
        law = replace(law, friction=0.25, pull_off_uN=pull_off_uN)
        return replace(station, law=law, placement_um=0.1)
    if condition == 'nothing sticks':
        return replace(station, law=replace(law, adhesion=False))
    return station


def measure(name: str, number: int, seed: int, stiffness: float) -> list[dict[str, Any]]:
    """Plan one reorientation, and run it under all conditions."""
    goal = goal_of(seed, number)
    rows = []
    plans: dict[bool, Plan | str] = {}
    for condition in CONDITIONS:
        in_paper_mode = condition == 'paper mode'
        row: dict[str, Any] = {'object': name, 'number': number, 'condition': condition}
        if in_paper_mode not in plans:
            began_s = time.perf_counter()
            try:
                plans[in_paper_mode] = (paper_plan if in_paper_mode else robust_plan)(name, goal)
            except MicrohandError as error:
                plans[in_paper_mode] = str(error)
            row['planning_s'] = time.perf_counter() - began_s
        plan = plans[in_paper_mode]
        if isinstance(plan, str):
            rows.append({**row, 'no_plan': plan})
            continue
        if condition == 'nothing sticks':
            row['needs_adhesion'] = needs_adhesion(plan)
        rng = np.random.default_rng([seed, number, 1])
        station = station_of(condition, rng, stiffness)
        try:
            verdict = verify(plan, find_part(name), station, rng=rng)
        except MicrohandError as error:
            rows.append({**row, 'held': False, 'lost_at': str(error)})
            continue
        rows.append(
            {
                **row,
                'reconfigurations': plan.reconfigurations,
                'held': verdict.held,
                'lost_at': None if verdict.held else str(verdict.lost_at),
                'final_error_deg': verdict.final_error_deg,
                'final_error_um': verdict.final_error_um,
                'max_error_deg': verdict.max_error_deg,
                'max_friction_use': verdict.max_friction_use,
                'duration_s': verdict.duration_s,
                'wall_s': verdict.wall_s,
            }
        )
    return rows


def fingerprint(seed: int, stiffness: float) -> str:
    """Return what makes runs comparable: the settings, and the code behind them."""
    digest = hashlib.sha256(f'{seed} {stiffness}'.encode())
    for package in PACKAGES:
        for file in sorted((TOP / 'ros_ws' / 'src' / package / package).rglob('*.py')):
            if 'ros' not in file.parts:
                digest.update(file.read_bytes())
    return digest.hexdigest()


def earlier_rows(mark: str) -> list[dict[str, Any]]:
    """Return the rows of an interrupted run with the same mark, and begin the file otherwise."""
    PARTIAL.parent.mkdir(exist_ok=True)
    if PARTIAL.exists():
        first, *lines = PARTIAL.read_text(encoding='utf-8').splitlines()
        if json.loads(first) == mark:
            return [json.loads(line) for line in lines]
    PARTIAL.write_text(json.dumps(mark) + '\n', encoding='utf-8')
    return []


def summary(rows: list[dict[str, Any]], name: str, condition: str) -> dict[str, Any]:
    """Return the figures of one object under one condition."""
    mine = [row for row in rows if (row['object'], row['condition']) == (name, condition)]
    ran = [row for row in mine if 'no_plan' not in row]
    held = [row for row in ran if row['held']]

    def figure(key: str, reduce: Any, of: list[dict[str, Any]]) -> float | None:
        values = [row[key] for row in of if key in row]
        return float(reduce(values)) if values else None

    return {
        'object': name,
        'condition': condition,
        'count': len(mine),
        'no_plan': len(mine) - len(ran),
        'held': len(held),
        'held_without_slip': sum(row['max_friction_use'] < SLIPS for row in held),
        'final_error_median_deg': figure('final_error_deg', np.median, held),
        'final_error_worst_deg': figure('final_error_deg', np.max, held),
        'final_error_median_um': figure('final_error_um', np.median, held),
        'friction_use_median': figure('max_friction_use', np.median, held),
        'reconfigurations_median': figure('reconfigurations', np.median, ran),
        'duration_median_s': figure('duration_s', np.median, held),
        'wall_median_s': figure('wall_s', np.median, ran),
        'planning_median_s': figure('planning_s', np.median, ran),
        'against_theory': sum(row.get('needs_adhesion') is row['held'] for row in ran),
        'lost': [
            {'number': row['number'], 'lost_at': row['lost_at']} for row in ran if not row['held']
        ],
        'unplanned': [
            {'number': row['number'], 'why': row['no_plan']} for row in mine if 'no_plan' in row
        ],
    }


def page(summaries: list[dict[str, Any]], count: int, seed: int, stiffness: float) -> str:
    """Return the page with the table."""
    about = (
        f'{count} orientations per object, evenly distributed over all (seed {seed}), planned '
        'with the defaults and run in the [twin](../explanation/twin.md) with fingers of '
        f'{stiffness:g} N/m. *Held*: the object never left the fingers, nor came more than 5° or '
        '2 µm off the plan; a run can hold and slip. Errors are those at the end of runs that '
        'held.'
    )
    heads = (
        'object',
        'condition',
        'held',
        'without slip',
        'final error, median',
        'worst',
        'friction used, median',
        'regrasps, median',
    )
    lines = [
        '<!-- Written by benchmarks/reorientations.py; do not edit. -->',
        '# Random reorientations in the physics engine',
        '',
        about,
        '',
        *(f'- **{condition}**: {text}' for condition, text in CONDITIONS.items()),
        '',
        '| ' + ' | '.join(heads) + ' |',
        '| --- | --- |' + ' ---: |' * (len(heads) - 2),
    ]
    for row in summaries:
        ran = row['count'] - row['no_plan']
        cells = [
            row['object'], row['condition'], f'{row["held"]} of {ran}',
            str(row['held_without_slip']),
            *('' if row[key] is None else f'{row[key]:.2g}°'
              for key in ('final_error_median_deg', 'final_error_worst_deg')),
            '' if row['friction_use_median'] is None else f'{row["friction_use_median"]:.0%}',
            '' if row['reconfigurations_median'] is None
            else f'{row["reconfigurations_median"]:g}',
        ]  # fmt: skip
        lines.append('| ' + ' | '.join(cells) + ' |')
    against = sum(row['against_theory'] for row in summaries)
    lines += [
        '',
        'By theory, what cannot be held without adhesion are the plans whose forces leave the '
        f'plain friction cones. Where nothing sticks, {against or "none"} of the runs ended '
        'otherwise.',
    ]
    unplanned = sum(row['no_plan'] for row in summaries)
    if unplanned:
        lines += ['', f'{unplanned} requests have no plan; they are not counted.']
    return '\n'.join([*lines, ''])


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--count', type=int, default=100, help='orientations per object')
    parser.add_argument('--seed', type=int, default=2026)
    parser.add_argument('--stiffness', type=float, default=20.0, help='of the fingers, N/m')
    parser.add_argument('--object', action='append', choices=OBJECTS, help='only this one')
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--dry', action='store_true', help='print, and write no results')
    chosen = parser.parse_args()
    names = tuple(chosen.object or OBJECTS)
    rows = earlier_rows(fingerprint(chosen.seed, chosen.stiffness))
    done = {(row['object'], row['number']) for row in rows}
    left = [
        (name, number)
        for number in range(chosen.count)
        for name in names
        if (name, number) not in done
    ]
    columns = (
        TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns) as progress, ProcessPoolExecutor(chosen.processes) as pool:
        task = progress.add_task('reorientations', total=len(left))
        runs = [
            pool.submit(measure, name, number, chosen.seed, chosen.stiffness)
            for name, number in left
        ]
        for run in as_completed(runs):
            found = run.result()
            rows += found
            with PARTIAL.open('a', encoding='utf-8') as partial:
                partial.writelines(json.dumps(row) + '\n' for row in found)
            progress.advance(task)
    rows = [row for row in rows if row['object'] in names and row['number'] < chosen.count]
    summaries = [summary(rows, name, condition) for name in names for condition in CONDITIONS]
    text = page(summaries, chosen.count, chosen.seed, chosen.stiffness)
    print(text)
    for row in summaries:
        for lost in row['lost'] if row['condition'] in ('as planned', 'disturbed') else ():
            print(f'{row["object"]}, {row["condition"]}, {lost["number"]}: {lost["lost_at"]}')
    if not chosen.dry:
        print(write('reorientations', summaries, ('mujoco', 'numpy', 'scipy', 'numba')))
        PAGE.parent.mkdir(exist_ok=True)
        PAGE.write_text(text, encoding='utf-8')


if __name__ == '__main__':
    main()
