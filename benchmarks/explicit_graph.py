# SPDX-License-Identifier: Apache-2.0
"""The planar problem of [Kumar2021] §3.3 as an explicit graph, for libraries that want one.

Every stable grasp ``[i j k]`` at every orientation is a node; rolls, placements and removals are
edges. Vectorised throughout, so that the peers do not wait for Python loops of ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np

from microhand_planner.core.offset_curve import ContactPoints, OffsetCurve
from microhand_planner.core.planar_problem import Node, PlanarProblem
from microhand_planner.core.removal import grip_window_uN

RECONFIGURATION_DEG = 180.0
# [Kumar2021] Table 1: fingers used in one of the two grasps only, fingers on their goal's track
LEFT = np.array([[6, 4, 0], [5, 3, 1], [4, 2, 2]])
# the same for the best of six goals: fingers placed, less two; fingers on a goal's track
LEFT_OF_ANY = np.array([[4, 2, 0], [5, 3, 1]])


@dataclass(frozen=True)
class ExplicitGraph:
    """Nodes are numbered ``orientation * len(grasps) + grasp``.

    Parameters
    ----------
    problem : PlanarProblem
        What it was made for.
    alike : bool
        True: grasps that differ only in the names of their fingers are one node.
    grasps : (g, 3) int
        Contacts of fingers 1, 2, 3, from 1; 0: not used. Descending if fingers are alike.
    source, target : (e,) int
        Directed edges.
    cost_deg : (e,) float
        Their costs.
    """

    problem: PlanarProblem
    alike: bool
    grasps: np.ndarray
    source: np.ndarray
    target: np.ndarray
    cost_deg: np.ndarray

    def __len__(self) -> int:
        """Return the number of nodes."""
        return len(self.grasps) * self.problem.orientations

    def number(self, node: Node) -> int:
        """Return the number of ``[i j k l]``."""
        *placed, orientation = node
        if self.alike:
            placed = sorted(placed, reverse=True)
        grasp = np.flatnonzero((self.grasps == placed).all(axis=1))[0]
        return int((orientation - 1) * len(self.grasps) + grasp)

    def heuristic_deg(self) -> np.ndarray:
        """Return [Kumar2021] Eq. 13 for all nodes, (n,) [deg]."""
        problem = self.problem
        *placed, l_goal = problem.goal
        goal = np.array([(contact + l_goal) % problem.contacts for contact in placed])
        goal[np.array(placed) == 0] = -1
        estimates = []
        for orientation in range(1, problem.orientations + 1):
            # a finger that rolls keeps i + l (Eq. 14-16)
            track = np.where(self.grasps > 0, (self.grasps + orientation) % problem.contacts, -1)
            used = track >= 0
            if self.alike:
                on_goal = (used & np.isin(track, goal[goal >= 0])).sum(axis=1)
                left = LEFT_OF_ANY[used.sum(axis=1) - 2, on_goal]
            else:
                in_one_only = (used != (goal >= 0)).sum(axis=1)
                left = LEFT[in_one_only, (used & (track == goal)).sum(axis=1)]
            rolling_deg = 2.0 * abs(orientation - l_goal) * problem.step_deg
            estimates.append(rolling_deg + RECONFIGURATION_DEG * left)
        return np.concatenate(estimates)


def explicit_graph(
    problem: PlanarProblem, curve: OffsetCurve, *, alike: bool = False
) -> ExplicitGraph:
    """Build all nodes and edges of a planar problem with adhesion."""
    c = problem.contacts
    points = curve.at(np.arange(c) * (curve.length_rad / c))
    apart_um = np.linalg.norm(points.centre_um[:, None] - points.centre_um[None, :], axis=2)
    together = apart_um >= problem.finger.min_distance_um - 1e-9
    if alike:
        together &= np.tri(c, k=-1, dtype=bool)

    triples = np.argwhere(together[:, :, None] & together[:, None, :] & together[None, :, :])
    pairs = [np.insert(np.argwhere(together) + 1, free, 0, axis=1) for free in range(3)]
    grasps = np.concatenate([*(pairs[2:] if alike else pairs), triples + 1])
    number = np.full((c + 1, c + 1, c + 1), -1, dtype=np.int32)

    def numbers_of(contacts: np.ndarray) -> np.ndarray:
        named = -np.sort(-contacts, axis=1) if alike else contacts
        return number[named[:, 0], named[:, 1], named[:, 2]]

    number[grasps[:, 0], grasps[:, 1], grasps[:, 2]] = np.arange(len(grasps), dtype=np.int32)
    rolled = numbers_of(np.where(grasps > 0, (grasps - 2) % c + 1, 0))
    rolls = np.flatnonzero(rolled >= 0).astype(np.int32)
    roll_deg = (grasps[rolls] > 0).sum(axis=1) * problem.step_deg
    three = np.arange(len(grasps) - len(triples), len(grasps), dtype=np.int32)
    removable = _removable(triples, points, problem)

    layers = np.arange(problem.orientations, dtype=np.int32)[:, None] * np.int32(len(grasps))
    source, target, cost_deg = [], [], []

    def connect(here: np.ndarray, there: np.ndarray, price_deg: np.ndarray) -> None:
        source.append(here.ravel())
        target.append(there.ravel())
        cost_deg.append(np.broadcast_to(price_deg, here.shape).ravel())

    before, after = layers[:-1] + rolls, layers[1:] + rolled[rolls]
    connect(before, after, roll_deg)
    connect(after, before, roll_deg)
    regrasp_deg = np.array(RECONFIGURATION_DEG)
    for leave in range(3):
        two = numbers_of(np.where(np.arange(3) == leave, 0, triples + 1))
        may = removable[:, leave]
        connect(layers + two, layers + three, regrasp_deg)
        connect(layers + three[may], layers + two[may], regrasp_deg)
    return ExplicitGraph(
        problem, alike, grasps,
        np.concatenate(source), np.concatenate(target), np.concatenate(cost_deg),
    )  # fmt: skip


def _removable(triples: np.ndarray, points: ContactPoints, problem: PlanarProblem) -> np.ndarray:
    """Return which finger of each triple can be removed, (t, 3)."""
    law = problem.law
    return _verdicts(
        triples, points.contact_um, points.normal, law.friction, law.stick_uN, law.max_force_uN
    )


@nb.njit(cache=True)
def _verdicts(
    triples: np.ndarray,
    contact_um: np.ndarray,
    normal: np.ndarray,
    friction: float,
    pull_off_uN: float,
    max_force_uN: float,
) -> np.ndarray:  # pragma: no cover - compiled
    verdicts = np.zeros(triples.shape, dtype=np.bool_)
    stay_um = np.zeros((2, 2))
    stay_normal = np.zeros((2, 2))
    for row in range(len(triples)):
        for leave in range(3):
            for one in range(2):
                contact = triples[row, (leave + 1 + one) % 3]
                stay_um[one] = contact_um[contact]
                stay_normal[one] = normal[contact]
            gone = triples[row, leave]
            low, high = grip_window_uN(
                stay_um, stay_normal, contact_um[gone], normal[gone],
                friction, pull_off_uN, max_force_uN,
            )  # fmt: skip
            verdicts[row, leave] = low <= high
    return verdicts
