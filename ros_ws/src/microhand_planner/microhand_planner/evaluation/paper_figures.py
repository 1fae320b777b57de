# SPDX-License-Identifier: Apache-2.0
"""What [Kumar2021] prints in its Tables 2, 3 and 4, as data."""

from __future__ import annotations

from dataclasses import dataclass

FRICTIONS = (0.1, 0.3, 0.5)
"""Friction coefficients of Table 2."""


@dataclass(frozen=True)
class GraphSize:
    """A row of Table 2: stable grasps in the graph, in millions.

    Parameters
    ----------
    object_name : str
        As in our catalogue.
    line : str
        L1 is the section by the XY plane, L2 by the XZ plane. The row of the ellipsoid is for
        both, the row of the convex object's L2 is the concave one's as well.
    with_adhesion : float
        Stable grasps, equal for all frictions.
    without_adhesion : tuple of 3 float
        Stable grasps at each of `FRICTIONS`.
    """

    object_name: str
    line: str
    with_adhesion: float
    without_adhesion: tuple[float, float, float]


@dataclass(frozen=True)
class SecondRotation:
    """A row of Table 3: the rotation by 220 deg from [1 38 0 1] to one of six goals.

    Parameters
    ----------
    goal : tuple of 4 int
        ``[i j k l]``.
    cost_deg : float
        f of the goal.
    reconfigurations : int
        Placements and removals.
    time_s, time_with_ties_broken_s : float
        Without and with its tie breaking.
    """

    goal: tuple[int, int, int, int]
    cost_deg: float
    reconfigurations: int
    time_s: float
    time_with_ties_broken_s: float


@dataclass(frozen=True)
class RotationSearch:
    """One search of Table 4.

    Parameters
    ----------
    reconfigurations : int or None
        None: no path available.
    time_s : float
        To find the path.
    waiting, visited : int
        Nodes to be visited when the search ended, and visited.
    """

    reconfigurations: int | None
    time_s: float
    waiting: int
    visited: int


@dataclass(frozen=True)
class WholeRotation:
    """Three rows of Table 4: an object and its rotations about z, y and z.

    Parameters
    ----------
    object_name : str
        As in our catalogue.
    angles_deg : tuple of 3 float
        θ1, θ2, θ3 [deg].
    with_adhesion, without_adhesion : tuple of 3 RotationSearch
        One per rotation.
    """

    object_name: str
    angles_deg: tuple[float, float, float]
    with_adhesion: tuple[RotationSearch, RotationSearch, RotationSearch]
    without_adhesion: tuple[RotationSearch, RotationSearch, RotationSearch]


TABLE_2 = (
    GraphSize('ellipsoid', 'L1', 3.373, (0.6325, 1.527, 2.020)),
    GraphSize('convex', 'L1', 40.65, (12.35, 21.14, 26.32)),
    GraphSize('concave', 'L1', 134.4, (16.96, 31.25, 43.68)),
    GraphSize('convex', 'L2', 42.72, (8.409, 18.0, 25.97)),
)

TABLE_3 = (
    SecondRotation((1, 0, 38, 12), 2240.0, 10, 45.0, 10.0),
    SecondRotation((0, 1, 38, 12), 2240.0, 10, 50.0, 8.0),
    SecondRotation((38, 0, 1, 12), 2240.0, 10, 78.0, 35.0),
    SecondRotation((38, 1, 0, 12), 1880.0, 8, 3.0, 2.0),
    SecondRotation((0, 38, 1, 12), 2240.0, 10, 48.0, 20.0),
    SecondRotation((1, 38, 0, 12), 2600.0, 12, 857.0, 203.0),
)

TABLE_4 = (
    WholeRotation(
        'ellipsoid',
        (80.0, 220.0, 100.0),
        (
            RotationSearch(0, 0.38, 12474, 5),
            RotationSearch(8, 1.1, 4291, 1202),
            RotationSearch(0, 0.01, 206, 6),
        ),
        (
            RotationSearch(None, 34207.0, 654859, 654859),
            RotationSearch(None, 0.09, 164, 164),
            RotationSearch(None, 0.08, 164, 164),
        ),
    ),
    WholeRotation(
        'convex',
        (60.0, 80.0, 40.0),
        (
            RotationSearch(0, 4.96, 41829, 4),
            RotationSearch(6, 0.22, 1469, 25),
            RotationSearch(0, 0.17, 2246, 106),
        ),
        (
            RotationSearch(0, 0.13, 2661, 4),
            RotationSearch(8, 8.80, 30253, 1211),
            RotationSearch(2, 0.17, 2123, 121),
        ),
    ),
    WholeRotation(
        'concave',
        (100.0, 60.0, 20.0),
        (
            RotationSearch(0, 7.13, 60254, 6),
            RotationSearch(4, 2.85, 5586, 101),
            RotationSearch(0, 0.27, 3359, 166),
        ),
        (
            RotationSearch(2, 0.29, 3836, 25),
            RotationSearch(8, 6.62, 25873, 1122),
            RotationSearch(2, 0.12, 1046, 162),
        ),
    ),
)
