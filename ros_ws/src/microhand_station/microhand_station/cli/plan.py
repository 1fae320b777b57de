# SPDX-License-Identifier: Apache-2.0
"""`microhand plan`: plan a 3-D reorientation. Needs no ROS."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click
import numpy as np

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.plan_file import write_plan
from microhand_planner.core.planner import goal_error_deg, plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_station.cli.answer import answer, json_option
from microhand_station.cli.plan_result import PLAN_KEYS, plan_result, show_plan
from microhand_station.cli.request import request_from, request_options


@click.command()
@click.argument('object_name', metavar='OBJECT')
@request_options
@click.option(
    '--start-tips-um',
    nargs=9,
    type=float,
    metavar='X1 Y1 Z1 ... Z3',
    help='Tip centres of fingers 1, 2, 3 that hold the object now, station frame; nan: free.  '
    '[default: the planner chooses]',
)
@click.option(
    '-o',
    '--output',
    type=click.Path(dir_okay=False, path_type=Path),
    metavar='PLAN.json',
    help='Write the plan to a file.',
)
@json_option
def plan(
    object_name: str,
    start_tips_um: tuple[float, ...] | None,
    output: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    r"""Plan how three fingers bring OBJECT into another orientation.

    OBJECT is a mesh file (STL, OBJ, PLY, ...; in µm unless --unit says otherwise), or the name of
    an object of the catalogue: ellipsoid, convex, concave, ... Nothing moves.

    \b
    Examples:
      microhand plan ellipsoid --euler-zyz 80 220 100
      microhand plan part.stl --unit mm --quaternion 0.92 0 0.38 0 -o turn.json
      microhand plan ellipsoid --euler-zyz 0 90 0 --step-deg 10 --json
    """

    def work() -> dict[str, Any]:
        began_s = time.monotonic()
        request = request_from(object_name, **options)
        part = find_part(object_name, unit_um=request.unit_um)
        made = plan_reorientation(
            part,
            Pose(),
            request.goal,
            request.finger,
            request.law,
            request.options,
            request.rules,
            start_tip_um=None if start_tips_um is None else np.reshape(start_tips_um, (3, 3)),
            decomposition=request.rotations,
        )
        if output is not None:
            write_plan(made, output)
        return plan_result(made, goal_error_deg(made), time.monotonic() - began_s)

    answer(as_json, PLAN_KEYS, work, show_plan)
