# SPDX-License-Identifier: Apache-2.0
"""A rotation in space as planar rotations about two axes of the object.

``R = Rz(θ1) Ry(θ2) Rz(θ3)``, each about the current object frame ([Kumar2021] §3.1, Eq. 17).
One R has several such triples, and they differ in cost: all that can be cheapest are returned.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

from scipy.spatial.transform import Rotation

_FULL_TURN = 2.0 * math.pi
_NO_ROTATION_RAD = 1e-10


@dataclass(frozen=True)
class PlanarRotation:
    """A rotation about an axis of the object.

    Parameters
    ----------
    axis : str
        ``'z'``: in the XY plane of the object; ``'y'``: in its XZ plane.
    angle_rad : float
        Signed angle [rad].
    """

    axis: str
    angle_rad: float

    @property
    def rotation(self) -> Rotation:
        """The rotation as one of scipy."""
        return Rotation.from_euler(self.axis, self.angle_rad)


def decompositions(rotation: Rotation) -> tuple[tuple[PlanarRotation, ...], ...]:
    """Return all decompositions of a rotation into at most three planar ones.

    Every angle lies within one turn either way; rotations by zero are left out. A rotation
    about z alone is one planar rotation. When the middle angle is a half turn, only the
    difference of the outer two counts, and the whole of it goes to either of them.

    Parameters
    ----------
    rotation : Rotation
        Of the object, about its own frame.

    Returns
    -------
    tuple of tuple of PlanarRotation
        The gentlest (smallest sum of angles) first; one empty tuple for no rotation at all.

    Examples
    --------
    >>> turn = Rotation.from_euler('ZYZ', [80.0, 220.0, 100.0], degrees=True)
    >>> [round(math.degrees(part.angle_rad), 6) for part in decompositions(turn)[0]]
    [-100.0, 140.0, -80.0]
    """
    x, y, z, w = rotation.as_quat()
    middle = 2.0 * math.atan2(math.hypot(x, y), math.hypot(w, z))
    total = 2.0 * math.atan2(z, w)
    difference = 2.0 * math.atan2(-x, y)
    if abs(middle) < _NO_ROTATION_RAD:
        triples = [(total, 0.0, 0.0)]
    elif abs(middle - math.pi) < _NO_ROTATION_RAD:
        triples = [(difference, math.pi, 0.0), (0.0, math.pi, -difference)]
    else:
        first, last = 0.5 * (total + difference), 0.5 * (total - difference)
        triples = [(first, middle, last), (first + math.pi, -middle, last + math.pi)]
    found = {
        tuple(
            PlanarRotation(axis, angle)
            for axis, angle in zip('zyz', angles, strict=True)
            if angle != 0.0
        )
        for triple in triples
        for angles in itertools.product(*(_within_one_turn(angle) for angle in triple))
    }
    return tuple(sorted(found, key=_gentleness))


def _within_one_turn(angle_rad: float) -> tuple[float, ...]:
    """Return the angles in (-2π, 2π) that are the same rotation; zero stays alone."""
    positive = angle_rad % _FULL_TURN
    if min(positive, _FULL_TURN - positive) < _NO_ROTATION_RAD:
        return (0.0,)
    return positive, positive - _FULL_TURN


def _gentleness(parts: tuple[PlanarRotation, ...]) -> tuple[float, tuple[tuple[str, float], ...]]:
    """Return a total order: the sum of the angles, then the angles themselves."""
    total = round(sum(abs(part.angle_rad) for part in parts), 9)
    return total, tuple((part.axis, part.angle_rad) for part in parts)
