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
from numpy.typing import NDArray

from microhand_planner.core.arc_chain import ArcChain
from microhand_planner.core.arc_crossings import LENGTH_TOLERANCE_UM, moving_arcs, self_crossings

FloatArray = NDArray[np.float64]


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
    arcs = _rightmost_first(moving_arcs(arcs, radius_um), radius_um)
    length_um = np.abs(arcs.offset_length_um(radius_um))
    path_um = np.concatenate([[0.0], np.cumsum(length_um)])
    pieces = _walk(self_crossings(arcs, radius_um), float(path_um[-1]))
    return _cut(arcs, path_um, pieces)


def _rightmost_first(arcs: ArcChain, radius_um: float) -> ArcChain:
    """Start the chain where the tip's centre is furthest right: always on the outer boundary."""
    turn = np.abs(arcs.turn_rad)
    to_right = np.mod(-np.sign(arcs.turn_rad) * arcs.normal_angle_rad, 2.0 * math.pi)
    passes = (turn > 0.0) & (to_right < turn)
    place = np.divide(to_right, turn, out=np.zeros(len(arcs)), where=passes)
    contact_um, normal = arcs.points(np.arange(len(arcs)), place)
    best = int((contact_um + radius_um * normal)[:, 0].argmax())
    row = np.concatenate([np.arange(best, len(arcs)), np.arange(best + 1)])
    start, end = np.zeros(len(row)), np.ones(len(row))
    start[0] = end[-1] = place[best]
    return moving_arcs(arcs.clip(row, start, end), radius_um)


def _walk(crossings_um: FloatArray, length_um: float) -> FloatArray:
    """Follow the outer boundary from 0 and return the stretches of path used, (p, 2) [µm]."""
    low, high = crossings_um[np.lexsort(crossings_um.T[::-1])].T
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
