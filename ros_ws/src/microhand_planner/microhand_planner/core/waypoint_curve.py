# SPDX-License-Identifier: Apache-2.0
"""A smooth curve through the waypoints of a step: a motion before it gets its time law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microhand_planner.core.pose import FloatArray, readonly

CORNER_RAD = np.radians(15.0)
"""A path that turns by more than this has a corner: the tip stops there, and cuts nothing."""

_SMOOTH = 2.0 * np.cos(CORNER_RAD / 2.0)  # |u + v| of unit vectors is 2 cos(turn / 2)


@dataclass(frozen=True)
class WaypointCurve:
    """Cubic Hermite curve through waypoints, for several points at once; C1 in its parameter.

    Between two waypoints that are a length L apart and where the path turns by no more than an
    angle a at either, a point stays within ``L sin(a/2)`` of the straight chord: at corners it
    is on the chord, and on a roll in steps of one degree within a nanometre of the true path.

    Parameters
    ----------
    knots : (n,) float
        Parameter at the waypoints, strictly increasing.
    points : (n, k, 3) float
        The k points at the waypoints.
    slopes : (n, k, 3) float
        Derivative by the parameter at the waypoints.
    """

    knots: FloatArray
    points: FloatArray
    slopes: FloatArray

    def at(self, parameter: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points and derivatives, (m, k, 3) each, at m values of the parameter."""
        interval = np.clip(
            np.searchsorted(self.knots, parameter, side='right') - 1, 0, len(self.knots) - 2
        )
        width = np.diff(self.knots)[interval, None, None]
        x = (parameter - self.knots[interval])[:, None, None] / width
        p0, p1 = self.points[interval], self.points[interval + 1]
        m0, m1 = self.slopes[interval] * width, self.slopes[interval + 1] * width
        chord = p1 - p0
        # the cubic written as chord + deviation, so that equal waypoints stay equal to the bit
        position = p0 + x * (m0 + x * (3 * chord - 2 * m0 - m1 + x * (m0 + m1 - 2 * chord)))
        derivative = m0 + x * (2 * (3 * chord - 2 * m0 - m1) + 3 * x * (m0 + m1 - 2 * chord))
        return position, derivative / width

    def speed_bounds(self) -> tuple[float, float]:
        """Return upper bounds of the derivative: of its length, and of its largest component.

        The derivative is a quadratic between two waypoints and lies in the convex hull of its
        three Bézier coefficients.
        """
        chord_slope = np.diff(self.points, axis=0) / np.diff(self.knots)[:, None, None]
        middle = 3.0 * chord_slope - self.slopes[:-1] - self.slopes[1:]
        coefficients = np.concatenate([self.slopes, middle])
        lengths = np.linalg.norm(coefficients, axis=-1)
        return float(lengths.max()), float(np.abs(coefficients).max())


def corners(points: FloatArray) -> list[int]:
    """Return the waypoints at which a point turns sharply, starts, or stops.

    A curve through them is C1 there only because its slope is zero: whoever follows it at a rate
    above zero brakes and starts again within one chord.

    Parameters
    ----------
    points : (n, k, 3) float
        The k points at the waypoints; between two waypoints at least one of them moves.

    Examples
    --------
    >>> import numpy as np
    >>> corners(np.array([[[0.0, 0, 0]], [[1.0, 0, 0]], [[2.0, 0, 0]], [[2.0, 1, 0]]]))
    [2]
    """
    chord = np.diff(points, axis=0)
    length = np.linalg.norm(chord, axis=-1)
    moves = length > 0.0
    direction = chord / np.where(moves, length, 1.0)[..., None]
    bisector = np.linalg.norm(direction[:-1] + direction[1:], axis=-1)
    sharp = moves[:-1] & moves[1:] & (bisector <= _SMOOTH)
    at = np.any(sharp | (moves[:-1] != moves[1:]), axis=1)
    return [int(before) + 1 for before in np.flatnonzero(at)]


def curve_through(knots: FloatArray, points: FloatArray) -> WaypointCurve:
    """Lay a C1 curve through waypoints that neither overshoots nor cuts corners.

    The slope at a waypoint bisects the directions of the two chords; its size is their weighted
    harmonic mean, so that the curve is monotone along its chords ([Fritsch1984], for vectors).
    At a corner, and where a point starts or stops, the slope is zero.

    Parameters
    ----------
    knots : (n,) float
        Parameter at the waypoints, strictly increasing, n >= 2.
    points : (n, k, 3) float
        The k points at the waypoints.

    Examples
    --------
    >>> import numpy as np
    >>> line = np.array([[[0.0, 0, 0]], [[1.0, 0, 0]], [[2.0, 0, 0]]])
    >>> curve_through(np.array([0.0, 1.0, 2.0]), line).at(np.array([0.25]))[0][0, 0]
    array([0.25, 0.  , 0.  ])
    """
    knots, points = readonly(knots), readonly(points)
    width = np.diff(knots)[:, None]
    secant = np.diff(points, axis=0) / width[..., None]
    speed = np.linalg.norm(secant, axis=-1)
    slopes = np.zeros_like(points)
    slopes[0], slopes[-1] = secant[0], secant[-1]

    before, after = speed[:-1], speed[1:]
    moving = (before > 0.0) & (after > 0.0)
    direction = secant / np.where(speed > 0.0, speed, 1.0)[..., None]
    bisector = direction[:-1] + direction[1:]
    length = np.linalg.norm(bisector, axis=-1)
    smooth = moving & (length > _SMOOTH)
    weight_before, weight_after = 2.0 * width[1:] + width[:-1], width[1:] + 2.0 * width[:-1]
    with np.errstate(divide='ignore', invalid='ignore'):
        mean = (weight_before + weight_after) / (weight_before / before + weight_after / after)
        slopes[1:-1] = np.where(
            smooth[..., None], bisector / length[..., None] * mean[..., None], 0.0
        )
    return WaypointCurve(knots, points, readonly(slopes))
