# SPDX-License-Identifier: Apache-2.0
"""The planar problem alone, solved on the paper's lattice."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.graph_search import graph_search
from microhand_planner.core.offset_curve import OffsetCurve, offset_curve
from microhand_planner.core.planar_problem import Node, PlanarProblem
from microhand_planner.core.rotation_lattice import IntArray, RotationLattice
from microhand_planner.core.search_result import Outcome, SearchResult
from microhand_planner.core.search_state import ABSENT, NDEG, Grasp
from microhand_planner.core.section import XY_PLANE
from microhand_planner.core.swap_search import swap_search


@dataclass(frozen=True)
class PlanarAnswer:
    """What the search found.

    Parameters
    ----------
    outcome : Outcome
        Found, no path, or interrupted.
    cost_deg : float or None
        Cost of the path [deg]; None: no path.
    reconfigurations : int or None
        Placements and removals.
    path : tuple of Node
        All grasps that the path passes through, from start to goal.
    expanded : int
        States expanded.
    """

    outcome: Outcome
    cost_deg: float | None
    reconfigurations: int | None
    path: tuple[Node, ...]
    expanded: int


def solve_planar(
    problem: PlanarProblem,
    interrupt: IntArray | None = None,
    *,
    curve: OffsetCurve | None = None,
) -> PlanarAnswer:
    """Find the cheapest path by the paper's cost.

    Parameters
    ----------
    problem : PlanarProblem
        The problem.
    interrupt : (2,) int64, optional
        See `interruption`.
    curve : OffsetCurve, optional
        Path of the tip's centre around the problem's ellipse; by default it is made here.

    Returns
    -------
    PlanarAnswer

    Examples
    --------
    The rotation by 220 deg of [Kumar2021] Table 3, to the cheapest of its six goals:

    >>> answer = solve_planar(PlanarProblem(
    ...     (16.22, 11.586), 74, 20.0, 19, start=(1, 38, 0, 1), goal=(38, 0, 1, 12)))
    >>> answer.cost_deg, answer.reconfigurations
    (1880.0, 8)
    """
    if curve is None:
        section = ellipse_section(*problem.ellipse_um, XY_PLANE)
        curve = offset_curve(section, problem.finger.radius_um)
    lattice = paper_lattice(
        curve,
        problem.contacts,
        problem.step_deg,
        problem.orientations,
        problem.start[3],
        problem.goal[3],
    )
    search = swap_search if problem.law.stick_uN > 0.0 else graph_search
    result = search(
        lattice,
        problem.finger,
        problem.law,
        _tracks(problem.start, problem.contacts),
        _tracks(problem.goal, problem.contacts),
        interchangeable=False,
        interrupt=interrupt,
    )
    if result.outcome is not Outcome.FOUND:
        return PlanarAnswer(result.outcome, None, None, (), result.expanded)
    path = _nodes(result, problem.contacts)
    changes = sum(
        (one > 0) != (other > 0)
        for before, after in itertools.pairwise(path)
        for one, other in zip(before[:3], after[:3], strict=True)
    )
    return PlanarAnswer(result.outcome, result.cost_ndeg / NDEG, changes, path, result.expanded)


def paper_lattice(
    curve: OffsetCurve,
    contacts: int,
    step_deg: float,
    orientations: int,
    start: int,
    goal: int,
) -> RotationLattice:
    """Return the paper's lattice of numbered contacts and orientations.

    Parameters
    ----------
    curve : OffsetCurve
        Path of the tip's centre.
    contacts, orientations : int
        How many there are.
    step_deg : float
        Between two orientations [deg].
    start, goal : int
        Orientations, from 1.
    """
    spacing_rad = curve.length_rad / contacts
    phase_rad = np.arange(contacts, dtype=np.float64) * spacing_rad
    points = curve.at(phase_rad)
    theta_deg = np.arange(orientations) * step_deg
    tracks = np.arange(contacts)
    return RotationLattice(
        contacts=contacts,
        spacing_rad=spacing_rad,
        theta_rad=np.radians(theta_deg),
        theta_ndeg=np.round(theta_deg * NDEG).astype(np.int64),
        start=start - 1,
        goal=goal - 1,
        track_unit=tracks.astype(np.float64),
        sample_of=(tracks[:, None] - np.arange(orientations)[None, :]) % contacts,
        interior=np.zeros(max(0, orientations - 1), dtype=np.int64),
        block=contacts,
        phase_rad=phase_rad,
        centre_um=points.centre_um.copy(),
        contact_um=points.contact_um.copy(),
        normal=points.normal.copy(),
        phase_per_angle=spacing_rad / math.radians(step_deg),
        usable=points.admissible.copy(),
    )


def _tracks(node: Node, contacts: int) -> Grasp:
    """Return the tracks, i + l, of a node; they do not change while the fingers roll."""
    first, second, third = (
        (contact - 1 + node[3] - 1) % contacts if contact > 0 else ABSENT for contact in node[:3]
    )
    return first, second, third


def _nodes(result: SearchResult, contacts: int) -> tuple[Node, ...]:
    """Return the nodes of a path; between the two ends of a swap all three fingers are placed."""
    nodes: list[Node] = []
    before: list[int] | None = None
    for *tracks, orientation in result.states.tolist():
        if before is not None and sum(a != b for a, b in zip(before, tracks, strict=True)) == 2:
            both = [max(a, b) for a, b in zip(before, tracks, strict=True)]
            nodes.append(_node(both, orientation, contacts))
        nodes.append(_node(tracks, orientation, contacts))
        before = tracks
    return tuple(nodes)


def _node(tracks: list[int], orientation: int, contacts: int) -> Node:
    """Return the paper's numbers of a state."""
    first, second, third = (
        0 if track == ABSENT else (track - orientation) % contacts + 1 for track in tracks
    )
    return first, second, third, orientation + 1
