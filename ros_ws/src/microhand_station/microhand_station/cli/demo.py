# SPDX-License-Identifier: Apache-2.0
"""`microhand demo`: a station of its own, one reorientation, its record and its report."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.plan_file import write_plan
from microhand_planner.core.pose import Pose
from microhand_station.analysis.report import write_report
from microhand_station.analysis.run import Run
from microhand_station.bringup.signals import interruptible
from microhand_station.bringup.station import RunningStation
from microhand_station.cli.answer import answer, json_option, news_console
from microhand_station.cli.plan_result import PLAN_KEYS, plan_result, show_plan
from microhand_station.cli.request import Request, request_from, request_options
from microhand_station.cli.station_options import StationChoice, station_choice, station_options
from microhand_station.client import StationClient
from microhand_station.client_answers import ExecutionResult, PlanAnswer, StationError

KEYS = (*PLAN_KEYS, 'mcap', 'report', 'held', 'final_error_deg')
STATION_KEYS = ('config', 'namespace', 'domain_id', 'run_dir', 'speed')
RUN_NAME = 'demo'
"""Of the record, which is there even if nobody is left to tell its name."""
PAPER_ZYZ_DEG = (80.0, 220.0, 100.0)


@click.command(short_help='A station, one reorientation, its record and report; then end.')
@click.argument('object_name', metavar='[OBJECT]', default='ellipsoid')
@request_options
@station_options
@json_option
def demo(object_name: str, as_json: bool, **options: Any) -> None:
    """Run a whole simulated station for one reorientation of OBJECT.

    Starts planner, sequencer, recorder, three stage drivers and the twin that stands in for the
    object as processes of their own, asks the planner for a plan and the sequencer to execute it,
    and writes plan, record, report and logs into a new folder below --run-dir. OBJECT is a mesh
    file or a name of the catalogue, `ellipsoid` if left out; the rotation of the paper, 80 220
    100, is the default. Exit status 4 if the object is lost, or the run ended early.

    \b
    Examples:
      microhand demo
      microhand demo part.stl --unit mm --euler-zyz 0 90 0 --speed 2
      microhand demo convex --euler-zyz 0 60 0 --config station.yaml --json
    """
    of_station = {key: options.pop(key) for key in STATION_KEYS}
    if options['quaternion'] is None and options['euler_zyz'] is None:
        options['euler_zyz'] = PAPER_ZYZ_DEG

    known: dict[str, Any] = {}

    def work() -> dict[str, Any]:
        request = request_from(object_name, **options)
        _run(request, _alone(station_choice('demo', **of_station)), as_json, known)
        return known

    answer(as_json, KEYS, work, _show, known)


def _alone(choice: StationChoice) -> StationChoice:
    """Give the demonstration a ROS domain of its own, unless the user has chosen one."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    if choice.domain_id is None and 'ROS_DOMAIN_ID' not in os.environ:
        return StationChoice(choice.config, choice.folder, 1 + os.getpid() % 100)
    return choice


def _run(request: Request, choice: StationChoice, as_json: bool, known: dict[str, Any]) -> None:
    """Start the station, plan, execute, and write the report; `known` is filled meanwhile."""
    console = news_console(as_json)
    station = RunningStation(choice.config, choice.folder, choice.domain_id, console.print)
    began_s = time.monotonic()
    with interruptible():
        console.print('starting the station …')
        with station, StationClient(choice.config.namespace, choice.domain_id) as client:
            console.print(f'nodes ready after {time.monotonic() - began_s:.1f} s; planning …')
            found = client.plan(
                _findable(request.object_name),
                Pose(),
                request.goal,
                unit_um=request.unit_um or 0.0,
                finger=request.finger,
                law=request.law,
                options=request.options,
                rules=request.rules,
                words=request.words,
            )
            write_plan(found.plan, choice.folder / 'plan.json')
            goal_error_deg = math.degrees(found.goal_error_rad)
            known.update(plan_result(found.plan, goal_error_deg, found.planning_time_s))
            done, failure = _execute(client, request, found, console)
        for trouble in station.troubles:
            console.print(trouble)
        known.update(_result(choice.folder, done))
        if failure is not None:
            if known.get('report') is not None:
                console.print(f'report  {known["report"]}', soft_wrap=True)
            raise failure


def _findable(object_name: str) -> str:
    """Return a mesh file's full path: the planner may have another working directory."""
    path = Path(object_name)
    return str(path.absolute()) if path.is_file() else object_name


def _execute(
    client: StationClient, request: Request, found: PlanAnswer, console: Console
) -> tuple[ExecutionResult | None, StationError | RunFailed | None]:
    """Execute the plan under a progress bar; return how far it came, and why no further."""
    columns = (TextColumn('{task.description}'), BarColumn(), TimeRemainingColumn())
    shown = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not shown) as bar:
        task = bar.add_task('on the way to the start', total=1.0)

        def tell(progress: Any) -> None:
            text = (
                f'step {progress.step + 1} of {progress.steps}, rotation {progress.rotation + 1}'
            )
            bar.update(task, completed=progress.share, description=text)

        try:
            done = client.execute(
                found.plan,
                RUN_NAME,
                tell,
                object_name=_findable(request.object_name),
                unit_um=request.unit_um or 0.0,
            )
        except StationError as error:
            return error.execution, error
        except RunFailed as error:  # the sequencer died
            return None, error
        return done, None


def _result(folder: Path, done: ExecutionResult | None) -> dict[str, Any]:
    """Write the report and return what the demonstration says of the execution."""
    result: dict[str, Any] = {'mcap': None, 'report': None, 'held': None, 'final_error_deg': None}
    record = folder / RUN_NAME / f'{RUN_NAME}.mcap'
    if record.exists():
        report = folder / 'report.html'
        write_report(Run.open(record), report)
        result |= {'mcap': str(record), 'report': str(report)}
    if done is not None:
        error_rad = done.final_error_rad
        result |= {
            'held': done.held,
            'final_error_deg': None if error_rad is None else math.degrees(error_rad),
            'duration_s': done.duration_s,
            'setpoints': done.setpoints_sent,
            'record_error': done.record_error,
        }
    return result


def _show(console: Console, result: Mapping[str, Any]) -> None:
    """Print the summary for people."""
    show_plan(console, dict(result))
    console.print(
        f'\nexecuted in {result["duration_s"]:.1f} s: {result["setpoints"]} setpoints to each of '
        'three stages, all on target'
    )
    if result['held'] is None:
        console.print('whether the object was held: not judged, nothing watched it')
    else:
        console.print(
            f'the object was held throughout, and is {result["final_error_deg"]:.3f}° off its goal'
        )
    if result['record_error']:
        console.print(f'the record is not complete: {result["record_error"]}', soft_wrap=True)
    console.print(f'record  {result["mcap"]}\nreport  {result["report"]}', soft_wrap=True)
