# SPDX-License-Identifier: Apache-2.0
"""Make the meshes of the built-in catalogue: the paper's ellipsoid, convex and concave object.

Run it from anywhere: ``python examples/make_parts.py [FOLDER]``. The result is the same, byte for
byte, on every run. Without FOLDER it writes to the catalogue of the planner package, to which the
links in this folder point.

The paper gives no dimensions. These reproduce what it does give, with tips of 4.5 µm radius and
steps of 20°: the contacts on each section line and, roughly, the shares of stable grasps of its
Table 2. All three are images of the unit sphere under
(x, y, z) ↦ (a x, (waist + flare x²) y, h z); so the normal along both sections lies in the
section's plane, both objects of the second row have the same section XZ, and all sections
have formulas (`microhand_planner.core.analytic_sections.waisted_section`).

========= ====== ====== ====== ===== ============ ============
object    a      waist  flare  h     contacts XY  contacts XZ
========= ====== ====== ====== ===== ============ ============
ellipsoid 16.2   11.6    0     11.6       74           74
convex    36.5   30.5    4     29.3      154.5        150.0
concave   36.5   16.0   76     29.3      219.0        150.0
========= ====== ====== ====== ===== ============ ============
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from microhand_planner.core.catalogue import BUILT_IN

OBJECTS = {
    # name: (a, waist, flare, h in µm, pieces per edge of the icosahedron, description)
    'ellipsoid': (16.2, 11.6, 0.0, 11.6, 16, 'Ellipsoid, semi-axes 16.2 x 11.6 x 11.6 µm'),
    'convex': (36.5, 30.5, 4.0, 29.3, 24, 'Convex object, 73 x 61 x 58.6 µm'),
    'concave': (36.5, 16.0, 76.0, 29.3, 30, 'Concave object with a waist, 73 x 78 x 58.6 µm'),
}


def geodesic_sphere(pieces: int) -> trimesh.Trimesh:
    """Return a unit sphere of 20 pieces² faces, symmetric to the coordinate planes."""
    icosahedron = trimesh.creation.icosahedron()
    grid = [(i, j) for i in range(pieces + 1) for j in range(pieces + 1 - i)]
    number = {place: k for k, place in enumerate(grid)}
    weights = np.array([(pieces - i - j, i, j) for i, j in grid]) / pieces
    faces = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in grid if i + j < pieces]
    faces += [
        (number[i + 1, j], number[i + 1, j + 1], number[i, j + 1])
        for i, j in grid
        if i + j < pieces - 1
    ]
    corners = icosahedron.vertices[icosahedron.faces]
    vertices = np.einsum('gk,fkx->fgx', weights, corners).reshape(-1, 3)
    vertices /= np.linalg.norm(vertices, axis=1)[:, None]
    shift = np.arange(len(corners))[:, None, None] * len(grid)
    return trimesh.Trimesh(vertices, (np.array(faces)[None] + shift).reshape(-1, 3))


def shape(
    sphere: NDArray[np.float64], a: float, waist: float, flare: float, h: float
) -> NDArray[np.float64]:
    """Map points (n, 3) of the unit sphere onto an object."""
    x, y, z = np.round(sphere, 12).T
    return np.column_stack([a * x, (waist + flare * x**2) * y, h * z])


def main(folder: Path) -> None:
    """Write ``<name>.stl`` and ``<name>.json`` for each object."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (a, waist, flare, h, pieces, description) in OBJECTS.items():
        mesh = geodesic_sphere(pieces)
        mesh.vertices = shape(mesh.vertices, a, waist, flare, h)
        (folder / f'{name}.stl').write_bytes(trimesh.exchange.stl.export_stl(mesh))
        sidecar = {
            'mesh': f'{name}.stl',
            'unit_um': 1.0,
            'frame': 'as_given',
            'description': description,
        }
        text = json.dumps(sidecar, indent=2, ensure_ascii=False)
        (folder / f'{name}.json').write_text(text + '\n', encoding='utf-8')
        print(f'{folder / name}.stl: {len(mesh.faces)} faces')


if __name__ == '__main__':
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else BUILT_IN)
