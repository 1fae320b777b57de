# SPDX-License-Identifier: Apache-2.0
"""A section: the smooth closed outline in which a manipulation plane meets the object."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.arc_chain import ArcChain

FloatArray = NDArray[np.float64]

ARC_TOLERANCE_RAD = 1e-6


def frozen_array(values: FloatArray) -> FloatArray:
    """Return a read-only float64 copy."""
    copy = np.array(values, dtype=np.float64)
    copy.setflags(write=False)
    return copy


@dataclass(frozen=True)
class Plane:
    """A manipulation plane through the origin of the object frame.

    Both planes contain the X axis, and +X is their first direction u; so joint I is at angle 0
    in each of them. A positive angle in the plane is a positive rotation about its normal.

    Parameters
    ----------
    axis : {'z', 'y'}
        The normal: 'z' is the XY plane (u = X, v = Y), 'y' the XZ plane (u = X, v = −Z).

    Examples
    --------
    >>> Plane('y').to_object(np.array([[2.0, 1.0]])).tolist()
    [[2.0, 0.0, -1.0]]
    """

    axis: Literal['z', 'y']

    def __post_init__(self) -> None:
        """Check the axis."""
        if self.axis not in ('z', 'y'):
            raise ValueError(f"axis is {self.axis!r}; allowed: 'z' or 'y'")

    @property
    def e_u(self) -> FloatArray:
        """First direction, object frame, (3,)."""
        return np.array([1.0, 0.0, 0.0])

    @property
    def e_v(self) -> FloatArray:
        """Second direction, object frame, (3,)."""
        return np.array([0.0, 1.0, 0.0] if self.axis == 'z' else [0.0, 0.0, -1.0])

    @property
    def normal(self) -> FloatArray:
        """Normal e_u × e_v, object frame, (3,)."""
        return np.array([0.0, 0.0, 1.0] if self.axis == 'z' else [0.0, 1.0, 0.0])

    def to_object(self, points_um: FloatArray) -> FloatArray:
        """Turn plane coordinates (k, 2) into object coordinates (k, 3)."""
        return points_um @ np.vstack([self.e_u, self.e_v])

    def to_plane(self, points_um: FloatArray) -> FloatArray:
        """Turn object coordinates (k, 3) into plane coordinates (k, 2); drops the height."""
        return points_um @ np.column_stack([self.e_u, self.e_v])


XY_PLANE = Plane('z')
XZ_PLANE = Plane('y')


@dataclass(frozen=True)
class Section:
    """A closed, counter-clockwise chain of circular arcs.

    Sample i is a point of the outline and the direction of its outward normal. Between two
    samples the outline is a circular arc: of zero curvature (equal angles, a straight edge), of
    zero length (equal points, a corner: the normal turns on the spot), or in between. The
    chain closes from the last sample to the first, one turn further. Arcs make everything that
    follows exact: the path of a tip's centre along an arc is an arc, about a corner an arc,
    along an edge a line.

    Parameters
    ----------
    plane : Plane
        Where the section lies.
    points_um : (n, 2) array
        Points of the outline, plane coordinates [µm].
    normal_angle_rad : (n,) array
        Angle of the outward normal from +u [rad], unwrapped: it grows by 2π over the turn.
    out_of_plane_sin : (n,) array, optional
        Sine of the angle between the surface normal of the solid and the plane; 0 if not given.
    facet_gap_um : float
        Largest distance between this outline and the facets that it smooths [µm].
    ignored_loops : int
        Further loops in which the plane meets the solid, left out.

    Raises
    ------
    ValueError
        The samples are no such chain.
    """

    plane: Plane
    points_um: FloatArray
    normal_angle_rad: FloatArray
    out_of_plane_sin: FloatArray = field(default_factory=lambda: np.zeros(0))
    facet_gap_um: float = 0.0
    ignored_loops: int = 0
    arc_length_um: FloatArray = field(init=False)
    turn_rad: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Check the chain and derive length and turn of its arcs."""
        points = frozen_array(self.points_um)
        angles = frozen_array(self.normal_angle_rad)
        given = len(self.out_of_plane_sin) > 0
        slopes = frozen_array(self.out_of_plane_sin if given else np.zeros(len(angles)))
        if points.ndim != 2 or points.shape[1] != 2 or angles.shape != points.shape[:1]:
            raise ValueError(f'{points.shape} points do not fit {angles.shape} angles')
        if slopes.shape != angles.shape or len(angles) < 3:
            raise ValueError('a section needs at least 3 samples, all columns equally long')
        if not all(np.isfinite(values).all() for values in (points, angles, slopes)):
            raise ValueError('a section has NaN or infinite samples')
        chord = np.roll(points, -1, axis=0) - points
        turn = np.diff(angles, append=angles[0] + 2.0 * math.pi)
        chord_um = np.hypot(chord[:, 0], chord[:, 1])
        most_rad = np.where(chord_um > 0.0, 2.0 * math.pi - 1e-6, math.pi)
        if (np.abs(turn) > most_rad).any():
            raise ValueError('the normal turns too far: 180 deg at a corner, 360 deg on an arc')
        middle = angles + 0.5 * turn
        across = np.abs(chord[:, 0] * np.cos(middle) + chord[:, 1] * np.sin(middle))
        along = chord[:, 1] * np.cos(middle) - chord[:, 0] * np.sin(middle)
        smallest = ARC_TOLERANCE_RAD * chord_um + 1e-9 * np.ptp(points)
        if (across > smallest).any() or (along < -smallest).any():
            raise ValueError('points and normals do not fit one arc between neighbours')
        length = chord_um / np.sinc(turn / (2.0 * math.pi))
        for name, values in (
            ('points_um', points),
            ('normal_angle_rad', angles),
            ('out_of_plane_sin', slopes),
            ('arc_length_um', frozen_array(length)),
            ('turn_rad', frozen_array(turn)),
        ):
            object.__setattr__(self, name, values)

    @property
    def perimeter_um(self) -> float:
        """Length of the outline [µm]."""
        return float(self.arc_length_um.sum())

    @property
    def arcs(self) -> ArcChain:
        """The outline as a run of arcs, closed."""
        slope = self.out_of_plane_sin
        return ArcChain(
            self.points_um,
            self.normal_angle_rad,
            self.turn_rad,
            self.arc_length_um,
            slope,
            np.roll(slope, -1) - slope,
        )

    @property
    def is_convex(self) -> bool:
        """Whether the normal never turns back."""
        return bool((self.turn_rad >= 0.0).all())
