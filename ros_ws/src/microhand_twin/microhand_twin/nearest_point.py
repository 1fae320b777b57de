# SPDX-License-Identifier: Apache-2.0
"""Where a tip touches a smooth surface: compiled, on the numbers of `surface_table`."""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from microhand_planner.core.pose import FloatArray
from microhand_twin.surface_table import HEADER, NODE, ROW

MOST_CONTACTS = 3
"""A tip in a hollow may touch several places."""

_SAME_PLACE_COS = math.cos(math.radians(30.0))
_STACK = 128
_ITERATIONS = 12
_BEYOND = 0.02  # patches reach this far beyond their edges: no gap opens between two of them
_CONVERGED = 1e-12


@nb.njit(cache=True)
def touched_places(
    table: FloatArray, centre: FloatArray, reach: float, found: FloatArray
) -> int:  # pragma: no cover - compiled
    """Find the places of a surface that are near to a tip.

    Parameters
    ----------
    table : (k,) float
        From `surface_table`; all lengths are in its unit.
    centre : (3,) float
        Centre of the tip, in the frame of the surface.
    reach : float
        Places count up to this distance from the centre.
    found : (MOST_CONTACTS, 4) float
        Receives the distance from the centre, and the point, of each place: the nearest first.
        Directions from the centre to two of them differ by 30° or more.

    Returns
    -------
    int
        How many were found.
    """
    leaves = int(table[1])
    patches = HEADER + 2 * leaves * NODE
    candidates = np.zeros((_STACK, 4))
    number = 0
    stack = np.zeros(_STACK, dtype=np.int64)
    stack[0] = 1
    waiting = 1
    while waiting > 0:
        waiting -= 1
        node = stack[waiting]
        if _box_distance(table, HEADER + node * NODE, centre) > reach:
            continue
        if node < leaves:
            stack[waiting] = 2 * node
            stack[waiting + 1] = 2 * node + 1
            waiting += 2
            continue
        row = patches + (node - leaves) * ROW
        if _triangle_distance(table, row, centre) - 2.0 * table[row + 30] > reach:
            continue
        if number < _STACK and _nearest_on_patch(table, row, centre, candidates[number]):
            if candidates[number, 0] <= reach:
                number += 1
    return _distinct(candidates, number, centre, found)


@nb.njit(cache=True)
def _distinct(
    candidates: FloatArray, number: int, centre: FloatArray, found: FloatArray
) -> int:  # pragma: no cover - compiled
    """Keep the nearest candidate of each direction."""
    kept = 0
    while kept < MOST_CONTACTS:
        best = -1
        for i in range(number):
            if best >= 0 and candidates[i, 0] >= candidates[best, 0]:
                continue
            apart = True
            for k in range(kept):
                along = 0.0
                for axis in range(3):
                    along += (candidates[i, 1 + axis] - centre[axis]) * (
                        found[k, 1 + axis] - centre[axis]
                    )
                apart &= along < _SAME_PLACE_COS * candidates[i, 0] * found[k, 0]
            if apart:
                best = i
        if best < 0:
            break
        found[kept] = candidates[best]
        kept += 1
    return kept


@nb.njit(cache=True)
def _box_distance(
    table: FloatArray, box: int, point: FloatArray
) -> float:  # pragma: no cover - compiled
    """Return the distance of a point from a box."""
    square = 0.0
    for axis in range(3):
        outside = max(table[box + axis] - point[axis], point[axis] - table[box + 3 + axis], 0.0)
        square += outside * outside
    return math.sqrt(square)


@nb.njit(cache=True)
def _triangle_distance(
    table: FloatArray, row: int, point: FloatArray
) -> float:  # pragma: no cover - compiled
    """Return the distance of a point from the flat triangle through a patch's corners."""
    # corners: (0, 0), (1, 0) and (0, 1): sums of the coefficients of pure powers
    p = np.zeros(3)
    e = np.zeros(3)
    f = np.zeros(3)
    for i in range(3):
        p[i] = point[i] - table[row + i]
        e[i] = table[row + 3 + i] + table[row + 9 + i] + table[row + 18 + i]
        f[i] = table[row + 6 + i] + table[row + 15 + i] + table[row + 27 + i]
    ee, ef, ff = _dot(e, e), _dot(e, f), _dot(f, f)
    pe, pf = _dot(p, e), _dot(p, f)
    determinant = ee * ff - ef * ef
    u = (ff * pe - ef * pf) / determinant
    v = (ee * pf - ef * pe) / determinant
    if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
        return _gap(p, e, f, u, v)
    along = min(max(pe / ee, 0.0), 1.0)
    best = _gap(p, e, f, along, 0.0)
    along = min(max(pf / ff, 0.0), 1.0)
    best = min(best, _gap(p, e, f, 0.0, along))
    along = min(max((pf - pe + ee - ef) / (ee - 2.0 * ef + ff), 0.0), 1.0)
    return min(best, _gap(p, e, f, 1.0 - along, along))


@nb.njit(cache=True)
def _dot(a: FloatArray, b: FloatArray) -> float:  # pragma: no cover - compiled
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@nb.njit(cache=True)
def _gap(
    p: FloatArray, e: FloatArray, f: FloatArray, u: float, v: float
) -> float:  # pragma: no cover - compiled
    """Return |p - u e - v f|."""
    square = 0.0
    for i in range(3):
        d = p[i] - u * e[i] - v * f[i]
        square += d * d
    return math.sqrt(square)


