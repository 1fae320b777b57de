# SPDX-License-Identifier: Apache-2.0
"""How fingers, which are springs, answer a force on the object that they hold."""

from __future__ import annotations

import numpy as np

from microhand_planner.core.pose import FloatArray


def spring_response_uN(
    contact_um: FloatArray, plane_normal: FloatArray, load: FloatArray
) -> FloatArray:
    """Return the forces with which k equal springs answer a wrench in their plane.

    The object moves until the springs balance the load: as a rigid body with three freedoms in
    the plane, held by equal stiffness in all directions at every contact. The stiffness drops out.

    Parameters
    ----------
    contact_um : (k, 3) float
        Contacts [µm], k >= 2.
    plane_normal : (3,) float
        Unit normal of the plane.
    load : (6,) float
        Force [µN] and torque about the origin [µN·µm] on the object.

    Returns
    -------
    (k, 3) float
        Forces of the fingers on the object [µN].

    Examples
    --------
    Two fingers share a force that acts midway between them.

    >>> contacts = np.array([[10.0, 0.0, 0.0], [-10.0, 0.0, 0.0]])
    >>> load = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    >>> (spring_response_uN(contacts, np.array([0.0, 0.0, 1.0]), load) + 0.0).tolist()
    [[0.0, -0.5, 0.0], [0.0, -0.5, 0.0]]
    """
    across = np.cross(plane_normal, np.eye(3)[np.argmin(np.abs(plane_normal))])
    along = np.cross(across, plane_normal)
    basis = np.stack([along, across]) / np.linalg.norm(across)
    # rows: how a contact moves with the object's three freedoms
    moved = np.stack(
        [
            np.column_stack([np.eye(2), basis @ np.cross(plane_normal, at_um)])
            for at_um in contact_um
        ]
    )
    stiffness = np.einsum('kij,kil->jl', moved, moved)
    in_plane = np.array([*(basis @ load[:3]), plane_normal @ load[3:]])
    freedom = np.linalg.solve(stiffness, in_plane)
    return np.asarray(-(moved @ freedom) @ basis)
