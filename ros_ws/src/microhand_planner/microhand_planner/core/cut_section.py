# SPDX-License-Identifier: Apache-2.0
"""The section of a part: cut the mesh, keep the outer loop, and smooth its facets away."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.arc_crossings import moving_arcs, self_crossings
from microhand_planner.core.arc_spline import arc_spline
from microhand_planner.core.errors import EmptySection, InvalidMesh
from microhand_planner.core.mesh_cut import MeshLoop, cut_mesh
from microhand_planner.core.outline import polygon_outline, smooth_outline
from microhand_planner.core.part import Part
from microhand_planner.core.section import Plane, Section

FloatArray = NDArray[np.float64]


def cut_section(part: Part, plane: Plane) -> Section:
    """Cut a part along a plane through its origin.

    Of several loops the outer one around the origin counts: the largest that contains the
    origin and has material inside. Holes, and pieces beside it, are ignored and counted.

    Parameters
    ----------
    part : Part
        The object.
    plane : Plane
        The plane, object frame.

    Returns
    -------
    Section
        Smooth where the facets stand for a smooth surface (see `outline`), with corners and
        straight edges kept. On ellipsoids of 5120 facets, however they lie, contacts are within
        0.003 µm and normals within 0.04° of the exact ones (facets alone: 0.02 µm and 2°).

    Raises
    ------
    EmptySection
        The plane does not cut the part, or no loop surrounds the origin.
    InvalidMesh
        The outline touches or crosses itself.

    Examples
    --------
    >>> import trimesh
    >>> from microhand_planner.core.part import make_part
    >>> from microhand_planner.core.section import XY_PLANE
    >>> box = trimesh.creation.box(extents=[20.0, 10.0, 5.0])
    >>> section = cut_section(make_part('box', box.vertices, box.faces), XY_PLANE)
    >>> section.perimeter_um
    60.0
    """
    loops = cut_mesh(part, plane)
    around = [loop for loop in loops if _area_um2(loop) > 0.0 and _surrounds_origin(loop)]
    if not around:
        raise EmptySection(
            'object origin',
            f'outside the section of {part.name} normal to {plane.axis.upper()}',
            'an origin inside the object, for instance with the frame principal_axes',
        )
    loop = max(around, key=_area_um2)
    # Rounding can make the flanks of a needle cross: then the facets are taken as they are.
    for outline in (smooth_outline, polygon_outline):
        try:
            section = _section(plane, loop, outline, len(loops) - 1)
        except ValueError:
            continue
        arcs = moving_arcs(section.arcs, 0.0)
        if section.is_convex or len(self_crossings(arcs, 0.0)) == 0:
            return section
    raise InvalidMesh(
        'object',
        f'{part.name}, whose section normal to {plane.axis.upper()} touches or crosses itself',
        'a mesh whose faces meet at common edges only',
    )


def _section(
    plane: Plane,
    loop: MeshLoop,
    outline: Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
    ignored_loops: int,
) -> Section:
    """Turn a loop into a section, with an outline that `outline` makes of its points."""
    outline_um, outline_angle, source = outline(loop.points_um)
    points_um, angles, from_outline = arc_spline(outline_um, outline_angle)
    count = len(loop.points_um)
    where = np.interp(from_outline, np.arange(len(source) + 1), [*source, source[0] + count])
    slope = np.interp(where, np.arange(count), np.abs(loop.out_of_plane_sin), period=count)
    return Section(
        plane,
        points_um,
        angles,
        out_of_plane_sin=slope,
        facet_gap_um=loop.facet_gap_um + _largest_gap_um(outline_um, source, loop.points_um),
        ignored_loops=ignored_loops,
    )


def _area_um2(loop: MeshLoop) -> float:
    """Return the area inside a loop; negative around a hole."""
    u, v = loop.points_um.T
    return float(0.5 * (u * np.roll(v, -1) - np.roll(u, -1) * v).sum())


def _surrounds_origin(loop: MeshLoop) -> bool:
    """Tell whether a loop goes around the origin, by the angle it sweeps."""
    angle = np.arctan2(loop.points_um[:, 1], loop.points_um[:, 0])
    step = np.diff(angle, append=angle[0])
    return bool(abs((np.mod(step + np.pi, 2.0 * np.pi) - np.pi).sum()) > np.pi)


def _largest_gap_um(outline_um: FloatArray, source: FloatArray, polygon_um: FloatArray) -> float:
    """Return the largest distance of outline points from the polygon segment they come from."""
    row = np.floor(source).astype(np.intp) % len(polygon_um)
    start = polygon_um[row]
    edge = polygon_um[(row + 1) % len(polygon_um)] - start
    cross = edge[:, 0] * (outline_um - start)[:, 1] - edge[:, 1] * (outline_um - start)[:, 0]
    return float(np.abs(cross / np.hypot(edge[:, 0], edge[:, 1])).max())
