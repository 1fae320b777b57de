# SPDX-License-Identifier: Apache-2.0
"""From the points of a cut mesh to the outline that they stand for: what is round, what is not.

Facets must not become corners, and edges must not become round. The rules, in this order:

1. A turn of more than 20° is a corner.
2. Between two smooth turns, a segment is *round* (the chord of an arc), unless at both ends it
   is longer than the segment beside it and agrees better with the curvature beyond if it is
   straight. (A vertex of an arc with chords a, b turns by κ(a + b)/2; where a straight edge of
   length a runs tangentially into the arc, by κb/2.)
3. Between a smooth turn and a corner, a segment is round if the one beyond the smooth turn is,
   and not more than three times shorter.
4. All others are straight. A turn between two straight segments is a corner, however small.

Round stretches become cubic splines through their points, tangent to straight neighbours.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

CORNER_RAD = math.radians(20.0) + 1e-6
COLLINEAR_RAD = 2e-4
SHORTEST_SHARE = 1e-6
"""Segments shorter than this share of the size are points."""
END_RATIO = 3.0
SPLINE_TURN_RAD = 0.02
MOST_SPLINE_PARTS = 8


def smooth_outline(points_um: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Reconstruct the outline behind a polygon.

    Parameters
    ----------
    points_um : (n, 2) array
        Closed polygon, counter-clockwise, with its points on the outline [µm].

    Returns
    -------
    points_um : (m, 2) array
        Points of the outline; twice the same point at a corner [µm].
    normal_angle_rad : (m,) array
        Outward normals, unwrapped [rad].
    source : (m,) array
        Where on the polygon: 2.25 is a quarter of the way from point 2 to point 3; ascending,
        it may run past n.
    """
    count = len(points_um)
    index = _without_collinear(points_um)
    points_um = points_um[index]
    edge = np.roll(points_um, -1, axis=0) - points_um
    length = np.hypot(edge[:, 0], edge[:, 1])
    before = np.roll(edge, 1, axis=0)
    turn = np.arctan2(
        before[:, 0] * edge[:, 1] - before[:, 1] * edge[:, 0], np.einsum('ij,ij->i', before, edge)
    )
    is_round = _round_segments(length, turn)
    is_corner = (np.abs(turn) > CORNER_RAD) | ~(is_round | np.roll(is_round, 1))
    if is_round.all() and not is_corner.any():
        points, tangents, source = _spline(np.vstack([points_um, points_um[:1]]), 'periodic')
        segment = np.minimum(source, len(length) - 1).astype(np.intp)
    else:
        points, tangents, source, segment = _chain(
            points_um, edge / length[:, None], is_round, is_corner
        )

    # The direction of the segment, unwrapped, tells the turn of the normal, also at a needle's
    # point, where the turn is near 180 degrees.
    heading = np.arctan2(edge[0, 1], edge[0, 0]) + np.concatenate([[0.0], np.cumsum(turn[1:])])
    heading = np.concatenate([heading, heading + 2.0 * math.pi])[segment] - 0.5 * math.pi
    lean = np.arctan2(-tangents[:, 0], tangents[:, 1]) - heading
    angle = heading + np.mod(lean + math.pi, 2.0 * math.pi) - math.pi

    following = np.roll(points, -1, axis=0)
    repeated = np.hypot(*(following - points).T) < 1e-12 * np.ptp(points)
    repeated &= np.abs(np.diff(angle, append=angle[0] + 2.0 * math.pi)) < 1e-9
    # The chain may start anywhere, so its sources run up to a turn further.
    numbers = np.concatenate([index, index + count, index[:1] + 2 * count])
    on_polygon = np.interp(source, np.arange(len(numbers)), numbers)
    return points[~repeated], angle[~repeated], on_polygon[~repeated]


