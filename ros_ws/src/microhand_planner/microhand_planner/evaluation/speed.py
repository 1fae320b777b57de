# SPDX-License-Identifier: Apache-2.0
"""How long plans take: the rows of ``microhand bench``."""

from __future__ import annotations

import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.part import Part
from microhand_planner.core.planar import solve_planar
from microhand_planner.core.planar_problem import PlanarProblem
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.section_curves import SectionCurves, section_curves
from microhand_planner.evaluation.paper_figures import TABLE_4, WholeRotation
from microhand_planner.evaluation.table3 import CONTACTS, ELLIPSE_UM, START

Clock = Callable[[], float]

_STEP_DEG = 20.0
_FINER_STEPS_DEG = (10.0, 5.0, 2.0, 1.0)
_DEAREST_STEPS_DEG = (20.0, 10.0)
_ENOUGH_S = 1.0  # of measuring one case ...
_FEWEST_RUNS, _MOST_RUNS = 5, 51  # ... within these numbers of runs
_RANDOM_GOALS = 50
_SEED = 1
_COLD_RUNS = 3
_COLD_PROGRAM = """
from scipy.spatial.transform import Rotation
from microhand_planner.core.catalogue import find_part
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
goal = Pose.of((0, 0, 0), Rotation.from_euler('ZYZ', (80, 220, 100), degrees=True))
plan_reorientation(find_part('ellipsoid'), Pose(), goal, Finger(), ContactLaw(), SearchOptions())
"""


@dataclass(frozen=True)
class Timing:
    """Wall times of the same action [s].

    Parameters
    ----------
    runs : int
        How often it was run.
    median_s, fastest_s, slowest_s : float
        Of all runs [s].
    """

    runs: int
    median_s: float
    fastest_s: float
    slowest_s: float


@dataclass(frozen=True)
class BenchRow:
    """One line of the benchmark.

    Parameters
    ----------
    case : str
        What is measured.
    object_name : str
        Object of the catalogue.
    step_deg : float
        Δθ [deg].
    timing : Timing
        How long it took.
    paper_s : float or None
        What [Kumar2021] Table 4 needs for the rotations of this object [s].
    """

    case: str
    object_name: str
    step_deg: float
    timing: Timing
    paper_s: float | None = None

    @property
    def times_faster(self) -> float | None:
        """The paper's time over ours; the paper's computer is another one."""
        return None if self.paper_s is None else self.paper_s / self.timing.median_s


def measure(action: Callable[[], object], clock: Clock, *, warm: bool = True) -> Timing:
    """Run an action again and again.

    Parameters
    ----------
    action : callable
        What to measure.
    clock : callable
        Current time [s].
    warm : bool
        Run it once before, unmeasured.

    Returns
    -------
    Timing
        Of at least 5 and at most 51 runs, of about a second together.
    """
    if warm:
        action()
    times_s: list[float] = []
    while len(times_s) < _FEWEST_RUNS or (sum(times_s) < _ENOUGH_S and len(times_s) < _MOST_RUNS):
        started = clock()
        action()
        times_s.append(clock() - started)
    return summarised(times_s)


def summarised(times_s: list[float]) -> Timing:
    """Return the median and the range of measured times [s]."""
    return Timing(len(times_s), statistics.median(times_s), min(times_s), max(times_s))


def bench(
    find_part: Callable[[str], Part], clock: Clock = time.perf_counter
) -> Iterator[BenchRow]:
    """Measure the planner, row by row.

    Parameters
    ----------
    find_part : callable
        Name of an object to part, see `catalogue.find_part`.
    clock : callable
        Current time [s].

    Yields
    ------
    BenchRow
        `bench_size` of them.
    """
    finger = Finger()
    parts = {whole.object_name: find_part(whole.object_name) for whole in TABLE_4}
    curves = {name: section_curves(part, finger) for name, part in parts.items()}
    for whole in TABLE_4:
        yield _planned(whole, curves, _STEP_DEG, clock)
    for whole in TABLE_4:
        yield _from_mesh(whole, find_part, clock)
    for step_deg in _FINER_STEPS_DEG:
        for whole in TABLE_4:
            yield _planned(whole, curves, step_deg, clock)
    for whole in TABLE_4:
        yield _any_goals(whole, curves[whole.object_name], clock)
    for step_deg in _DEAREST_STEPS_DEG:
        yield _dearest_goal(step_deg, clock)
    yield _cold_process(clock)


