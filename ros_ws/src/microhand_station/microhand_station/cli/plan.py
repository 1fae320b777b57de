# SPDX-License-Identifier: Apache-2.0
"""`microhand plan`: plan a 3-D reorientation. Needs no ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import BadRequest, NoPlan
from microhand_planner.core.parameters import GripRules, Mode
from microhand_planner.core.plan import FINGERS, Plan
from microhand_planner.core.plan_file import write_plan
from microhand_planner.core.planner import goal_error_deg, plan_reorientation
from microhand_planner.core.pose import FloatArray, Pose
from microhand_planner.core.section_curves import SectionCurves, section_curves
from microhand_planner.evaluation.price_of_margin import FACTORS, price_of_margin
from microhand_station.cli.answer import answer, json_option
from microhand_station.cli.plan_result import PLAN_KEYS, plan_result, show_plan, show_prices
from microhand_station.cli.request import Request, request_from, request_options
from microhand_station.cli.row_progress import collected
from microhand_station.cli.spinner import interruptible, searching, spinner
from microhand_station.contact_config import STIFFNESS_N_PER_M


@click.command(short_help='Plan a reorientation. Nothing moves.')
@click.argument('object_name', metavar='OBJECT')
@request_options
@click.option(
    '--start-tips-um',
    nargs=9,
    type=float,
    metavar='X1 Y1 Z1 ... Z3',
    help='Tip centres of fingers 1, 2, 3 that hold the object now, station frame, µm; nan: free.  '
    '[default: the planner chooses]',
)
@click.option(
    '-o',
    '--output',
    type=click.Path(dir_okay=False, path_type=Path),
    metavar='PLAN.json',
    help='Write the plan to a file, for `microhand verify`.',
)
@click.option(
    '--price-of-margin',
    'with_price',
    is_flag=True,
    help='Show also what the plan would cost with more and with less margin.',
)
@json_option
def plan(
    object_name: str,
    start_tips_um: tuple[float, ...] | None,
    output: Path | None,
    with_price: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Plan how three fingers bring OBJECT into another orientation.

    OBJECT is a mesh file (STL, OBJ, PLY, OFF, GLB, 3MF; in µm unless --unit says otherwise), or
    the name of an object of the catalogue: ellipsoid, convex, concave. Nothing moves.

    The answer is the cheapest plan: rolling costs the angle times the fingers in contact, placing
    or removing a finger 180°. Of all grips it tells the tightest: how far it is from slipping.
    Exit status 3: there is no plan; says whether that is proven, or the time limit was reached.

    \b
    Examples:
      microhand plan ellipsoid --euler-zyz 80 220 100
      microhand plan part.stl --unit mm --quaternion 0.92 0 0.38 0 -o turn.json
      microhand plan ellipsoid --euler-zyz 0 90 0 --step-deg 10 --json
      microhand plan convex --euler-zyz 40 110 30 --price-of-margin
      microhand plan ellipsoid --euler-zyz 40 110 30 --margin 0.7 --step-deg 10
    """
    known: dict[str, Any] = {'price_of_margin': None}

    def work() -> dict[str, Any]:
        began_s = time.monotonic()
        request = request_from(object_name, **options)
        if with_price and request.options.mode is Mode.PAPER:
            raise BadRequest('price-of-margin', 'asked for in paper mode', 'robust mode')
        tips_um = None if start_tips_um is None else np.reshape(start_tips_um, (3, 3))
        with spinner(as_json) as say:
            say(f'reading {object_name}')
            part = find_part(object_name, unit_um=request.unit_um)
            say(f'cutting the sections of {part.name}')
            geometry = section_curves(part, request.finger)
            say('searching')
            tell = searching(say)
            found = _attempt(lambda: _planned(geometry, request, request.rules, tips_um, tell))
        planning_s = time.monotonic() - began_s
        if with_price:
            known['price_of_margin'] = _prices(geometry, request, tips_um, as_json)
        if isinstance(found, NoPlan):
            if with_price and not as_json:
                show_prices(Console(highlight=False), known['price_of_margin'])
            raise found
        if output is not None:
            write_plan(found, output)
        return {**plan_result(found, goal_error_deg(found), planning_s), **known}

    answer(as_json, PLAN_KEYS, work, _show, known)


def _planned(
    geometry: SectionCurves,
    request: Request,
    rules: Sequence[GripRules],
    tips_um: FloatArray | None,
    progress: Callable[[int], None] | None = None,
) -> Plan:
    """Plan, until the user interrupts."""
    return interruptible(
        lambda stop: plan_reorientation(
            geometry,
            Pose(),
            request.goal,
            request.finger,
            request.law,
            request.options,
            rules,
            start_tip_um=tips_um,
            decomposition=request.rotations,
            cancelled=stop,
            progress=progress,
        )
    )


def _attempt(planned: Callable[[], Plan]) -> Plan | NoPlan:
    """Return a plan, or why there is none."""
    try:
        return planned()
    except NoPlan as error:
        return error


def _prices(
    geometry: SectionCurves, request: Request, tips_um: FloatArray | None, as_json: bool
) -> list[dict[str, Any]]:
    """Return what other margins cost; that of the request is among them."""
    factors = sorted({*FACTORS, request.rules[0].margin_factor}, reverse=True)
    rows = price_of_margin(
        lambda rules: _planned(geometry, request, rules, tips_um),
        request.rules,
        [STIFFNESS_N_PER_M] * FINGERS,
        factors,
    )
    return [vars(row) for row in collected('price of margin', len(factors), rows, as_json)]


def _show(console: Console, result: dict[str, Any]) -> None:
    """Print a plan, and what other margins cost."""
    show_plan(console, result)
    if result['price_of_margin'] is not None:
        show_prices(console, result['price_of_margin'])
