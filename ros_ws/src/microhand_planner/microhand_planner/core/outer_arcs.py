# SPDX-License-Identifier: Apache-2.0
"""What a tip can reach of a section with hollows: the outer boundary of all its offset arcs.

The offset arcs of an outline, joined in order, form one closed curve, which crosses itself where
the tip would touch two places. The centre can be at a distance of exactly r from the solid only
on the outer boundary of that curve: start at its rightmost point, follow it, and at each
crossing change to the other branch. Everything between leaving and joining is out of reach.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from microhand_planner.core.arc_chain import ArcChain

FloatArray = NDArray[np.float64]

LENGTH_TOLERANCE_UM = 1e-8
"""Crossings nearer to each other than this are one; ends of arcs are as wide as this."""
STRAIGHT_SAGITTA_UM = 1e-7
"""Arcs flatter than this are crossed as lines: their circle is too large for its digits."""


def outer_arcs(arcs: ArcChain, radius_um: float) -> ArcChain:
    """Return the arcs, or parts of arcs, that a tip can touch, counter-clockwise.

    Parameters
    ----------
    arcs : ArcChain
        The closed outline.
    radius_um : float
        Radius of the tip [µm].

    Returns
    -------
    ArcChain
        The reachable arcs. Between two that follow each other the tip's centre stays where it
        is; where the normal changes, the tip touches two places.
    """
    moving = np.flatnonzero(np.abs(arcs.offset_length_um(radius_um)) > LENGTH_TOLERANCE_UM)
    arcs = arcs.clip(moving, np.zeros(len(moving)), np.ones(len(moving)))
    arcs = _rightmost_first(arcs, radius_um)
    length_um = arcs.offset_length_um(radius_um)
    row = np.arange(len(arcs))
    contact_um, normal = arcs.points(row, np.zeros(len(arcs)))
    end_um, end_normal = arcs.points(row, np.ones(len(arcs)))
    rho_um = np.divide(
        arcs.arc_length_um, arcs.turn_rad, out=np.full(len(arcs), np.inf), where=arcs.turn_rad != 0
    )
    flat = np.abs(length_um * arcs.turn_rad) < 8.0 * STRAIGHT_SAGITTA_UM
    crossings = _crossings(
        contact_um + radius_um * normal,
        end_um + radius_um * end_normal,
        np.where(flat[:, None], 0.0, contact_um - np.where(flat, 0.0, rho_um)[:, None] * normal),
        np.where(flat, 0.0, rho_um + radius_um),
        arcs.normal_angle_rad,
        arcs.turn_rad,
        np.abs(length_um),
    )
    path_um = np.concatenate([[0.0], np.cumsum(np.abs(length_um))])
    first = path_um[crossings[:, 0].astype(np.intp)] + crossings[:, 1]
    second = path_um[crossings[:, 2].astype(np.intp)] + crossings[:, 3]
    pieces = _walk(first, second, float(path_um[-1]))
    return _cut(arcs, path_um, pieces)


def _rightmost_first(arcs: ArcChain, radius_um: float) -> ArcChain:
    """Start the chain where the tip's centre is furthest right: always on the outer boundary."""
    turn = np.abs(arcs.turn_rad)
    to_right = np.mod(-np.sign(arcs.turn_rad) * arcs.normal_angle_rad, 2.0 * math.pi)
    place = np.divide(
        to_right, turn, out=np.zeros(len(arcs)), where=(turn > 0) & (to_right < turn)
    )
    contact_um, normal = arcs.points(np.arange(len(arcs)), place)
    best = int((contact_um + radius_um * normal)[:, 0].argmax())
    row = np.concatenate([np.arange(best, len(arcs)), np.arange(best + 1)])
    start, end = np.zeros(len(row)), np.ones(len(row))
    start[0] = end[-1] = place[best]
    keep = end - start > 1e-12
    return arcs.clip(row[keep], start[keep], end[keep])


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


def _walk(first_um: FloatArray, second_um: FloatArray, length_um: float) -> FloatArray:
    """Follow the outer boundary from 0 and return the stretches of path used, (p, 2) [µm]."""
    low, high = np.minimum(first_um, second_um), np.maximum(first_um, second_um)
    order = np.lexsort((high, low))
    low, high = low[order], high[order]
    # A crossing at the common end of two arcs is found on both of them: keep one.
    tolerance = 4.0 * LENGTH_TOLERANCE_UM
    kept: list[int] = []
    for k in range(len(low)):
        recent = [m for m in kept[::-1] if low[k] - low[m] <= tolerance]
        if high[k] - low[k] > tolerance and all(
            abs(high[k] - high[m]) > tolerance for m in recent
        ):
            kept.append(k)
    places = np.concatenate([low[kept], high[kept]])
    events = np.argsort(places, kind='stable')
    rank = np.argsort(events, kind='stable')
    partner = np.concatenate([np.arange(len(kept)) + len(kept), np.arange(len(kept))])
    pieces = []
    start, event = 0.0, 0
    for _ in range(len(places) + 1):
        if event == len(events):
            pieces.append((start, length_um))
            return np.array(pieces)
        place = int(events[event])
        pieces.append((start, float(places[place])))
        start = float(places[partner[place]])
        event = int(rank[partner[place]]) + 1
    raise AssertionError('an outer boundary without end')


def _cut(arcs: ArcChain, path_um: FloatArray, pieces: FloatArray) -> ArcChain:
    """Return the stretches `pieces` of a chain, one after the other."""
    rows, starts, ends = [], [], []
    for begin, end in pieces:
        inside = (path_um[1:] > begin) & (path_um[:-1] < end)
        row = np.flatnonzero(inside)
        size = path_um[row + 1] - path_um[row]
        rows.append(row)
        starts.append(np.clip((begin - path_um[row]) / size, 0.0, 1.0))
        ends.append(np.clip((end - path_um[row]) / size, 0.0, 1.0))
    return arcs.clip(np.concatenate(rows), np.concatenate(starts), np.concatenate(ends))
