# SPDX-License-Identifier: Apache-2.0
"""Sections given by formulas: ellipses, polygons, and the paper's convex and concave outlines."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.arc_spline import arc_spline
from microhand_planner.core.outline import polygon_outline
from microhand_planner.core.parameters import check_number
from microhand_planner.core.section import Plane, Section

FloatArray = NDArray[np.float64]


def parametric_section(
    plane: Plane,
    point_um: Callable[[FloatArray], FloatArray],
    derivative_um: Callable[[FloatArray], FloatArray],
    spans: int = 512,
) -> Section:
    """Turn a smooth closed curve t ↦ point, t in [0, 2π), counter-clockwise, into a section.

    Parameters
    ----------
    plane : Plane
        Where the section lies.
    point_um, derivative_um : callable
        Parameters (n,) to points and to derivatives by t, (n, 2) [µm].
    spans : int
        Biarcs that stand for the curve.
    """
    t = np.arange(spans, dtype=np.float64) * (2.0 * math.pi / spans)
    tangent = derivative_um(t)
    normal_angle = np.unwrap(np.arctan2(-tangent[:, 0], tangent[:, 1]))
    points, angles, _ = arc_spline(point_um(t), normal_angle)
    return Section(plane, points, angles)


def ellipse_section(a_um: float, b_um: float, plane: Plane) -> Section:
    """Return the ellipse with semi-axes `a_um` along u and `b_um` along v.

    Examples
    --------
    >>> from microhand_planner.core.section import XY_PLANE
    >>> round(ellipse_section(10.0, 10.0, XY_PLANE).perimeter_um / (2.0 * math.pi), 9)
    10.0
    """
    check_number('ellipse_um', a_um, low=0.0, low_open=True)
    check_number('ellipse_um', b_um, low=0.0, low_open=True)
    return parametric_section(
        plane,
        lambda t: np.column_stack([a_um * np.cos(t), b_um * np.sin(t)]),
        lambda t: np.column_stack([-a_um * np.sin(t), b_um * np.cos(t)]),
    )


def polygon_section(corners_um: FloatArray, plane: Plane) -> Section:
    """Return the polygon with corners (n, 2) [µm], counter-clockwise, edges straight.

    Examples
    --------
    >>> from microhand_planner.core.section import XY_PLANE
    >>> corners_um = np.array([[5.0, 5.0], [-5.0, 5.0], [-5.0, -5.0], [5.0, -5.0]])
    >>> polygon_section(corners_um, XY_PLANE).perimeter_um
    40.0
    """
    points_um, angles, _ = polygon_outline(corners_um)
    return Section(plane, points_um, angles)


def waisted_section(a_um: float, waist_um: float, flare_um: float, plane: Plane) -> Section:
    """Return the outline u = a cos t, v = (waist + flare cos² t) sin t.

    With no flare an ellipse; with a little a rounded rectangle, still convex; with much of it
    two lobes with a waist between. The sections of `examples/make_parts.py` are of this kind.

    Examples
    --------
    >>> from microhand_planner.core.section import XY_PLANE
    >>> waisted_section(36.5, 30.5, 4.0, XY_PLANE).is_convex
    True
    >>> waisted_section(36.5, 16.0, 76.0, XY_PLANE).is_convex
    False
    """

    def point_um(t: FloatArray) -> FloatArray:
        height_um = waist_um + flare_um * np.cos(t) ** 2
        return np.column_stack([a_um * np.cos(t), height_um * np.sin(t)])

    def derivative_um(t: FloatArray) -> FloatArray:
        height_um = waist_um + flare_um * np.cos(t) ** 2
        climb_um = height_um * np.cos(t) - 2.0 * flare_um * np.cos(t) * np.sin(t) ** 2
        return np.column_stack([-a_um * np.sin(t), climb_um])

    return parametric_section(plane, point_um, derivative_um)
