# SPDX-License-Identifier: Apache-2.0
"""From points with normals to arcs: every span of an outline becomes a biarc."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def arc_spline(
    points_um: FloatArray, normal_angle_rad: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Join points with given normals by arcs, tangent to each other.

    A span is two arcs that meet with a common tangent half way (the biarc with equal tangent
    lengths, [Bolton1975]); a corner (equal points) and a straight edge (normals at right angles
    to the chord) stay as they are. For a smooth curve the error is of third order in the span.

    Parameters
    ----------
    points_um : (n, 2) array
        Closed, counter-clockwise [µm].
    normal_angle_rad : (n,) array
        Outward normals, unwrapped, 2π per turn [rad].

    Returns
    -------
    points_um : (m, 2) array
        The given points and the joints between the arcs of a span, m <= 2 n.
    normal_angle_rad : (m,) array
        Their normals.
    source : (m,) array
        Position in the input: i for point i, i + 0.5 for the joint after it.
    """
    chord = np.roll(points_um, -1, axis=0) - points_um
    end_angle = np.append(normal_angle_rad[1:], normal_angle_rad[0] + 2.0 * math.pi)
    start = np.column_stack([-np.sin(normal_angle_rad), np.cos(normal_angle_rad)])
    end = np.column_stack([-np.sin(end_angle), np.cos(end_angle)])

    # Equal tangent lengths d: |p1 - d t1 - p0 - d t0| = 2 d, solved in the form without
    # cancellation for nearly equal tangents.
    square = np.einsum('ij,ij->i', chord, chord)
    along = np.einsum('ij,ij->i', chord, start + end)
    bend = 2.0 * (1.0 - np.einsum('ij,ij->i', start, end))
    root = along + np.sqrt(along**2 + bend * square)
    has_length = square > (1e-9 * np.ptp(points_um)) ** 2
    tangent_um = np.divide(square, root, out=np.zeros_like(square), where=has_length & (root > 0))
    to_joint = 0.5 * (chord + tangent_um[:, None] * (start - end))
    half_turn = np.arctan2(
        start[:, 0] * to_joint[:, 1] - start[:, 1] * to_joint[:, 0],
        np.einsum('ij,ij->i', start, to_joint),
    )
    joint_angle = normal_angle_rad + 2.0 * half_turn

    straight = np.abs(half_turn) + np.abs(end_angle - joint_angle) < 1e-9
    split = has_length & ~straight
    index = np.arange(len(points_um), dtype=np.float64)
    source = np.concatenate([index, index[split] + 0.5])
    order = np.argsort(source, kind='stable')
    points = np.vstack([points_um, (points_um + to_joint)[split]])[order]
    angles = np.concatenate([normal_angle_rad, joint_angle[split]])[order]
    return points, angles, source[order]