def polygon_outline(corners_um: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Take a polygon as it is: every point a corner, every segment straight.

    Parameters and results are those of `smooth_outline`.
    """
    edge = np.roll(corners_um, -1, axis=0) - corners_um
    leaving = np.arctan2(-edge[:, 0], edge[:, 1])
    turn = leaving - np.roll(leaving, 1)
    turn = math.pi - np.mod(math.pi - turn, 2.0 * math.pi)
    leaving = leaving[0] + np.concatenate([[0.0], np.cumsum(turn[1:])])
    angle = np.column_stack([leaving - turn, leaving]).ravel()
    return np.repeat(corners_um, 2, axis=0), angle, np.repeat(np.arange(len(edge)) + 0.0, 2)


def _without_collinear(points_um: FloatArray) -> NDArray[np.intp]:
    """Return the points at which the polygon turns; a plane side is one segment then.

    Every other candidate goes per round, and turns are measured anew: a gentle arc of many small
    turns keeps enough points.
    """
    index = np.arange(len(points_um))
    while len(index) > 4:
        edge = np.roll(points_um[index], -1, axis=0) - points_um[index]
        before = np.roll(edge, 1, axis=0)
        cross = before[:, 0] * edge[:, 1] - before[:, 1] * edge[:, 0]
        flat = np.abs(np.arctan2(cross, np.einsum('ij,ij->i', before, edge))) < COLLINEAR_RAD
        flat |= np.hypot(edge[:, 0], edge[:, 1]) < SHORTEST_SHARE * np.ptp(points_um)
        flat &= ~np.roll(flat, 1) | (np.arange(len(index)) % 2 == 1)
        if not flat.any():
            break
        index = index[~flat]
    return index


def _round_segments(length: FloatArray, turn: FloatArray) -> BoolArray:
    """Tell for each segment i, from point i to i + 1, whether it is the chord of an arc."""
    smooth = np.abs(turn) <= CORNER_RAD
    start_sure, start_open = _looks_straight(length, turn)
    end_sure, end_open = (
        seen[::-1] for seen in _looks_straight(length[::-1], np.roll(turn, -1)[::-1])
    )
    smooth_end = np.roll(smooth, -1)
    straight = (start_sure & (end_sure | end_open)) | (end_sure & start_open)
    is_round = smooth & smooth_end & ~straight
    last = smooth & ~smooth_end & np.roll(is_round, 1) & (length <= END_RATIO * np.roll(length, 1))
    first = (
        ~smooth & smooth_end & np.roll(is_round, -1) & (length <= END_RATIO * np.roll(length, -1))
    )
    return is_round | last | first


def _looks_straight(length: FloatArray, turn: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Tell for each segment whether it looks straight from its start, and whether it may be.

    It *may* be straight where the bend that follows is a single chord: then only its other end
    can tell, for points on one arc with alternating distances look the same.
    """
    beside = np.roll(length, 1)
    beyond = np.roll(length, 2)
    turn_beyond = np.roll(turn, 1)
    if_straight = 2.0 * turn / beside
    if_round = 2.0 * turn / (length + beside)

    def fits(curvature_beyond: FloatArray) -> BoolArray:
        gap = np.abs(if_round - curvature_beyond)
        return np.asarray(np.abs(if_straight - curvature_beyond) < 0.5 * gap)

    longer = length > beside
    to_corner = (np.abs(turn_beyond) > CORNER_RAD) & (length > END_RATIO * beside)
    sure = longer & (fits(2.0 * turn_beyond / (beside + beyond)) | to_corner)
    single = longer & (beyond > END_RATIO * beside) & fits(2.0 * turn_beyond / beside)
    return sure, single


def _chain(
    points_um: FloatArray, direction: FloatArray, is_round: BoolArray, is_corner: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.intp]]:
    """Join straight segments and round stretches.

    Returns
    -------
    points_um, tangents, source, segment
        Of each sample; at a corner the segments before and after have a sample each.
    """
    count = len(points_um)
    ends = np.flatnonzero(is_corner | ~is_round | ~np.roll(is_round, 1))
    points, tangents, sources, segments = [], [], [], []
    for start, stop in zip(ends, np.append(ends[1:], ends[0] + count), strict=True):
        stretch = np.arange(start, stop + 1)
        corner = is_corner[start], is_corner[stop % count]
        if is_round[start]:
            part = _spline(
                points_um[stretch % count],
                (
                    'not-a-knot' if corner[0] else (1, direction[start - 1]),
                    'not-a-knot' if corner[1] else (1, direction[stop % count]),
                ),
            )
        else:
            part = points_um[stretch % count], direction[[start, start]], np.array([0.0, 1.0])
        points.append(part[0])
        tangents.append(part[1])
        sources.append(part[2] + start)
        segments.append(np.minimum(part[2], stop - start - 1).astype(np.intp) + start)
    return (
        np.vstack(points), np.vstack(tangents), np.concatenate(sources), np.concatenate(segments)
    )  # fmt: skip


def _spline(
    points_um: FloatArray, ends: str | tuple[object, object]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sample the cubic spline through points; return points, unit tangents and sources."""
    chord = np.diff(points_um, axis=0)
    knots = np.concatenate([[0.0], np.cumsum(np.hypot(chord[:, 0], chord[:, 1]))])
    spline = CubicSpline(knots, points_um, bc_type=ends)
    slope = spline(knots, 1)
    turn = np.arctan2(
        slope[:-1, 0] * slope[1:, 1] - slope[:-1, 1] * slope[1:, 0],
        np.einsum('ij,ij->i', slope[:-1], slope[1:]),
    )
    parts = np.clip(np.ceil(np.abs(turn) / SPLINE_TURN_RAD), 1, MOST_SPLINE_PARTS).astype(np.intp)
    segment = np.repeat(np.arange(len(parts)), parts)
    number = np.arange(len(segment)) - np.repeat(np.cumsum(parts) - parts, parts)
    source = np.append(segment + number / parts[segment], float(len(parts)))
    at_um = np.interp(source, np.arange(len(knots)), knots)
    tangents = spline(at_um, 1)
    return spline(at_um), tangents / np.linalg.norm(tangents, axis=1)[:, None], source
