# SPDX-License-Identifier: Apache-2.0
"""How far a tip's centre is from a solid, in and out of the section plane."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from microhand_planner.core.part import Part

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Point = tuple[float, float, float]

BLOCK = 16
"""Neighbouring points that are first tested together against a face."""


def distance_to_part(points_um: FloatArray, part: Part, at_most_um: float) -> FloatArray:
    """Return the distance of points from the surface of a part, up to a limit.

    Parameters
    ----------
    points_um : (k, 3) array
        Object frame [µm]; fast if neighbours in the array are neighbours in space.
    part : Part
        The solid. A point inside has a distance from its surface, too.
    at_most_um : float
        Faces further away than this are not looked at [µm].

    Returns
    -------
    (k,) array
        Distance to the nearest face [µm]; `at_most_um` if none is nearer.

    Examples
    --------
    >>> import trimesh
    >>> from microhand_planner.core.part import make_part
    >>> box = trimesh.creation.box(extents=[20.0, 10.0, 4.0])
    >>> points_um = np.array([[13.0, 0.0, 0.0], [0.0, 0.0, 50.0]])
    >>> distance_to_part(points_um, make_part('box', box.vertices, box.faces), 9.0).tolist()
    [3.0, 9.0]
    """
    points_um = np.array(points_um, dtype=np.float64, order='C')  # writable: one compiled kernel
    return np.asarray(_nearest(points_um, at_most_um, part.vertices_um, part.faces))


@njit(cache=True)
def _nearest(
    points: FloatArray, at_most: float, vertices: FloatArray, faces: IntArray
) -> FloatArray:
    """Test blocks of points, then single ones, against bounding spheres, then the faces."""
    count = len(points)
    blocks = (count + BLOCK - 1) // BLOCK
    block_middle, block_size = np.zeros((blocks, 3)), np.zeros(blocks)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for block in range(blocks):
        begin, end = block * BLOCK, min(count, (block + 1) * BLOCK)
        for axis in range(3):
            smallest = points[begin:end, axis].min()
            largest = points[begin:end, axis].max()
            block_middle[block, axis] = 0.5 * (smallest + largest)
            low[axis] = min(low[axis], smallest)
            high[axis] = max(high[axis], largest)
        for i in range(begin, end):
            away = _distance(_point(points, i), _point(block_middle, block))
            block_size[block] = max(block_size[block], away)
    nearest = np.full(count, at_most)
    for face in range(len(faces)):
        a = _point(vertices, faces[face, 0])
        b = _point(vertices, faces[face, 1])
        c = _point(vertices, faces[face, 2])
        middle = (
            (a[0] + b[0] + c[0]) / 3.0,
            (a[1] + b[1] + c[1]) / 3.0,
            (a[2] + b[2] + c[2]) / 3.0,
        )
        size = max(_distance(a, middle), _distance(b, middle), _distance(c, middle))
        reach = at_most + size
        far = False
        for axis in range(3):
            far |= middle[axis] > high[axis] + reach or middle[axis] < low[axis] - reach
        if far:
            continue
        for block in range(blocks):
            if _distance(middle, _point(block_middle, block)) > reach + block_size[block]:
                continue
            for i in range(block * BLOCK, min(count, (block + 1) * BLOCK)):
                p = _point(points, i)
                if _distance(middle, p) < nearest[i] + size:
                    nearest[i] = min(nearest[i], _to_triangle(p, a, b, c))
    return nearest


@njit(cache=True)
def _point(rows: FloatArray, row: int) -> Point:
    """Return a row of an (n, 3) array."""
    return rows[row, 0], rows[row, 1], rows[row, 2]


@njit(cache=True)
def _minus(p: Point, q: Point) -> Point:
    """Return p − q."""
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


@njit(cache=True)
def _dot(p: Point, q: Point) -> float:
    """Return p · q."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@njit(cache=True)
def _distance(p: Point, q: Point) -> float:
    """Return |p − q|."""
    d = _minus(p, q)
    return math.sqrt(_dot(d, d))


@njit(cache=True)
def _on(a: Point, ab: Point, share_b: float, ac: Point, share_c: float) -> Point:
    """Return a + share_b ab + share_c ac."""
    return (
        a[0] + share_b * ab[0] + share_c * ac[0],
        a[1] + share_b * ab[1] + share_c * ac[1],
        a[2] + share_b * ab[2] + share_c * ac[2],
    )


@njit(cache=True)
def _to_triangle(p: Point, a: Point, b: Point, c: Point) -> float:
    """Return the distance of a point from a triangle ([Ericson2005] 5.1.5)."""
    ab, ac = _minus(b, a), _minus(c, a)
    ap, bp, cp = _minus(p, a), _minus(p, b), _minus(p, c)
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return _distance(p, a)
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return _distance(p, b)
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return _distance(p, c)
    over_c = d1 * d4 - d3 * d2
    if over_c <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return _distance(p, _on(a, ab, d1 / (d1 - d3), ac, 0.0))
    over_b = d5 * d2 - d1 * d6
    if over_b <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return _distance(p, _on(a, ab, 0.0, ac, d2 / (d2 - d6)))
    over_a = d3 * d6 - d5 * d4
    if over_a <= 0.0 and d4 >= d3 and d5 >= d6:
        return _distance(p, _on(b, _minus(c, b), (d4 - d3) / ((d4 - d3) + (d5 - d6)), ac, 0.0))
    total = over_a + over_b + over_c
    return _distance(p, _on(a, ab, over_b / total, ac, over_c / total))
