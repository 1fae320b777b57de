# SPDX-License-Identifier: Apache-2.0
"""`microhand verify`: run a plan in a physics engine. Needs no ROS."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import RunFailed
from microhand_planner.core.force_check import check_forces
from microhand_planner.core.plan import Plan
from microhand_planner.core.plan_check import check_plan
from microhand_planner.core.plan_file import plan_hash, read_plan
from microhand_station.cli.answer import answer, json_option, news_console
from microhand_station.cli.request import UNITS_UM
from microhand_twin.drawn_run import DrawnRun
from microhand_twin.execution import Instant
from microhand_twin.simulation import Simulation
from microhand_twin.true_station import TrueStation
from microhand_twin.verdict import Verdict
from microhand_twin.verify import OBJECT_LOST
from microhand_twin.verify import verify as run_in_twin

KEYS = (
    'held',
    'final_error_deg',
    'final_error_um',
    'max_error_deg',
    'max_friction_use',
    'max_force_uN',
    'lost_at',
    'duration_s',
    'wall_s',
    'plan_hash',
)


@click.command(short_help='Run a plan in a physics engine: does the object stay held?')
@click.argument('plan_file', type=click.Path(path_type=Path), metavar='PLAN.json')
@click.option(
    '--object',
    'object_name',
    metavar='OBJECT',
    help="Mesh file, or name of the catalogue.  [default: the plan's object, by name]",
)
@click.option(
    '--unit', type=click.Choice(list(UNITS_UM)), help='Unit of the mesh file.  [default: um]'
)
@click.option('--friction', type=float, help="True Coulomb coefficient.  [default: the plan's]")
@click.option(
    '--pull-off-uN',
    'pull_off_un',
    type=float,
    help="True force that detaches a tip, µN.  [default: the plan's]",
)
@click.option('--no-adhesion', is_flag=True, help='Nothing sticks, whatever the plan assumes.')
@click.option(
    '--placement-nm',
    type=float,
    default=0.0,
    show_default=True,
    help='Fingers come to the object with errors: standard deviation in each direction, nm.',
)
@click.option(
    '--stiffness',
    type=float,
    default=20.0,
    show_default=True,
    help='Of the fingers, N/m (which is µN/µm).',
)
@click.option(
    '--seed', type=click.IntRange(0), default=0, show_default=True, help='Of the placement errors.'
)
@click.option(
    '--video',
    type=click.Path(dir_okay=False, path_type=Path),
    metavar='FILE.mp4',
    help='Write a film of the run.',
)
@click.option(
    '--picture',
    type=click.Path(dir_okay=False, path_type=Path),
    metavar='FILE.png',
    help='Write a picture of how it ended.',
)
@json_option
def verify(plan_file: Path, as_json: bool, **options: Any) -> None:
    """Run a plan in a physics engine, and say whether the object stays in the fingers.

    The engine knows nothing of the planner's theory: it has the object's surface, three spheres on
    springs, friction and adhesion. It can be given another friction, another adhesion or placement
    errors than the plan assumes. Exit status 4 if the object is lost.

    \b
    Examples:
      microhand plan ellipsoid --euler-zyz 80 220 100 -o turn.json
      microhand verify turn.json
      microhand verify turn.json --friction 0.25 --placement-nm 100 --seed 7
      microhand verify turn.json --no-adhesion --video lost.mp4
    """
    known: dict[str, Any] = {}

    def work() -> dict[str, Any]:
        plan, verdict = _run(plan_file, as_json, **options)
        known.update(_result(plan, verdict))
        if verdict.lost_at is not None:
            raise RunFailed(f'the object is lost in {verdict.lost_at}', OBJECT_LOST)
        return known

    answer(as_json, KEYS, work, _show, known)


def _run(
    plan_file: Path,
    as_json: bool,
    *,
    object_name: str | None,
    unit: str | None,
    friction: float | None,
    pull_off_un: float | None,
    no_adhesion: bool,
    placement_nm: float,
    stiffness: float,
    seed: int,
    video: Path | None,
    picture: Path | None,
) -> tuple[Plan, Verdict]:
    """Read and check the plan, run it, draw what is asked for."""
    plan = read_plan(plan_file)
    check_plan(plan)
    check_forces(plan)
    law = replace(
        plan.law,
        friction=plan.law.friction if friction is None else friction,
        pull_off_uN=plan.law.pull_off_uN if pull_off_un is None else pull_off_un,
        adhesion=plan.law.adhesion and not no_adhesion,
    )
    station = TrueStation(law, (stiffness,) * 3, placement_nm / 1e3)
    part = find_part(
        plan.object_name if object_name is None else object_name,
        unit_um=None if unit is None else UNITS_UM[unit],
    )
    with ExitStack() as open_things:
        progress = open_things.enter_context(
            Progress(
                TextColumn('{task.description}'),
                BarColumn(),
                TimeElapsedColumn(),
                console=news_console(as_json),
                transient=True,
            )
        )
        task = progress.add_task('simulated', total=1.0)
        drawn = open_things.enter_context(DrawnRun(plan, video, picture))

        def watch(simulation: Simulation, instant: Instant, share: float) -> None:
            progress.update(task, completed=share)
            drawn.watch(simulation, instant)

        rng = np.random.default_rng(seed)
        return plan, run_in_twin(plan, part, station, rng=rng, watch=watch)


def _result(plan: Plan, verdict: Verdict) -> dict[str, Any]:
    """Return the values of `KEYS`."""
    lost = verdict.lost_at
    return {
        'held': verdict.held,
        'final_error_deg': verdict.final_error_deg,
        'final_error_um': verdict.final_error_um,
        'max_error_deg': verdict.max_error_deg,
        'max_friction_use': verdict.max_friction_use,
        'max_force_uN': verdict.max_force_uN,
        'lost_at': None
        if lost is None
        else {
            'step': lost.step,
            'kind': lost.kind.value,
            'time_s': lost.time_s,
            'what': lost.what,
        },
        'duration_s': verdict.duration_s,
        'wall_s': verdict.wall_s,
        'plan_hash': plan_hash(plan),
    }


def _show(console: Console, result: dict[str, Any]) -> None:
    """Print the verdict for people."""
    console.print(
        f'held: off the goal by {result["final_error_deg"]:.2g}° and '
        f'{1e3 * result["final_error_um"]:.2g} nm, never by more than '
        f'{result["max_error_deg"]:.2g}° on the way',
        soft_wrap=True,
    )
    console.print(
        f'friction used: {result["max_friction_use"]:.0%} (100 % slips), largest force '
        f'{result["max_force_uN"]:.1f} µN',
        soft_wrap=True,
    )
    console.print(
        f'{result["duration_s"]:.1f} s of motion took {result["wall_s"]:.1f} s',
        style='dim',
    )
