# SPDX-License-Identifier: Apache-2.0
"""Objects by name: a folder of meshes, each with a JSON file that says how to read it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from microhand_planner.core.errors import BadRequest, InvalidParameter, UnknownObject
from microhand_planner.core.parameters import check_number
from microhand_planner.core.part import FORMATS, FRAMES, Frame, Part, load_part

BUILT_IN = Path(__file__).parent.parent / 'catalogue'
"""The folder that is installed with the package."""


@dataclass(frozen=True)
class CatalogueEntry:
    """An object that can be asked for by name.

    Parameters
    ----------
    name : str
        The name: that of the JSON file.
    mesh_file : Path
        Where its mesh is.
    unit_um : float
        Length of one unit of the mesh [µm].
    frame : {'as_given', 'principal_axes'}
        See `part.load_part`.
    description : str
        One line for people.
    """

    name: str
    mesh_file: Path
    unit_um: float
    frame: Frame
    description: str

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number(f'unit_um of {self.name}', self.unit_um, low=0.0, low_open=True)
        if self.frame not in FRAMES:
            raise InvalidParameter(f'frame of {self.name}', self.frame, ' or '.join(FRAMES))


def list_objects(folder: Path | None = None) -> tuple[CatalogueEntry, ...]:
    """Return the objects of a catalogue, by name.

    Parameters
    ----------
    folder : Path, optional
        The catalogue; by default the built-in one. It holds, for each object, ``<name>.json``
        with the keys ``mesh`` (file name, relative to the folder), ``unit_um``, ``frame`` and
        ``description``.

    Raises
    ------
    InvalidParameter
        A JSON file is damaged, or a value is outside what is allowed.

    Examples
    --------
    >>> [entry.name for entry in list_objects()]
    ['concave', 'convex', 'ellipsoid']
    """
    return tuple(_read_entry(sidecar) for sidecar in sorted((folder or BUILT_IN).glob('*.json')))


def find_part(
    name_or_path: str,
    *,
    unit_um: float | None = None,
    frame: Frame | None = None,
    folder: Path | None = None,
) -> Part:
    """Load an object of the catalogue, or a mesh file.

    Parameters
    ----------
    name_or_path : str
        A name of the catalogue; otherwise the path of a mesh file.
    unit_um : float, optional
        Length of one unit of the mesh [µm]; by default the catalogue's, 1 for a file.
    frame : {'as_given', 'principal_axes'}, optional
        By default the catalogue's, ``as_given`` for a file.
    folder : Path, optional
        The catalogue; by default the built-in one.

    Raises
    ------
    UnknownObject
        Neither; says which names there are.
    BadRequest
        As `load_part` and `list_objects`.

    Examples
    --------
    >>> find_part('ellipsoid').extents_um.round(3).tolist()
    [32.4, 23.2, 23.2]
    """
    entries = {entry.name: entry for entry in list_objects(folder)}
    entry = entries.get(name_or_path)
    if entry is not None:
        return load_part(
            entry.mesh_file,
            unit_um=entry.unit_um if unit_um is None else unit_um,
            frame=frame or entry.frame,
            name=entry.name,
        )
    path = Path(name_or_path)
    if path.suffix.lower().lstrip('.') not in FORMATS:
        names = ', '.join(entries)
        formats = ', '.join(f'.{suffix}' for suffix in FORMATS)
        raise UnknownObject(
            'object',
            name_or_path,
            f'a name of the catalogue ({names}) or the path of a mesh file ({formats})',
        )
    return load_part(path, unit_um=1.0 if unit_um is None else unit_um, frame=frame or 'as_given')


def find_mesh_file(name_or_path: str, folder: Path | None = None) -> Path | None:
    """Return the mesh file of an object, without reading it; None: there is none.

    Parameters
    ----------
    name_or_path, folder
        As in `find_part`.

    Examples
    --------
    >>> find_mesh_file('ellipsoid').name
    'ellipsoid.stl'
    """
    for entry in list_objects(folder):
        if entry.name == name_or_path:
            return entry.mesh_file
    path = Path(name_or_path)
    return path if path.is_file() else None


def _read_entry(sidecar: Path) -> CatalogueEntry:
    """Read one JSON file of a catalogue."""
    try:
        values = json.loads(sidecar.read_text(encoding='utf-8'))
        return CatalogueEntry(
            name=sidecar.stem,
            mesh_file=sidecar.parent / values['mesh'],
            unit_um=float(values['unit_um']),
            frame=cast('Frame', values['frame']),
            description=str(values['description']),
        )
    except BadRequest:
        raise
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidParameter(
            'catalogue',
            f'{sidecar} ({type(error).__name__}: {error})',
            'a JSON object with mesh, unit_um, frame and description',
        ) from error
