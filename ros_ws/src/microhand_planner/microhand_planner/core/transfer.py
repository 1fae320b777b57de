# SPDX-License-Identifier: Apache-2.0
"""The ways of a free finger: off the object, around it, and back.

A free finger waits on a sphere about the object's origin, so large that neither the object, in
any orientation, nor a finger that holds it can reach a tip there. On the sphere it travels on
great circles; between the sphere and a contact it moves along the contact's normal, or, where
that is blocked, a tip's radius along the normal and then straight up or down from the plane.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np

from microhand_planner.core.errors import InadmissibleContact
from microhand_planner.core.parameters import Finger
from microhand_planner.core.pose import FloatArray

_SPACING_UM = 1.0  # between waypoints
_ON_SPHERE_RAD = math.radians(3.0)
_TOLERANCE_UM = 1e-6

Blocked = Callable[[FloatArray], bool]
"""Tells whether a tip touches the object at any of the given centres, (k, 3) [µm]."""


def waiting_radius_um(bounding_radius_um: float, finger: Finger) -> float:
    """Return the radius of the sphere on which free fingers wait [µm].

    Tips that hold an object of bounding radius B have their centres within B + r. At
    B + r + `min_distance_um` a tip keeps its distance from them, and so does one on a chord
    between two waypoints, for which the last term is.
    """
    radius_um = bounding_radius_um + finger.radius_um + finger.min_distance_um
    return radius_um / math.cos(0.5 * _ON_SPHERE_RAD)


def way_out(
    contact_centre_um: FloatArray,
    normal: FloatArray,
    plane_normal: FloatArray,
    others_um: FloatArray,
    radius_um: float,
    finger: Finger,
    blocked: Blocked,
) -> FloatArray:
    """Return the way of a tip from its contact to the waiting sphere.

    All vectors are relative to the object's origin, in the frame of the object.

    Parameters
    ----------
    contact_centre_um, normal : (3,) float
        Tip centre at the contact [µm], and outward normal there.
    plane_normal : (3,) float
        Normal of the section plane.
    others_um : (k, 3) float
        Tip centres of the fingers that hold meanwhile [µm].
    radius_um : float
        Radius of the waiting sphere [µm].
    finger : Finger
        For the distance that tips keep.
    blocked : callable
        Whether a tip touches the object at any of the given centres.

    Returns
    -------
    (n, 3) float
        Waypoints from the contact to the sphere [µm].

    Raises
    ------
    InadmissibleContact
        Neither along the normal nor out of the plane is there a free way.
    """
    retreat_um = contact_centre_um + finger.radius_um * normal
    candidates = (
        (contact_centre_um, _onto_sphere(contact_centre_um, normal, radius_um)),
        (contact_centre_um, retreat_um, _onto_sphere(retreat_um, plane_normal, radius_um)),
        (contact_centre_um, retreat_um, _onto_sphere(retreat_um, -plane_normal, radius_um)),
    )
    for corners in candidates:
        way_um = _polyline(corners)
        apart = np.linalg.norm(way_um[:, None, :] - others_um[None, :, :], axis=2)
        if np.all(apart >= finger.min_distance_um - _TOLERANCE_UM) and not blocked(way_um[1:]):
            return way_um
    raise InadmissibleContact(
        'contact',
        f'at {np.round(contact_centre_um, 2).tolist()} um shut in',
        'a contact that a tip can reach along its normal or from above or below the plane',
    )


def way_around(from_um: FloatArray, to_um: FloatArray) -> FloatArray:
    """Return the great circle between two points of a sphere about the origin.

    Parameters
    ----------
    from_um, to_um : (3,) float
        Points at the same distance from the origin [µm].

    Returns
    -------
    (n, 3) float
        Waypoints, both ends included [µm].

    Examples
    --------
    >>> way = way_around(np.array([2.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0]))
    >>> bool(np.allclose(np.linalg.norm(way, axis=1), 2.0))
    True
    """
    radius_um = float(np.linalg.norm(from_um))
    start = from_um / radius_um
    goal = to_um / float(np.linalg.norm(to_um))
    sideways = goal - np.dot(goal, start) * start
    if np.linalg.norm(sideways) < _TOLERANCE_UM:
        # same or opposite point: any direction will do
        sideways = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
    sideways /= np.linalg.norm(sideways)
    angle_rad = math.atan2(float(np.linalg.norm(np.cross(start, goal))), float(start @ goal))
    count = max(1, math.ceil(angle_rad / _ON_SPHERE_RAD)) + 1
    angles = np.linspace(0.0, angle_rad, count)
    way_um = radius_um * (np.outer(np.cos(angles), start) + np.outer(np.sin(angles), sideways))
    way_um[0], way_um[-1] = from_um, to_um
    return np.asarray(way_um)


def _onto_sphere(from_um: FloatArray, direction: FloatArray, radius_um: float) -> FloatArray:
    """Return where a ray from inside a sphere about the origin leaves it."""
    along = float(from_um @ direction)
    distance_um = -along + math.sqrt(along * along + radius_um**2 - float(from_um @ from_um))
    return from_um + distance_um * direction


def _polyline(corners_um: tuple[FloatArray, ...]) -> FloatArray:
    """Return waypoints along straight lines, closely spaced."""
    pieces = []
    for from_um, to_um in itertools.pairwise(corners_um):
        count = max(1, math.ceil(float(np.linalg.norm(to_um - from_um)) / _SPACING_UM))
        pieces.append(np.linspace(from_um, to_um, count, endpoint=False))
    return np.vstack([*pieces, corners_um[-1]])
