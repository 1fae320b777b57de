# SPDX-License-Identifier: Apache-2.0
"""Where the object is in the station.

Convention, stated once: quaternions are ``w x y z`` in the core and on the command line
(ROS messages have ``x y z w``); rotations are about the *current object frame*, so that
``R_goal = R_start * R`` ([Kumar2021] Eq. 17).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import InvalidNumber, InvalidParameter, InvalidRotation

# Lengths of plans are whole picometres: they survive the way through metres and text unchanged.
LENGTH_DIGITS = 6
FARTHEST_UM = 1e5  # 10 cm: nothing is farther away in a micro-manipulation station

_UNIT_LENGTH = 1e-12

FloatArray = npt.NDArray[np.float64]


def readonly(values: npt.ArrayLike) -> FloatArray:
    """Return a float copy of `values` that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and orientation of the object in the station frame.

    Parameters
    ----------
    position_um : (3,) float
        Origin of the object frame [µm], station frame.
    quaternion_wxyz : (4,) float
        Orientation; normalised here, sign such that w >= 0.

    Raises
    ------
    InvalidNumber
        NaN or infinite values.
    InvalidParameter
        A position more than 10 cm away.
    InvalidRotation
        A quaternion of zero length or a wrong number of values.

    Examples
    --------
    >>> Pose().quaternion_wxyz.tolist()
    [1.0, 0.0, 0.0, 0.0]
    """

    position_um: FloatArray | Sequence[float] = (0.0, 0.0, 0.0)
    quaternion_wxyz: FloatArray | Sequence[float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Check, normalise, freeze."""
        position = readonly(np.round(self.position_um, LENGTH_DIGITS))
        quaternion = np.array(self.quaternion_wxyz, dtype=np.float64)
        if position.shape != (3,) or not np.all(np.isfinite(position)):
            raise InvalidNumber('position', position.tolist(), 'three finite numbers')
        if np.max(np.abs(position)) > FARTHEST_UM:
            raise InvalidParameter('position', position.tolist(), f'up to {FARTHEST_UM:g} um away')
        if quaternion.shape != (4,):
            raise InvalidRotation('quaternion', quaternion.tolist(), 'four numbers w x y z')
        length = float(np.linalg.norm(quaternion))
        if not np.isfinite(length) or length < 1e-9:
            raise InvalidRotation(
                'quaternion', quaternion.tolist(), 'four finite numbers w x y z, not all zero'
            )
        if abs(length - 1.0) > _UNIT_LENGTH:  # a unit quaternion stays what it is, to the last bit
            quaternion /= length
        # q and -q are one rotation: choose, so that equal poses are equal bytes
        leading = quaternion[np.flatnonzero(np.abs(quaternion) > 1e-12)[0]]
        object.__setattr__(self, 'position_um', position)
        object.__setattr__(self, 'quaternion_wxyz', readonly(quaternion * np.sign(leading)))

    def __eq__(self, other: object) -> bool:
        """Return whether both are the same numbers: arrays have no truth value of their own."""
        if not isinstance(other, Pose):
            return NotImplemented
        return np.array_equal(self.position_um, other.position_um) and np.array_equal(
            self.quaternion_wxyz, other.quaternion_wxyz
        )

    def __hash__(self) -> int:
        """Return a hash that equal poses share."""
        return hash((*self.position_um, *self.quaternion_wxyz))

    @classmethod
    def of(cls, position_um: npt.ArrayLike, rotation: Rotation) -> Pose:
        """Make a pose from a position and a rotation of scipy."""
        x, y, z, w = rotation.as_quat()
        return cls(np.asarray(position_um, dtype=np.float64), (w, x, y, z))

    @property
    def rotation(self) -> Rotation:
        """The orientation as a rotation of scipy: object frame to station frame."""
        w, x, y, z = self.quaternion_wxyz
        return Rotation.from_quat((x, y, z, w))


def angle_between_rad(first: Rotation, second: Rotation) -> float:
    """Return the angle of the rotation between two orientations [rad]."""
    return float((first.inv() * second).magnitude())
