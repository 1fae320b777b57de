# SPDX-License-Identifier: Apache-2.0
"""A part: one solid of plausible size, read from a mesh file, in µm and in its object frame."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import NDArray

from microhand_planner.core.errors import InvalidMesh, InvalidParameter, UnknownObject
from microhand_planner.core.parameters import check_number
from microhand_planner.core.principal_axes import to_principal_axes
from microhand_planner.core.solid import extents, outward_solid

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Frame = Literal['as_given', 'principal_axes']

FORMATS = ('stl', 'obj', 'ply', 'off', 'glb', '3mf')
FRAMES = ('as_given', 'principal_axes')
SMALLEST_EXTENT_UM = 0.1
LARGEST_EXTENT_UM = 1e4
MOST_FACES = 5_000_000
HASH_GRID_UM = 1e-6


@dataclass(frozen=True)
class Part:
    """One solid, bounded by a closed triangle mesh with outward normals.

    Parameters
    ----------
    name : str
        What the user calls it.
    vertices_um : (n, 3) array
        Object frame [µm]; sorted, so that the order in a file does not matter.
    faces : (m, 3) array of int
        Counter-clockwise seen from outside.
    sha256 : str
        Over the vertices, rounded to 1 pm, and the faces.
    """

    name: str
    vertices_um: FloatArray
    faces: IntArray
    sha256: str

    @property
    def extents_um(self) -> FloatArray:
        """Size along the axes of the object frame, (3,) [µm]."""
        return extents(self.vertices_um)


def load_part(
    path: str | Path,
    *,
    unit_um: float = 1.0,
    frame: Frame = 'as_given',
    name: str | None = None,
) -> Part:
    """Read a part from a mesh file.

    Parameters
    ----------
    path : path
        An STL, OBJ, PLY, OFF, GLB or 3MF file. Its bodies are joined; materials, and any unit
        that the file states, are ignored.
    unit_um : float
        Length of one unit of the file [µm].
    frame : {'as_given', 'principal_axes'}
        Object frame: the file's own, or the principal axes of inertia through the centre of mass.
    name : str, optional
        Name of the part; by default the file's.

    Raises
    ------
    UnknownObject
        There is no such file, it cannot be read, or it has another format.
    InvalidMesh
        It does not bound one solid of plausible size; see `make_part`.
    InvalidNumber, InvalidParameter
        The unit is not a positive number, or the frame is unknown.
    """
    path = Path(path)
    check_number('unit', unit_um, low=0.0, low_open=True)
    file_type = path.suffix.lower().lstrip('.')
    if file_type not in FORMATS:
        raise UnknownObject('object', path, f'a mesh file ending in one of {", ".join(FORMATS)}')
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise UnknownObject('object', f'{path} ({reason})', 'a readable mesh file') from error
    try:
        # From memory: a file then cannot make the reader open others. Unprocessed: trimesh would
        # merge vertices by an absolute tolerance, in the file's unit.
        mesh = trimesh.load_mesh(io.BytesIO(content), file_type=file_type, process=False)
        vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # trimesh raises anything on damaged content
        raise InvalidMesh(
            'object', f'{path} ({type(error).__name__}: {error})', f'a valid {file_type} mesh'
        ) from error
    return make_part(name or path.stem, vertices * unit_um, faces, frame=frame, unit_um=unit_um)


def make_part(
    name: str,
    vertices_um: FloatArray,
    faces: IntArray,
    *,
    frame: Frame = 'as_given',
    unit_um: float = 1.0,
) -> Part:
    """Check a triangle mesh and return it as a part.

    Equal vertices are merged and triangles without area removed. A mesh that is inside out is
    turned; cavities stay.

    Parameters
    ----------
    name : str
        What the user calls it.
    vertices_um : (n, 3) array
        [µm].
    faces : (m, 3) array of int
        Indices of vertices.
    frame : {'as_given', 'principal_axes'}
        See `load_part`.
    unit_um : float
        The unit that the vertices were read in, for the message about implausible sizes [µm].

    Raises
    ------
    InvalidMesh
        No faces, or too many; NaN; an extent outside 0.1 µm to 10 mm; not watertight; several
        bodies; no volume.
    InvalidParameter
        The frame is unknown.

    Examples
    --------
    >>> box = trimesh.creation.box(extents=[20.0, 10.0, 5.0])
    >>> make_part('box', box.vertices, box.faces).extents_um.tolist()
    [20.0, 10.0, 5.0]
    """
    if frame not in FRAMES:
        raise InvalidParameter('frame', frame, ' or '.join(FRAMES))
    if not 4 <= len(faces) <= MOST_FACES:
        raise InvalidMesh('object', f'{name} with {len(faces)} faces', f'4 to {MOST_FACES} faces')
    if faces.min() < 0 or faces.max() >= len(vertices_um):
        raise InvalidMesh('object', f'{name} with faces on missing vertices', 'a complete mesh')
    vertices_um = np.asarray(vertices_um, dtype=np.float64)
    if not np.isfinite(vertices_um).all():
        raise InvalidMesh('object', f'{name} with NaN or infinite vertices', 'finite vertices')
    _check_size(name, extents(vertices_um[faces.ravel()]), unit_um)
    vertices_um, faces = outward_solid(name, vertices_um, np.asarray(faces, dtype=np.int64))
    if frame == 'principal_axes':
        vertices_um = to_principal_axes(vertices_um, faces)
    vertices_um, faces = np.ascontiguousarray(vertices_um), np.ascontiguousarray(faces)
    vertices_um.setflags(write=False)
    faces.setflags(write=False)
    digest = hashlib.sha256(np.rint(vertices_um / HASH_GRID_UM).astype('<i8').tobytes())
    digest.update(faces.astype('<i8').tobytes())
    return Part(name, vertices_um, faces, digest.hexdigest())


def _check_size(name: str, extents_um: FloatArray, unit_um: float) -> None:
    """Refuse sizes that only a wrong unit explains."""
    if extents_um.min() < SMALLEST_EXTENT_UM or extents_um.max() > LARGEST_EXTENT_UM:
        size = ' x '.join(f'{extent:.3g}' for extent in extents_um)
        raise InvalidMesh(
            'unit',
            f'{unit_um:g} µm, which makes {name} {size} µm',
            f'a unit that makes every extent {SMALLEST_EXTENT_UM:g} to {LARGEST_EXTENT_UM:g} µm',
        )
