# SPDX-License-Identifier: Apache-2.0
"""A smooth surface as one row of numbers, with a tree to find what is near: for compiled code.

::

    0        HEADER numbers: MARK, leaves, radius of the tips
    HEADER   boxes around the patches below each node: 6 numbers (low, high) per node; node 1
             is the root, 2 i and 2 i + 1 are below i, the leaves come last
    ...      the patches, in the order of the leaves, ROW numbers each: coefficients (10, 3) of
             u^i v^j for (i, j) = 00 10 01 20 11 02 30 21 12 03; how far the patch leaves the plane
             of its corners; which of its three edges are creases (0 or 1)
"""

from __future__ import annotations

import math

import numpy as np

from microhand_planner.core.pose import FloatArray
from microhand_twin.smooth_surface import IntArray, SmoothSurface

MARK = 20210.5
HEADER = 4
NODE = 6
ROW = 34
POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))

_BERNSTEIN = (
    (3, 0, 0), (0, 3, 0), (0, 0, 3), (2, 1, 0), (1, 2, 0),
    (0, 2, 1), (0, 1, 2), (1, 0, 2), (2, 0, 1), (1, 1, 1),
)  # fmt: skip


def surface_table(surface: SmoothSurface, tip_radius_um: float, unit_um: float) -> FloatArray:
    """Write a surface as one row of numbers.

    Parameters
    ----------
    surface : SmoothSurface
        The surface.
    tip_radius_um : float
        Radius of the tips [µm].
    unit_um : float
        The unit of length in the table [µm].

    Returns
    -------
    (k,) float
    """
    control = surface.control_um / unit_um
    leaves = 1 << max(1, math.ceil(math.log2(len(control))))
    order = _leaf_order(control, leaves)
    filled = order >= 0
    boxes = np.full((2 * leaves, 2, 3), np.nan)
    boxes[:, 0], boxes[:, 1] = 1e30, -1e30  # an empty leaf is near to nothing
    boxes[leaves:, 0][filled] = control[order[filled]].min(axis=1)
    boxes[leaves:, 1][filled] = control[order[filled]].max(axis=1)
    level = leaves // 2
    while level:
        below = boxes[2 * level : 4 * level].reshape(level, 2, 2, 3)
        boxes[level : 2 * level, 0] = below[:, :, 0].min(axis=1)
        boxes[level : 2 * level, 1] = below[:, :, 1].max(axis=1)
        level //= 2
    rows = np.zeros((leaves, ROW))
    chosen = order[filled]
    rows[filled, :30] = np.einsum('ab,mbi->mai', _to_powers(), control[chosen]).reshape(-1, 30)
    rows[filled, 30] = _sagitta(control[chosen])
    rows[filled, 31:] = surface.crease[chosen]
    header = np.array([MARK, leaves, tip_radius_um / unit_um, 0.0])
    return np.concatenate([header, boxes.ravel(), rows.ravel()])


def _leaf_order(control: FloatArray, leaves: int) -> IntArray:
    """Return which patch each leaf holds, -1 for none: halves along the longest side, repeated."""
    middles = control.mean(axis=1)
    order = np.full(leaves, -1)
    order[: len(middles)] = np.arange(len(middles))
    groups = 1
    while groups < leaves:
        size = leaves // groups
        parts = order.reshape(groups, size)
        places = np.where((parts >= 0)[..., None], middles[parts], np.nan)
        with np.errstate(all='ignore'):
            low = np.nanmin(places, axis=1, initial=np.inf)
            high = np.nanmax(places, axis=1, initial=-np.inf)
        axis = np.argmax(high - low, axis=1)
        along = np.take_along_axis(places, axis[:, None, None], axis=2)[..., 0]
        sorting = np.argsort(along, axis=1, kind='stable')  # nan, the empty ones, come last
        order = np.take_along_axis(parts, sorting, axis=1).ravel()
        groups *= 2
    return order


def _to_powers() -> FloatArray:
    """Return the matrix (10, 10) that turns control points into coefficients of u^i v^j."""
    grid = np.array([(i / 3.0, j / 3.0) for i in range(4) for j in range(4 - i)])
    u, v = grid.T
    w = 1.0 - u - v
    bernstein = np.column_stack(
        [
            6.0 / math.prod(map(math.factorial, (a, b, c))) * w**a * u**b * v**c
            for a, b, c in _BERNSTEIN
        ]
    )
    powers = np.column_stack([u**i * v**j for i, j in POWERS])
    return np.linalg.solve(powers, bernstein)


def _sagitta(control: FloatArray) -> FloatArray:
    """Return how far control points (m, 10, 3) are from the plane of the corners at most."""
    normal = np.cross(control[:, 1] - control[:, 0], control[:, 2] - control[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    heights = np.einsum('mki,mi->mk', control[:, 3:] - control[:, :1], normal)
    return np.abs(heights).max(axis=1)
