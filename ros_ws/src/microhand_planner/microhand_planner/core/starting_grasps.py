# SPDX-License-Identifier: Apache-2.0
"""The grasps from which a rotation may begin when none is given, the firmest first."""

from __future__ import annotations

import numpy as np

from microhand_planner.core.parameters import Finger
from microhand_planner.core.rotation_lattice import IntArray, RotationLattice
from microhand_planner.core.search_state import ABSENT


def starting_grasps(lattice: RotationLattice, orientation: int, finger: Finger) -> IntArray:
    """Return all grasps of fingers 1 and 2 at an orientation.

    Firm is a grasp whose line of contact lies close to both normals: it needs the least
    friction. Fingers are interchangeable, so finger 1 takes the track with the smaller number.

    Parameters
    ----------
    lattice : RotationLattice
        The planar problem.
    orientation : int
        Index of the orientation.
    finger : Finger
        For the distance that tips keep.

    Returns
    -------
    (k, 3) int
        Tracks of fingers 1, 2, 3; the third is free.
    """
    samples = lattice.sample_of[:, orientation]
    first, second = np.triu_indices(len(samples), k=1)
    centres = lattice.centre_um[samples]
    apart = np.linalg.norm(centres[first] - centres[second], axis=1)
    usable = lattice.usable[samples]
    keep = usable[first] & usable[second] & (apart >= finger.min_distance_um)
    first, second = first[keep], second[keep]

    line = lattice.contact_um[samples[second]] - lattice.contact_um[samples[first]]
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    normal = lattice.normal[samples]
    press = np.minimum(
        -np.einsum('ij,ij->i', line, normal[first]), np.einsum('ij,ij->i', line, normal[second])
    )
    firmest = np.lexsort((second, first, -np.round(press, 9)))
    grasps = np.full((len(firmest), 3), ABSENT, dtype=np.int64)
    grasps[:, 0] = first[firmest]
    grasps[:, 1] = second[firmest]
    return grasps
