# SPDX-License-Identifier: Apache-2.0
"""Where a plane meets a mesh: closed loops of points on the surface that the facets stand for.

A facet lies inside a curved solid by up to h²/8R (edge h, radius R). So a point where the plane
crosses an edge is moved onto the curved edge that has the surface normals of both its ends (the
edge of a PN triangle, [Vlachos2001]). At creases nothing moves; within a plane face, where two
facets meet without a fold, there is no point at all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.errors import EmptySection
from microhand_planner.core.part import Part
from microhand_planner.core.section import Plane

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ON_PLANE = 1e-6
"""Vertices nearer to the plane, relative to the size, count as on it (float32 noise)."""
COPLANAR_COS = math.cos(3e-4)
"""Faces that differ less are one plane face; the edge between them is no feature (float32)."""
CREASE_COS = math.cos(math.radians(20.0) + 1e-6)
"""Faces that differ more meet in a crease."""
SMOOTH_COS = math.cos(math.radians(40.0))
"""Faces that differ less from an edge's normal are of the same smooth surface."""
STEEPEST_SIN = 0.35
"""An edge that leaves the tangent plane of its end more steeply is no part of a smooth surface."""
RULED_SHARE = 0.5
"""If area weights give less than this share of an edge's bow, a long straight edge meets short
facets at its ends: it does not bow."""
CLUSTER_SHARE = 0.15
"""Neighbouring crossings within this share of their edges from a common vertex are one."""


@dataclass(frozen=True)
class MeshLoop:
    """A closed loop in which a plane meets a mesh; one row per point.

    Parameters
    ----------
    points_um : (n, 2) array
        Plane coordinates [µm]; counter-clockwise around material.
    out_of_plane_sin : (n,) array
        Sine of the angle between surface normal and plane.
    facet_gap_um : float
        How far the points were moved off the facets, at most [µm].
    """

    points_um: FloatArray
    out_of_plane_sin: FloatArray
    facet_gap_um: float


def cut_mesh(part: Part, plane: Plane) -> list[MeshLoop]:
    """Cut a part along a plane through its origin.

    A vertex on the plane counts as above it, so a face in the plane is cut as the limit from
    below; every face that is cut has one edge going down and one going up, and loops close.

    Parameters
    ----------
    part : Part
        Watertight, outward.
    plane : Plane
        The plane.

    Raises
    ------
    EmptySection
        The part does not reach to both sides of the plane.
    """
    height_um = part.vertices_um @ plane.normal
    size_um = float(part.extents_um.max())
    height_um[np.abs(height_um) < ON_PLANE * size_um] = 0.0
    if not height_um.min() < 0.0 < height_um.max():
        axis = plane.axis
        raise EmptySection(
            'object origin',
            f'not inside {part.name}: the plane {axis} = 0 does not cut it ({axis} runs from'
            f' {(part.vertices_um @ plane.normal).min():.6g} to'
            f' {(part.vertices_um @ plane.normal).max():.6g} µm)',
            'an origin inside the object, for instance with the frame principal_axes',
        )
    edges, loops = _crossed_edges(part.faces, height_um >= 0.0)
    upper, lower, before, after = edges
    normal_before, normal_after = _face_normals(part, before), _face_normals(part, after)
    fold_cos = np.einsum('ij,ij->i', normal_before, normal_after)
    points_um, moved_um, normals, share = _on_surface(
        part, plane, height_um, upper, lower, _unit(normal_before + normal_after), fold_cos
    )
    result = []
    for loop in loops:
        folded = loop[fold_cos[loop] < COPLANAR_COS]
        keep = folded if len(folded) >= 3 else loop
        keep = keep[_one_of_each_cluster(share[keep], upper[keep], lower[keep])]
        result.append(
            MeshLoop(
                plane.to_plane(points_um[keep]),
                normals[keep] @ plane.normal,
                float(moved_um[keep].max()),
            )
        )
    return result