@nb.njit(cache=True)
def _nearest_on_patch(
    table: FloatArray, row: int, point: FloatArray, found: FloatArray
) -> bool:  # pragma: no cover - compiled
    """Find the point of a patch that is nearest to a point, by Newton's method.

    Returns False if it lies beyond a smooth edge: then it is the neighbour's. `found` receives the
    distance and the point.
    """
    u = 1.0 / 3.0
    v = 1.0 / 3.0
    for _ in range(_ITERATIONS):
        gu, gv, huu, huv, hvv, tuu, tuv, tvv = _slopes(table, row, point, u, v)
        determinant = (huu + tuu) * (hvv + tvv) - (huv + tuv) * (huv + tuv)
        if determinant > 0.05 * (huu * hvv - huv * huv) and huu + tuu > 0.0:
            huu, huv, hvv = huu + tuu, huv + tuv, hvv + tvv
        else:  # near to where the tip fits the hollow exactly: a safe step instead
            determinant = huu * hvv - huv * huv
        du = (huv * gv - hvv * gu) / determinant
        dv = (huv * gu - huu * gv) / determinant
        u = min(max(u + du, -0.5), 1.5)
        v = min(max(v + dv, -0.5), 1.5)
        if du * du + dv * dv < _CONVERGED * _CONVERGED:
            break
    if u > -_BEYOND and v > -_BEYOND and u + v < 1.0 + _BEYOND:
        inside = not (
            (v < 0.0 and table[row + 31] > 0.5)
            or (u + v > 1.0 and table[row + 32] > 0.5)
            or (u < 0.0 and table[row + 33] > 0.5)
        )
        if inside:
            _place(table, row, point, u, v, found)
            return True
    return _nearest_on_creases(table, row, point, found)


@nb.njit(cache=True)
def _slopes(
    table: FloatArray, row: int, point: FloatArray, u: float, v: float
) -> tuple[float, float, float, float, float, float, float, float]:  # pragma: no cover - compiled
    """Return derivatives of half the squared distance from a point to the patch at (u, v).

    First the gradient; then the second derivatives uu, uv, vv of a flat patch; then what the
    curvature adds to them.
    """
    gu = gv = huu = huv = hvv = tuu = tuv = tvv = 0.0
    for i in range(3):
        a = row + i
        a10, a01, a20 = table[a + 3], table[a + 6], table[a + 9]
        a11, a02, a30 = table[a + 12], table[a + 15], table[a + 18]
        a21, a12, a03 = table[a + 21], table[a + 24], table[a + 27]
        x = (
            table[a] + u * (a10 + u * (a20 + u * a30)) + v * (a01 + v * (a02 + v * a03))
            + u * v * (a11 + u * a21 + v * a12)
        )  # fmt: skip
        xu = a10 + u * (2.0 * a20 + 3.0 * u * a30) + v * (a11 + 2.0 * u * a21 + v * a12)
        xv = a01 + v * (2.0 * a02 + 3.0 * v * a03) + u * (a11 + u * a21 + 2.0 * v * a12)
        d = x - point[i]
        gu += d * xu
        gv += d * xv
        huu += xu * xu
        huv += xu * xv
        hvv += xv * xv
        tuu += d * (2.0 * a20 + 6.0 * u * a30 + 2.0 * v * a21)
        tuv += d * (a11 + 2.0 * u * a21 + 2.0 * v * a12)
        tvv += d * (2.0 * a02 + 6.0 * v * a03 + 2.0 * u * a12)
    return gu, gv, huu, huv, hvv, tuu, tuv, tvv


@nb.njit(cache=True)
def _nearest_on_creases(
    table: FloatArray, row: int, point: FloatArray, found: FloatArray
) -> bool:  # pragma: no cover - compiled
    """Find the nearest point on those edges of a patch that are edges of the part."""
    trial = np.zeros(4)
    any_found = False
    for edge in range(3):
        if table[row + 31 + edge] < 0.5:
            continue
        # edge 0 runs from (0, 0) to (1, 0), edge 1 on to (0, 1), edge 2 back
        du = 1.0 if edge == 0 else (-1.0 if edge == 1 else 0.0)
        dv = 0.0 if edge == 0 else (1.0 if edge == 1 else -1.0)
        u0 = 1.0 if edge == 1 else 0.0
        v0 = 1.0 if edge == 2 else 0.0
        t = 0.5
        for _ in range(_ITERATIONS):
            gu, gv, huu, huv, hvv, tuu, tuv, tvv = _slopes(
                table, row, point, u0 + t * du, v0 + t * dv
            )
            slope = gu * du + gv * dv
            flat = huu * du * du + 2.0 * huv * du * dv + hvv * dv * dv
            bent = flat + tuu * du * du + 2.0 * tuv * du * dv + tvv * dv * dv
            step = -slope / (bent if bent > 0.05 * flat else flat)
            before = t
            t = min(max(t + step, 0.0), 1.0)
            if abs(t - before) < _CONVERGED:
                break
        _place(table, row, point, u0 + t * du, v0 + t * dv, trial)
        if not any_found or trial[0] < found[0]:
            found[:] = trial
            any_found = True
    return any_found


@nb.njit(cache=True)
def _place(
    table: FloatArray, row: int, point: FloatArray, u: float, v: float, found: FloatArray
) -> None:  # pragma: no cover - compiled
    """Write the distance from a point to the patch's point at (u, v), and that point."""
    square = 0.0
    for i in range(3):
        a = row + i
        x = (
            table[a]
            + u * (table[a + 3] + u * (table[a + 9] + u * table[a + 18]))
            + v * (table[a + 6] + v * (table[a + 15] + v * table[a + 27]))
            + u * v * (table[a + 12] + u * table[a + 21] + v * table[a + 24])
        )
        found[1 + i] = x
        square += (x - point[i]) * (x - point[i])
    found[0] = math.sqrt(square)
