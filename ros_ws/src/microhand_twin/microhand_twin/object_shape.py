# SPDX-License-Identifier: Apache-2.0
"""What kind of solid a part is, which decides how MuJoCo is told of its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.part import Part
from microhand_planner.core.pose import FloatArray, readonly

ELLIPSOID_SHARE = 1e-4
"""A vertex may lie this far off an ellipsoid, over the smallest semi-axis."""
FACET_SHARE = 0.02
"""The middle of a face may lie this far inside it: a cube's corners lie on a sphere, too."""

_FEWEST_VERTICES = 40


@dataclass(frozen=True)
class Ellipsoid:
    """A part that is an ellipsoid, to the accuracy of a mesh.

    Parameters
    ----------
    centre_um : (3,) float
        Object frame [µm].
    semi_axes_um : (3,) float
        [µm].
    axes : (3, 3) float
        Directions of the semi-axes in its columns, right-handed, object frame.
    """

    centre_um: FloatArray
    semi_axes_um: FloatArray
    axes: FloatArray


def ellipsoid_of(part: Part) -> Ellipsoid | None:
    """Return the ellipsoid that a part is, or None if it is none.

    The quadric nearest to the vertices is fitted by least squares. The part is an ellipsoid if
    every vertex lies within 0.01 % of the smallest semi-axis of it, and the middle of every face
    within 2 %.

    Parameters
    ----------
    part : Part
        Any part.
    """
    vertices_um = part.vertices_um
    if len(vertices_um) < _FEWEST_VERTICES:
        return None
    middle_um = vertices_um.mean(axis=0)
    scale_um = float(np.abs(vertices_um - middle_um).max())
    x, y, z = ((vertices_um - middle_um) / scale_um).T
    terms = np.column_stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, x, y, z])
    factors, *_ = np.linalg.lstsq(terms, np.ones(len(x)), rcond=None)
    a, b, c, f, g, h = factors[:6]
    quadric = np.array([[a, h, g], [h, b, f], [g, f, c]])
    stretch, axes = np.linalg.eigh(quadric)
    if stretch.min() <= 0.0:
        return None
    centre = -0.5 * np.linalg.solve(quadric, factors[6:])
    semi_axes = np.sqrt((1.0 + centre @ quadric @ centre) / stretch)
    order = _order_along_coordinates(axes)
    axes = axes[:, order]
    if np.linalg.det(axes) < 0.0:
        axes = axes * [1.0, 1.0, -1.0]
    found = Ellipsoid(
        readonly(middle_um + scale_um * centre),
        readonly(scale_um * semi_axes[order]),
        readonly(axes),
    )
    middles_um = vertices_um[part.faces].mean(axis=1)
    if _farthest_off(found, vertices_um) > ELLIPSOID_SHARE:
        return None
    return found if _farthest_off(found, middles_um) <= FACET_SHARE else None


def contains(part: Part, points_um: FloatArray) -> NDArray[np.bool_]:
    """Return which points (k, 3) are inside a part: its faces surround them [VanOosterom1983].

    Parameters
    ----------
    part : Part
        Any part; cavities are outside.
    points_um : (k, 3) float
        Object frame [µm].
    """
    inside = np.zeros(len(points_um), dtype=bool)
    for number, point_um in enumerate(np.asarray(points_um, dtype=np.float64)):
        corners = part.vertices_um[part.faces] - point_um
        length = np.linalg.norm(corners, axis=2)
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        volume = np.einsum('ij,ij->i', a, np.cross(b, c))
        spread = length.prod(axis=1)
        for one, other, third in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            cos = np.einsum('ij,ij->i', corners[:, one], corners[:, other])
            spread = spread + cos * length[:, third]
        solid_angle = 2.0 * np.arctan2(volume, spread).sum()
        inside[number] = solid_angle > 2.0 * np.pi  # 4 pi inside, 0 outside
    return inside


def _order_along_coordinates(axes: FloatArray) -> NDArray[np.intp]:
    """Return the order in which axes (columns) are nearest to x, y and z, if there is one."""
    order = np.argmax(np.abs(axes), axis=1)
    return order if len(set(order.tolist())) == len(order) else np.arange(len(order))


def _farthest_off(ellipsoid: Ellipsoid, points_um: FloatArray) -> float:
    """Return how far points (n, 3) are off the surface at most, over the smallest semi-axis."""
    local = (points_um - ellipsoid.centre_um) @ ellipsoid.axes / ellipsoid.semi_axes_um
    return float(np.abs(np.linalg.norm(local, axis=1) - 1.0).max())