def bench_size() -> int:
    """Return how many rows `bench` yields."""
    return (3 + len(_FINER_STEPS_DEG)) * len(TABLE_4) + len(_DEAREST_STEPS_DEG) + 1


def plan_whole(
    whole: WholeRotation, part: Part | SectionCurves, step_deg: float = _STEP_DEG
) -> object:
    """Plan the rotation of an object of [Kumar2021] Table 4, over all its decompositions."""
    turn = Rotation.from_euler('ZYZ', whole.angles_deg, degrees=True)
    options = SearchOptions(step_rad=math.radians(step_deg))
    goal = Pose.of((0.0, 0.0, 0.0), turn)
    return plan_reorientation(part, Pose(), goal, Finger(), ContactLaw(), options)


def _planned(
    whole: WholeRotation,
    curves: dict[str, SectionCurves],
    step_deg: float,
    clock: Clock,
) -> BenchRow:
    """Measure whole plans of a part whose curves are known."""
    part = curves[whole.object_name]
    timing = measure(lambda: plan_whole(whole, part, step_deg), clock)
    paper_s = _paper_s(whole) if step_deg == _STEP_DEG else None
    return BenchRow('plan', whole.object_name, step_deg, timing, paper_s)


def _from_mesh(whole: WholeRotation, find_part: Callable[[str], Part], clock: Clock) -> BenchRow:
    """Measure whole plans that begin with reading the mesh file."""
    timing = measure(lambda: plan_whole(whole, find_part(whole.object_name)), clock)
    return BenchRow('plan from mesh file', whole.object_name, _STEP_DEG, timing, _paper_s(whole))


def _any_goals(whole: WholeRotation, curves: SectionCurves, clock: Clock) -> BenchRow:
    """Measure one plan each for goals drawn evenly from all orientations."""
    goals = Rotation.random(_RANDOM_GOALS, rng=np.random.default_rng(_SEED))
    times_s = []
    for turn in goals:
        goal = Pose.of((0.0, 0.0, 0.0), turn)
        started = clock()
        plan_reorientation(curves, Pose(), goal, Finger(), ContactLaw(), SearchOptions())
        times_s.append(clock() - started)
    return BenchRow('plan to random goals', whole.object_name, _STEP_DEG, summarised(times_s))


def dearest_problem(step_deg: float) -> PlanarProblem:
    """Return the dearest of the six rotations of Table 3: every finger back on its place.

    Parameters
    ----------
    step_deg : float
        Δθ [deg]; there are as many more contacts and orientations as it is finer than 20 deg.
    """
    finer = round(_STEP_DEG / step_deg)
    contacts = CONTACTS * finer
    placed = (START[0], contacts // 2 + 1, 0)
    return PlanarProblem(
        ELLIPSE_UM,
        contacts,
        step_deg,
        orientations=18 * finer + 1,
        start=(*placed, 1),
        goal=(*placed, 11 * finer + 1),
    )


def _dearest_goal(step_deg: float, clock: Clock) -> BenchRow:
    """Measure the dearest planar rotation."""
    problem = dearest_problem(step_deg)
    timing = measure(lambda: solve_planar(problem), clock)
    return BenchRow("Table 3's dearest goal", 'ellipse', step_deg, timing)


def _cold_process(clock: Clock) -> BenchRow:
    """Measure a new Python process from its start to its end, with one plan in between."""
    times_s = []
    for _ in range(_COLD_RUNS):
        started = clock()
        subprocess.run([sys.executable, '-c', _COLD_PROGRAM], check=True)
        times_s.append(clock() - started)
    return BenchRow('plan in a new process', 'ellipsoid', _STEP_DEG, summarised(times_s))


def _paper_s(whole: WholeRotation) -> float:
    """Return the paper's time for an object, with adhesion [s]."""
    return sum(rotation.time_s for rotation in whole.with_adhesion)
