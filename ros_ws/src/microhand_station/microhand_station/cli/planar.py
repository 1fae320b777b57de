# SPDX-License-Identifier: Apache-2.0
"""`microhand planar`: the 2-D problem of Kumar et al. 2021 alone. Needs no ROS."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from microhand_planner.core.errors import BadRequest, NoPlanExists
from microhand_planner.core.interruption import interruption
from microhand_planner.core.planar import PlanarAnswer, solve_planar
from microhand_planner.core.planar_problem import PlanarProblem, problem_from_dict
from microhand_planner.core.search_result import Outcome
from microhand_station.cli.answer import answer, json_option
from microhand_station.cli.spinner import interruptible, searching, spinner

KEYS = ('cost_deg', 'reconfigurations', 'path', 'expanded', 'time_s')


@click.command(short_help='Solve one planar rotation on the lattice of the paper.')
@click.argument('problem', type=click.Path(path_type=Path), metavar='PROBLEM.json')
@json_option
def planar(problem: Path, as_json: bool) -> None:
    """Solve one planar rotation of an ellipse, on the lattice of the paper.

    The answer is a cheapest path of grasps [i j k l] by the paper's cost. Contact 1 lies at
    (a, 0), contacts are numbered counter-clockwise along the path of the tip's centre; 0 is a
    finger that is not used; l is the orientation, from 1.

    \b
    Example of PROBLEM.json:
      {"ellipse_um": [16.22, 11.586], "contacts": 74, "step_deg": 20,
       "orientations": 19, "start": [1, 38, 0, 1], "goal": [38, 1, 0, 12]}
    and what may be added, with its defaults:
      {"finger_radius_um": 4.5, "friction": 0.3, "pull_off_uN": 1.5,
       "max_force_uN": 30, "adhesion": true}

    \b
    Example:
      microhand planar problem.json --json
    """
    answer(as_json, KEYS, lambda: _solve(problem, as_json), _show)


def _solve(path: Path, as_json: bool) -> dict[str, Any]:
    """Read a problem and solve it."""
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise BadRequest('problem', f'{path} ({error.strerror})', 'a readable file') from error
    except ValueError as error:
        raise BadRequest('problem', f'{path} ({error})', 'a JSON file') from error
    problem = problem_from_dict(content)
    began_s = time.monotonic()
    with spinner(as_json) as say:
        say('searching')
        found = interruptible(lambda stop: _searched(problem, stop, searching(say)))
    if found.outcome is not Outcome.FOUND:
        raise NoPlanExists(
            f'no path exists: all {found.expanded} states that can be reached were searched',
            found.expanded,
        )
    return {
        'cost_deg': found.cost_deg,
        'reconfigurations': found.reconfigurations,
        'path': [list(node) for node in found.path],
        'expanded': found.expanded,
        'time_s': time.monotonic() - began_s,
    }


def _searched(
    problem: PlanarProblem, stop: Callable[[], bool], progress: Callable[[int], None]
) -> PlanarAnswer:
    """Search until the user interrupts."""
    with interruption(None, stop, time.monotonic, progress) as flag:
        return solve_planar(problem, flag)


def _show(console: Console, result: dict[str, Any]) -> None:
    """Print the path for people."""
    for before, node in zip([None, *result['path']], result['path'], strict=False):
        rolls = before is not None and before[3] != node[3]
        console.print(f'{"roll" if rolls else "":6}', *(f'{number:4d}' for number in node))
    console.print(
        f'\ncost {result["cost_deg"]:.0f}°, {result["reconfigurations"]} placements and removals, '
        f'{result["expanded"]} states expanded in {1e3 * result["time_s"]:.1f} ms'
    )
