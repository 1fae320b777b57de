# SPDX-License-Identifier: Apache-2.0
"""[Kumar2021] Table 3: the ellipsoid's second rotation, to each of its six goals.

The paper gives no dimensions. c = 74 contact points fix the perimeter of the section, 87.96 µm;
an axis ratio of 1.4 fits Table 2 best.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from microhand_planner.core.planar import solve_planar
from microhand_planner.core.planar_problem import Node, PlanarProblem
from microhand_planner.evaluation.paper_figures import TABLE_3, SecondRotation

ELLIPSE_UM = (16.22, 11.586)
"""Semi-axes of the section [µm]."""
CONTACTS = 74
START: Node = (1, 38, 0, 1)

_STEP_DEG = 20.0
_ORIENTATIONS = 19


@dataclass(frozen=True)
class Table3Row:
    """The cheapest path to one goal, and the paper's figures.

    Parameters
    ----------
    goal : Node
        ``[i j k l]``.
    cost_deg : float or None
        Cost of the cheapest path [deg]; None: no path.
    reconfigurations : int or None
        Placements and removals in it.
    expanded : int
        States expanded: grasps of two fingers.
    time_s : float
        Wall time, section and contact points included [s].
    paper : SecondRotation
        The row of the paper.
    """

    goal: Node
    cost_deg: float | None
    reconfigurations: int | None
    expanded: int
    time_s: float
    paper: SecondRotation


def table3(clock: Callable[[], float] = time.perf_counter) -> Iterator[Table3Row]:
    """Find the cheapest path to each of the paper's six goals.

    Parameters
    ----------
    clock : callable
        Current time [s].

    Yields
    ------
    Table3Row
        As many as in `paper_figures.TABLE_3`.
    """
    solve_planar(_problem(TABLE_3[0].goal))  # loads the compiled search
    for paper in TABLE_3:
        problem = _problem(paper.goal)
        started = clock()
        answer = solve_planar(problem)
        yield Table3Row(
            goal=paper.goal,
            cost_deg=answer.cost_deg,
            reconfigurations=answer.reconfigurations,
            expanded=answer.expanded,
            time_s=clock() - started,
            paper=paper,
        )


def _problem(goal: Node) -> PlanarProblem:
    """Return the rotation by 220 deg to a goal."""
    return PlanarProblem(ELLIPSE_UM, CONTACTS, _STEP_DEG, _ORIENTATIONS, START, goal)
