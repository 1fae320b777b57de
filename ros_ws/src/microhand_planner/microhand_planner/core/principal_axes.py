# SPDX-License-Identifier: Apache-2.0
"""The principal axes of a solid as its object frame, with signs that do not depend on luck."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

EQUAL_MOMENTS = 1e-4
EQUAL_REACH = 1e-4


def to_principal_axes(vertices_um: FloatArray, faces: IntArray) -> FloatArray:
    """Express the vertices of a solid in the frame of its principal axes of inertia.

    The origin is the centre of mass; X is the axis of least inertia (the longest), Z that of
    most. X and Y point to the side on which the solid reaches further from the centre of mass;
    on a tie, to where their largest component is positive in the given frame. Where moments are
    equal (within 1e-4), any axis is principal, and the ones nearest to the given axes are taken.

    Parameters
    ----------
    vertices_um : (n, 3) array
        Given frame [µm].
    faces : (m, 3) array of int
        Outward.

    Returns
    -------
    (n, 3) array
        Principal frame [µm].
    """
    corners = (vertices_um - vertices_um.mean(axis=0))[faces]
    weight = np.einsum('ij,ij->i', corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    total = corners.sum(axis=1)
    volume6 = weight.sum()
    centre = np.einsum('i,ij->j', weight, total) / (4.0 * volume6)
    # Second moments of a tetrahedron with one corner at the origin.
    squares = np.einsum('i,ij,ik->jk', weight, total, total)
    squares += np.einsum('i,icj,ick->jk', weight, corners, corners)
    covariance = squares / (20.0 * volume6) - np.outer(centre, centre)
    spread, vectors = np.linalg.eigh(covariance)

    from_centre_um = vertices_um - vertices_um.mean(axis=0) - centre
    axes: list[FloatArray] = []
    for index in (2, 1):
        alike = np.abs(spread - spread[index]) <= EQUAL_MOMENTS * spread[2]
        axis = _nearest_to_given(vectors[:, alike], axes)
        along_um = from_centre_um @ axis
        lean = along_um.max() + along_um.min()
        if abs(lean) <= EQUAL_REACH * np.ptp(along_um):
            lean = axis[np.abs(axis).argmax()]
        axes.append(axis if lean > 0.0 else -axis)
    rotation = np.vstack([*axes, np.cross(axes[0], axes[1])])
    return np.asarray(from_centre_um @ rotation.T)


def _nearest_to_given(basis: FloatArray, taken: list[FloatArray]) -> FloatArray:
    """Return the unit vector in a subspace, normal to `taken`, nearest to a coordinate axis."""
    projector = basis @ basis.T
    for axis in taken:
        projector = projector - np.outer(axis, axis @ projector)
    reach = np.linalg.norm(projector, axis=0)
    # The first of nearly equal ones, so that rounding does not decide.
    nearest = int(np.flatnonzero(reach >= reach.max() - 1e-6)[0])
    return np.asarray(projector[:, nearest] / reach[nearest])
