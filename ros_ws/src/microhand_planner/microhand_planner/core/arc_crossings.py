# SPDX-License-Identifier: Apache-2.0
"""Where a closed run of arcs, or the path of a tip's centre around it, crosses itself."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from microhand_planner.core.arc_chain import ArcChain

FloatArray = NDArray[np.float64]

LENGTH_TOLERANCE_UM = 1e-8
"""Arcs shorter than this are points; the ends of longer ones count as this wide."""
STRAIGHT_SAGITTA_UM = 1e-7
"""Arcs flatter than this are crossed as lines: their circle is too large for its digits."""


def moving_arcs(arcs: ArcChain, offset_um: float) -> ArcChain:
    """Return the arcs whose offset has a length; at an offset of 0 that drops corners."""
    row = np.flatnonzero(np.abs(arcs.offset_length_um(offset_um)) > LENGTH_TOLERANCE_UM)
    return arcs.clip(row, np.zeros(len(row)), np.ones(len(row)))


def self_crossings(arcs: ArcChain, offset_um: float) -> FloatArray:
    """Find where a closed run of arcs, moved outward by an offset, crosses itself.

    Parameters
    ----------
    arcs : ArcChain
        Closed; `moving_arcs` only.
    offset_um : float
        0 for the run itself, the radius of a tip for the path of its centre [µm].

    Returns
    -------
    (m, 2) array
        Two places on the offset path for each crossing: the smaller and the larger distance
        from its start, backward stretches counted as forward [µm]. Neighbouring arcs are not
        looked at; a crossing on the common end of two arcs may be listed several times.
    """
    length_um = arcs.offset_length_um(offset_um)
    every = np.arange(len(arcs))
    start_um, normal = arcs.points(every, np.zeros(len(arcs)))
    end_um, end_normal = arcs.points(every, np.ones(len(arcs)))
    flat = np.abs(length_um * arcs.turn_rad) < 8.0 * STRAIGHT_SAGITTA_UM
    radius_um = np.divide(arcs.arc_length_um, arcs.turn_rad, out=np.zeros(len(arcs)), where=~flat)
    found = _crossings(
        start_um + offset_um * normal,
        end_um + offset_um * end_normal,
        start_um - radius_um[:, None] * normal,
        np.where(flat, 0.0, radius_um + offset_um),
        arcs.normal_angle_rad,
        arcs.turn_rad,
        np.abs(length_um),
    )
    path_um = np.cumsum(np.abs(length_um)) - np.abs(length_um)
    row = found[:, [0, 2]].astype(np.intp)
    return np.sort(path_um[row] + found[:, [1, 3]], axis=1)


@njit(cache=True)
def _place_on(
    u: float,
    v: float,
    start: FloatArray,
    end: FloatArray,
    middle: FloatArray,
    radius: float,
    angle: float,
    turn: float,
) -> float:
    """Return the fraction of an offset arc at which a point of its circle or line lies."""
    if radius == 0.0:
        du, dv = end[0] - start[0], end[1] - start[1]
        return ((u - start[0]) * du + (v - start[1]) * dv) / (du * du + dv * dv)
    nu, nv = (u - middle[0]) / radius, (v - middle[1]) / radius
    cu, cv = math.cos(angle), math.sin(angle)
    return math.atan2(cu * nv - cv * nu, cu * nu + cv * nv) / turn


@njit(cache=True)
def _meet(
    start_a: FloatArray,
    end_a: FloatArray,
    middle_a: FloatArray,
    radius_a: float,
    start_b: FloatArray,
    end_b: FloatArray,
    middle_b: FloatArray,
    radius_b: float,
    found: FloatArray,
) -> int:
    """Write the points that two circles, or lines (radius 0), share into `found`; count them."""
    if radius_a == 0.0 and radius_b == 0.0:
        au, av = end_a[0] - start_a[0], end_a[1] - start_a[1]
        bu, bv = end_b[0] - start_b[0], end_b[1] - start_b[1]
        cross = au * bv - av * bu
        if abs(cross) < 1e-12 * math.sqrt((au * au + av * av) * (bu * bu + bv * bv)):
            return 0
        share = ((start_b[0] - start_a[0]) * bv - (start_b[1] - start_a[1]) * bu) / cross
        found[0, 0] = start_a[0] + share * au
        found[0, 1] = start_a[1] + share * av
        return 1
    if radius_a == 0.0:
        return _meet(start_b, end_b, middle_b, radius_b, start_a, end_a, middle_a, radius_a, found)
    if radius_b == 0.0:
        across_u, across_v = end_b[0] - start_b[0], end_b[1] - start_b[1]
        size = math.hypot(across_u, across_v)
        across_u, across_v = across_u / size, across_v / size
        along = (middle_a[0] - start_b[0]) * across_u + (middle_a[1] - start_b[1]) * across_v
        foot_u, foot_v = start_b[0] + along * across_u, start_b[1] + along * across_v
        away = math.hypot(middle_a[0] - foot_u, middle_a[1] - foot_v)
    else:
        du, dv = middle_b[0] - middle_a[0], middle_b[1] - middle_a[1]
        size = math.hypot(du, dv)
        if size < 1e-12:
            return 0
        across_u, across_v = -dv / size, du / size
        away = 0.5 * (size + (radius_a - radius_b) * (radius_a + radius_b) / size)
        foot_u, foot_v = middle_a[0] + away * du / size, middle_a[1] + away * dv / size
    square = (radius_a - away) * (radius_a + away)
    if square < 0.0:
        return 0
    half = math.sqrt(square)
    found[0, 0], found[0, 1] = foot_u + half * across_u, foot_v + half * across_v
    found[1, 0], found[1, 1] = foot_u - half * across_u, foot_v - half * across_v
    return 2


@njit(cache=True)
def _crossings(
    start: FloatArray,
    end: FloatArray,
    middle: FloatArray,
    radius: FloatArray,
    angle: FloatArray,
    turn: FloatArray,
    length: FloatArray,
) -> FloatArray:
    """Find where offset arcs cross, other than neighbours at their common end.

    Returns
    -------
    (m, 4) array
        Arc, distance along it [µm], other arc, distance along that.
    """
    count = len(length)
    low, high = np.zeros((count, 2)), np.zeros((count, 2))
    for i in range(count):
        bulge = abs(length[i] * turn[i]) / 4.0 + LENGTH_TOLERANCE_UM
        for axis in range(2):
            low[i, axis] = min(start[i, axis], end[i, axis]) - bulge
            high[i, axis] = max(start[i, axis], end[i, axis]) + bulge
    order = np.argsort(low[:, 0])
    found = np.zeros((2, 2))
    rows = []
    for position in range(count):
        i = order[position]
        for other in range(position + 1, count):
            j = order[other]
            if low[j, 0] > high[i, 0]:
                break
            if low[j, 1] > high[i, 1] or high[j, 1] < low[i, 1]:
                continue
            gap = abs(i - j)
            if gap == 1 or gap == count - 1:
                continue
            shared = _meet(
                start[i], end[i], middle[i], radius[i],
                start[j], end[j], middle[j], radius[j], found,
            )  # fmt: skip
            for k in range(shared):
                u, v = found[k]
                on_i = length[i] * _place_on(
                    u, v, start[i], end[i], middle[i], radius[i], angle[i], turn[i]
                )
                on_j = length[j] * _place_on(
                    u, v, start[j], end[j], middle[j], radius[j], angle[j], turn[j]
                )
                if (
                    -LENGTH_TOLERANCE_UM <= on_i <= length[i] + LENGTH_TOLERANCE_UM
                    and -LENGTH_TOLERANCE_UM <= on_j <= length[j] + LENGTH_TOLERANCE_UM
                ):
                    rows.append((float(i), on_i, float(j), on_j))
    result = np.zeros((len(rows), 4))
    for k in range(len(rows)):
        for column in range(4):
            result[k, column] = rows[k][column]
    return result
