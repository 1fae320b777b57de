# SPDX-License-Identifier: Apache-2.0
"""The mesh in a record, or of the catalogue → triangles of the object, few enough to be shown."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from mcap.records import Attachment
from numpy.typing import NDArray

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import BadRequest
from microhand_planner.core.part import FORMATS, Frame, Part, make_part
from microhand_planner.core.plan import Plan

_UNITS_UM = (1.0, 1e3, 1e6, 1e-3)
_FRAMES: tuple[Frame, ...] = ('as_given', 'principal_axes')


@dataclass(frozen=True)
class ObjectMesh:
    """Surface of the object.

    Attributes
    ----------
    vertices_um : (n, 3) array
        Object frame.
    faces : (m, 3) array of int
        Counter-clockwise seen from outside.
    proven : bool
        Whether it is, by its hash, the object that the plan was made for.
    """

    vertices_um: NDArray[np.float64]
    faces: NDArray[np.int64]
    proven: bool

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        self.vertices_um.setflags(write=False)
        self.faces.setflags(write=False)


def object_mesh(
    attachments: Iterable[Attachment], plan: Plan | None, unit_um: float | None = None
) -> ObjectMesh | None:
    """Return the mesh of the object of a run; None: the record has none, nor the catalogue.

    The plan's hash decides of which unit and in which frame a mesh is meant. Without an attached
    one the catalogue's object of that name is taken, if it is the same.

    Parameters
    ----------
    attachments : iterable of Attachment
        Files kept in the record.
    plan : Plan or None
        What was executed.
    unit_um : float, optional
        What is known of the unit of an attached mesh [µm].
    """
    units_um = _UNITS_UM if unit_um is None else (unit_um, *_UNITS_UM)
    for attachment in attachments:
        kind = attachment.name.lower().rpartition('.')[2]
        if (
            kind in FORMATS
            and (found := _attached(attachment.data, kind, plan, units_um)) is not None
        ):
            return found
    if plan is None:
        return None
    try:
        part = find_part(plan.object_name)
    except BadRequest:
        return None
    return _mesh(part, True) if part.sha256 == plan.object_sha256 else None


def simplified(mesh: ObjectMesh, most_faces: int) -> ObjectMesh:
    """Return a mesh of at most so many faces: vertices that share a cell of a grid become one.

    Parameters
    ----------
    mesh : ObjectMesh
        As it is.
    most_faces : int
        At least some hundreds.
    """
    size_um = float(np.ptp(mesh.vertices_um, axis=0).max())
    cells = 256
    made = mesh
    while len(made.faces) > most_faces:
        cells = cells * 3 // 4
        keys = np.round((mesh.vertices_um - mesh.vertices_um.min(axis=0)) * (cells / size_um))
        _, first, to = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        faces = to.reshape(-1)[mesh.faces]
        whole = (
            (faces[:, 0] != faces[:, 1])
            & (faces[:, 1] != faces[:, 2])
            & (faces[:, 2] != faces[:, 0])
        )
        faces = np.unique(_least_first(faces[whole]), axis=0)
        made = ObjectMesh(mesh.vertices_um[first], faces, mesh.proven)
    return made


def _attached(
    data: bytes, kind: str, plan: Plan | None, units_um: Sequence[float]
) -> ObjectMesh | None:
    """Read an attached mesh; None: it cannot be read."""
    try:
        read = trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False)
        vertices = np.array(read.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(read.faces, dtype=np.int64).reshape(-1, 3)
    except Exception:  # trimesh raises anything on damaged content
        return None
    for unit_um in units_um:
        for frame in _FRAMES:
            try:
                part = make_part('object', vertices * unit_um, faces, frame=frame)
            except BadRequest:
                continue
            if plan is not None and part.sha256 == plan.object_sha256:
                return _mesh(part, True)
    try:
        return _mesh(make_part('object', vertices, faces), False)
    except BadRequest:
        return None


def _mesh(part: Part, proven: bool) -> ObjectMesh:
    return ObjectMesh(np.array(part.vertices_um), np.array(part.faces), proven)


def _least_first(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Turn the corners of each face, so that equal faces are equal rows."""
    turn = np.argmin(faces, axis=1)[:, None]
    return np.take_along_axis(faces, (np.arange(3) + turn) % 3, axis=1)