def _crossed_edges(
    faces: IntArray, above: NDArray[np.bool_]
) -> tuple[tuple[IntArray, IntArray, IntArray, IntArray], list[IntArray]]:
    """Find the edges that a plane crosses, and their order around each loop.

    Returns
    -------
    edges : four (k,) arrays of int
        For each edge its vertex above, its vertex below, and the faces that come before and
        after it around the loop.
    loops : list of arrays of int
        Edges in order, counter-clockwise around material seen from above.
    """
    side = above[faces]
    cut = np.flatnonzero(side.any(axis=1) & ~side.all(axis=1))
    corners, side = faces[cut], side[cut]
    next_side = np.roll(side, -1, axis=1)
    next_corner = np.roll(corners, -1, axis=1)
    down, up = side & ~next_side, ~side & next_side
    count = np.int64(len(above))
    entry = corners[down] * count + next_corner[down]
    leave = next_corner[up] * count + corners[up]
    order = np.argsort(entry)
    key = entry[order]
    # Edge number = rank of its key; the face that it enters is cut[order[number]].
    successor = np.searchsorted(key, leave[order])
    before = np.zeros(len(key), dtype=np.int64)
    before[successor] = cut[order]
    loops = []
    open_edges = np.ones(len(key), dtype=np.bool_)
    following = successor.tolist()
    for first in range(len(key)):
        if open_edges[first]:
            loop = [first]
            while following[loop[-1]] != first:
                loop.append(following[loop[-1]])
            open_edges[loop] = False
            loops.append(np.array(loop))
    return (key // count, key % count, before, cut[order]), loops


def _on_surface(
    part: Part,
    plane: Plane,
    height_um: FloatArray,
    upper: IntArray,
    lower: IntArray,
    edge_normal: FloatArray,
    fold_cos: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Put crossed edges' points on the smooth surface.

    Returns
    -------
    points_um : (k, 3) array
        Object frame [µm].
    moved_um : (k,) array
        Distance from the edge's chord [µm].
    normals : (k, 3) array
        Surface normals there.
    share : (k,) array
        Where on the edge, 0 at its upper vertex, 1 at its lower.
    """
    near_upper, wide_upper = _vertex_normals(part, upper, edge_normal)
    near_lower, wide_lower = _vertex_normals(part, lower, edge_normal)

    start_um = part.vertices_um[upper]
    edge_um = part.vertices_um[lower] - start_um
    rise_upper = np.einsum('ij,ij->i', edge_um, near_upper)
    rise_lower = np.einsum('ij,ij->i', edge_um, near_lower)
    bulge_um = rise_lower - rise_upper
    wide_bulge_um = np.einsum('ij,ij->i', edge_um, wide_lower - wide_upper)
    steepest = np.maximum(np.abs(rise_upper), np.abs(rise_lower))
    sharp = fold_cos < CREASE_COS
    sharp |= steepest > STEEPEST_SIN * np.linalg.norm(edge_um, axis=1)
    sharp |= wide_bulge_um * bulge_um < RULED_SHARE * bulge_um**2
    bow_upper = np.where(sharp, 0.0, -rise_upper)[:, None] * near_upper
    bow_lower = np.where(sharp, 0.0, rise_lower)[:, None] * near_lower

    # The bow is small beside the edge: a few rounds of "shift the crossing by the height of the
    # bow" put the point back on the plane.
    drop_um = height_um[upper] - height_um[lower]
    share = height_um[upper] / drop_um
    for _ in range(4):
        bow_um = _bow(share, bow_upper, bow_lower)
        share = np.clip((height_um[upper] + bow_um @ plane.normal) / drop_um, 0.0, 1.0)
    bow_um = _bow(share, bow_upper, bow_lower)
    points_um = start_um + share[:, None] * edge_um + bow_um
    normals = _unit((1.0 - share)[:, None] * near_upper + share[:, None] * near_lower)
    return points_um, np.linalg.norm(bow_um, axis=1), normals, share


def _bow(share: FloatArray, upper: FloatArray, lower: FloatArray) -> FloatArray:
    """Return the offset of a cubic edge from its chord, given its offsets' slopes at the ends."""
    rest = 1.0 - share
    return (share * rest)[:, None] * (rest[:, None] * upper + share[:, None] * lower)


def _unit(vectors: NDArray[np.floating[Any]]) -> FloatArray:
    """Return vectors of length 1; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=1)
    return vectors / np.where(length > 0.0, length, 1.0)[:, None]


def _face_normals(part: Part, faces: IntArray) -> FloatArray:
    """Return outward unit normals of faces, (k, 3)."""
    corners = part.vertices_um[part.faces[faces]]
    return _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _vertex_normals(
    part: Part, vertices: IntArray, towards: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return normals at vertices (k,), from the faces that are smooth with `towards`.

    Returns
    -------
    near, wide : (k, 3) arrays
        Weighted as in [Max1999], exact on a sphere, where small faces count most; and weighted
        by area, where large ones do.
    """
    wanted = np.zeros(len(part.vertices_um), dtype=np.bool_)
    wanted[vertices] = True
    faces = part.faces[wanted[part.faces].any(axis=1)]
    corners = part.vertices_um[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    side_um2 = ((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=2)
    area = np.linalg.norm(cross, axis=1)
    weight = area[:, None] / np.maximum(side_um2 * np.roll(side_um2, 1, axis=1), 1e-300)

    # Corners of faces sorted by vertex; each asked vertex runs over its own stretch.
    order = np.argsort(faces.ravel(), kind='stable')
    sorted_vertices = faces.ravel()[order]
    first = np.searchsorted(sorted_vertices, vertices, side='left')
    count = np.searchsorted(sorted_vertices, vertices, side='right') - first
    asked = np.repeat(np.arange(len(vertices)), count)
    within = np.arange(len(asked)) - np.repeat(np.cumsum(count) - count, count)
    corner = order[np.repeat(first, count) + within]
    normal = _unit(cross)[corner // 3]
    smooth = np.einsum('ij,ij->i', normal, towards[asked]) > SMOOTH_COS
    result = []
    for values in (weight.ravel(), np.repeat(area, 3)):
        total = np.zeros((len(vertices), 3))
        np.add.at(total, asked, np.where(smooth, values[corner], 0.0)[:, None] * normal)
        lonely = ~total.any(axis=1)
        total[lonely] = towards[lonely]
        result.append(_unit(total))
    return result[0], result[1]


def _one_of_each_cluster(share: FloatArray, upper: IntArray, lower: IntArray) -> IntArray:
    """Thin out a loop where the plane passes close by a vertex: keep the crossing nearest to it.

    Around such a vertex the plane crosses several edges almost at one point; their distances
    are too short to carry a direction.
    """
    near_upper = share < CLUSTER_SHARE
    near_lower = share > 1.0 - CLUSTER_SHARE
    vertex = np.where(near_upper, upper, np.where(near_lower, lower, -1))
    distance = np.where(near_upper, share, 1.0 - share)
    begins = (vertex == -1) | (vertex != np.roll(vertex, 1))
    if not begins.any():
        return np.arange(len(share))
    shift = int(begins.argmax())
    number = np.cumsum(np.roll(begins, -shift)) - 1
    order = np.lexsort((np.roll(distance, -shift), number))
    first = np.flatnonzero(np.diff(number[order], prepend=-1))
    return np.sort((order[first] + shift) % len(share))
