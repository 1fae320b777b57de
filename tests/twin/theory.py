# SPDX-License-Identifier: Apache-2.0
"""What the twin must show, from formulas: rolls of an ellipse between two tips."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq


@dataclass(frozen=True)
class Ellipse:
    """The section of an ellipsoid, rolled between two tips that begin at (±a, 0)."""

    a_um: float
    b_um: float
    tip_um: float = 4.5

    def contacts(self, angle_rad):
        """Return contact points (n, 2, 3) and normals of both tips, turned with the object.

        While the object turns by θ, the centre of each tip moves by r θ along its path, backwards.
        """
        grid = np.linspace(-np.pi, np.pi, 4001)
        stretch = np.hypot(self.a_um * np.sin(grid), self.b_um * np.cos(grid))
        speed = stretch + self.tip_um * self.a_um * self.b_um / stretch**2
        travel = CubicSpline(grid, speed).antiderivative()(grid)
        travel -= travel[2000]  # from parameter 0
        parameter = CubicSpline(travel, grid)(-self.tip_um * np.asarray(angle_rad))
        points = np.column_stack(
            [self.a_um * np.cos(parameter), self.b_um * np.sin(parameter), 0.0 * parameter]
        )
        normals = np.column_stack(
            [np.cos(parameter) / self.a_um, np.sin(parameter) / self.b_um, 0.0 * parameter]
        )
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        cos, sin = np.cos(angle_rad), np.sin(angle_rad)
        turned = [
            np.column_stack(
                [cos * v[:, 0] - sin * v[:, 1], sin * v[:, 0] + cos * v[:, 1], v[:, 2]]
            )
            for v in (points, normals)
        ]
        return tuple(np.stack([v, -v * [1.0, 1.0, -1.0]], axis=1) for v in turned)

    def slip_deg(self, grip_uN, friction, pull_off_uN):
        """Return the angle at which two tips slip: sin β F = µ (cos β F + f_po)."""

        def room(angle_rad):
            points, normals = self.contacts(np.array([angle_rad]))
            line = points[0, 1] - points[0, 0]
            cos = -(line @ normals[0, 0]) / np.linalg.norm(line)
            return friction * (grip_uN * cos + pull_off_uN) - grip_uN * np.sqrt(1.0 - cos**2)

        angles = np.radians(np.arange(40.0, 130.0, 5.0))
        rooms = np.array([room(angle) for angle in angles])
        first = int(np.flatnonzero(rooms < 0.0)[0])
        return float(np.degrees(brentq(room, angles[first - 1], angles[first])))
