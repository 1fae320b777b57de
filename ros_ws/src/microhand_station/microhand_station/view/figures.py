# SPDX-License-Identifier: Apache-2.0
"""What is drawn in the scene, as arrays of points in µm: ways of tips, forces, and the object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh

from microhand_planner.core.part import Part
from microhand_planner.core.plan import FINGERS, Plan
from microhand_planner.core.pose import FloatArray
from microhand_station.view.snapshot import Contact

IntArray = npt.NDArray[np.int64]

UM_PER_UN = 4.0
"""Length of the arrow of 1 µN [µm]."""
EDGE_RAD = math.radians(25.0)
"""Faces that meet at a larger angle have an edge between them [rad]."""


@dataclass(frozen=True, eq=False)
class Figure:
    """A body as it is drawn: its corners are doubled at edges, so that edges look sharp.

    Parameters
    ----------
    vertices_um : (n, 3) float
        Object frame [µm].
    faces : (m, 3) int
        Corners of triangles.
    """

    vertices_um: FloatArray
    faces: IntArray


def figure_of(part: Part) -> Figure:
    """Return how a part is drawn."""
    return figure_of_mesh(part.vertices_um, part.faces)


def figure_of_mesh(vertices_um: FloatArray, faces: IntArray) -> Figure:
    """Return how a body is drawn.

    Parameters
    ----------
    vertices_um : (n, 3) float
        Object frame [µm].
    faces : (m, 3) int
        Counter-clockwise seen from outside.
    """
    mesh = trimesh.Trimesh(vertices_um, faces, process=False)
    shaded = trimesh.graph.smooth_shade(mesh, angle=EDGE_RAD)
    return Figure(np.asarray(shaded.vertices), np.asarray(shaded.faces))


def tip_ways(plan: Plan) -> list[FloatArray]:
    """Return the way of each tip through a plan, (k, 2, 3) pieces, station frame [µm]."""
    if not plan.steps:
        return [np.zeros((0, 2, 3))] * FINGERS
    tips_um = np.concatenate([step.tip_um for step in plan.steps])
    return [_pieces(tips_um[:, finger]) for finger in range(FINGERS)]


def _pieces(points_um: FloatArray) -> FloatArray:
    """Return the pieces between points, without those that lead nowhere."""
    pieces = np.stack([points_um[:-1], points_um[1:]], axis=1)
    length_um = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
    return np.asarray(pieces[length_um > 0.0])


def force_arrow(contact: Contact) -> FloatArray:
    """Return the arrow of a force on the object, from tail to head, (2, 3), station frame [µm].

    A push ends where it acts, and a pull begins there: so the arrow is outside of the object.
    """
    shaft_um = UM_PER_UN * contact.force_uN
    if contact.normal_uN >= 0.0:
        return np.stack([contact.point_um - shaft_um, contact.point_um])
    return np.stack([contact.point_um, contact.point_um + shaft_um])
