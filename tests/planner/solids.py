# SPDX-License-Identifier: Apache-2.0
"""Solids for the geometry tests, as vertices and faces, and distances by brute force."""

import numpy as np
import trimesh
from scipy.spatial import KDTree

from microhand_planner.core.part import make_part


def prism(polygon_um, half_height_um):
    """Extrude a polygon, star-shaped about the origin, along Z; caps are fans."""
    polygon_um = np.asarray(polygon_um, dtype=float)
    n = len(polygon_um)
    i, j = np.arange(n), (np.arange(n) + 1) % n
    top = np.column_stack([polygon_um, np.full(n, half_height_um)])
    bottom = top * [1.0, 1.0, -1.0]
    centres = [[0.0, 0.0, half_height_um], [0.0, 0.0, -half_height_um]]
    faces = [
        np.column_stack([i, j, np.full(n, 2 * n)]),
        np.column_stack([n + j, n + i, np.full(n, 2 * n + 1)]),
        np.column_stack([i, n + i, n + j]),
        np.column_stack([i, n + j, j]),
    ]
    return np.vstack([top, bottom, centres]), np.vstack(faces)


def joined(*boxes_um):
    """Return the solid made of boxes that share whole faces, on the grid of all their sides.

    Each box is ((x0, x1), (y0, y1), (z0, z1)). Every grid cell within a box is filled; the faces
    between filled and empty cells are the surface.
    """
    boxes = np.array(boxes_um, dtype=float)
    lines = [np.unique(boxes[:, axis]) for axis in range(3)]
    middles = [0.5 * (line[1:] + line[:-1]) for line in lines]
    x, y, z = np.meshgrid(*middles, indexing='ij')
    filled = np.zeros(x.shape, dtype=bool)
    for (x0, x1), (y0, y1), (z0, z1) in boxes:
        filled |= (x > x0) & (x < x1) & (y > y0) & (y < y1) & (z > z0) & (z < z1)
    padded = np.pad(filled, 1)
    triangles = []
    for cell in np.argwhere(filled):
        low = np.array([lines[axis][cell[axis]] for axis in range(3)])
        high = np.array([lines[axis][cell[axis] + 1] for axis in range(3)])
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for side, level in ((-1, low), (1, high)):
                neighbour = cell + 1
                neighbour[axis] += side
                if padded[tuple(neighbour)]:
                    continue
                corners = np.tile(low, (4, 1))
                corners[:, axis] = level[axis]
                corners[[1, 2], u] = high[u]
                corners[[2, 3], v] = high[v]
                square = corners if side > 0 else corners[::-1]
                triangles += [square[[0, 1, 2]], square[[0, 2, 3]]]
    triangles = np.array(triangles)
    return triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def ellipsoid(semi_axes_um, subdivisions=4, rotation=None):
    """Return an ellipsoid of 20·4^subdivisions faces; `rotation` turns only the facets."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    vertices = sphere.vertices if rotation is None else sphere.vertices @ rotation.T
    return make_part('ellipsoid', vertices * np.array(semi_axes_um), sphere.faces)


def random_rotation(seed):
    """Return a random rotation matrix (or a reflection: facets do not mind)."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]


def outline_points_um(section, spacing_rad=0.02, per_arc=8):
    """Return dense points of an outline, (n, 2)."""
    arcs = section.arcs.split(spacing_rad)
    row = np.repeat(np.arange(len(arcs)), per_arc)
    return arcs.points(row, np.tile(np.arange(per_arc) / per_arc, len(arcs)))[0]


def distance_um(points_um, outline_um):
    """Return the distance of each point (k, 2) from the nearest outline point."""
    return KDTree(outline_um).query(points_um)[0]
