# SPDX-License-Identifier: Apache-2.0
"""From a soup of triangles to the closed, outward surface of one solid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from microhand_planner.core.errors import InvalidMesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MERGE_GRIDS = (1e-7, 1e-5)
"""Grids, relative to the size, on which vertices merge: the noise of float32; then that of text
with six digits."""
LEAST_FILL = 1e-9
"""Smallest share of its bounding box that a solid fills."""


def outward_solid(
    name: str, vertices_um: FloatArray, faces: IntArray
) -> tuple[FloatArray, IntArray]:
    """Merge vertices and return the surface of one solid, normals outward.

    Returns
    -------
    vertices_um : (n, 3) array
        Sorted by coordinate.
    faces : (m, 3) array of int
        Sorted, smallest index first in each.

    Raises
    ------
    InvalidMesh
        The surface is open, inconsistent, empty, or bounds several bodies.
    """
    for grid in MERGE_GRIDS:
        merged_um, merged = _merge(vertices_um, faces, grid)
        open_edges = _open_edges(merged)
        if open_edges == 0:
            break
    if open_edges:
        raise InvalidMesh(
            'object',
            f'{name}, not watertight: {open_edges} of its {3 * len(merged) // 2} edges do not'
            ' join two faces of equal orientation',
            'a mesh that closes around its volume',
        )
    return merged_um, _one_body(name, merged_um, merged)


def signed_volumes_um3(vertices_um: FloatArray, faces: IntArray) -> FloatArray:
    """Return the volume of the tetrahedron between the mesh's centre and each face, (m,)."""
    corners = (vertices_um - vertices_um.mean(axis=0))[faces]
    cross = np.cross(corners[:, 1], corners[:, 2])
    return np.asarray(np.einsum('ij,ij->i', corners[:, 0], cross) / 6.0)


def _merge(vertices_um: FloatArray, faces: IntArray, grid: float) -> tuple[FloatArray, IntArray]:
    """Merge vertices that share a cell of the grid; drop faces that lose their area by it."""
    used, faces = np.unique(faces, return_inverse=True)
    vertices_um, faces = vertices_um[used], faces.reshape(-1, 3)
    cell = np.rint(vertices_um / (grid * np.ptp(vertices_um, axis=0).max())).astype(np.int64)
    order = np.lexsort(cell.T[::-1])
    differs = np.any(cell[order[1:]] != cell[order[:-1]], axis=1)
    number = np.zeros(len(order), dtype=np.int64)
    number[order] = np.concatenate([[0], np.cumsum(differs)])
    faces = number[faces]
    first = order[np.concatenate([[True], differs])]
    distinct = (
        (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    )
    faces = faces[distinct]
    shift = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (np.arange(3) + shift) % 3, axis=1)
    return vertices_um[first], faces[np.lexsort(faces.T[::-1])]


def _open_edges(faces: IntArray) -> int:
    """Count directed edges without exactly one partner in the other direction."""
    if len(faces) == 0:
        return 1
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max()) + 1
    there, back = np.sort(start * count + end), np.sort(end * count + start)
    if np.array_equal(there, back) and (np.diff(there) > 0).all():
        return 0
    repeated = int((np.diff(there) == 0).sum())
    return max(1, repeated + int((~np.isin(there, back)).sum()))


def _one_body(name: str, vertices_um: FloatArray, faces: IntArray) -> IntArray:
    """Turn the faces outward; refuse anything but one body, which may have cavities."""
    edges = coo_array(
        (np.ones(3 * len(faces)), (faces.ravel(), np.roll(faces, -1, axis=1).ravel())),
        shape=(len(vertices_um), len(vertices_um)),
    )
    _, label = connected_components(edges, directed=False)
    volume = np.bincount(label[faces[:, 0]], signed_volumes_um3(vertices_um, faces))
    outer = int(np.abs(volume).argmax())
    box = np.prod(np.ptp(vertices_um, axis=0))
    if abs(volume[outer]) < LEAST_FILL * box:
        raise InvalidMesh('object', f'{name}, which has no volume', 'a solid with a volume')
    if volume[outer] < 0.0:
        volume, faces = -volume, faces[:, [0, 2, 1]]
        faces = faces[np.lexsort(faces.T[::-1])]
    low, high = vertices_um[label == outer].min(axis=0), vertices_um[label == outer].max(axis=0)
    inside = ((vertices_um > low) & (vertices_um < high)).all(axis=1)
    if (volume > 0.0).sum() > 1 or not inside[label != outer].all():
        raise InvalidMesh('object', f'{name}, which is {len(volume)} bodies', 'one body')
    return faces
