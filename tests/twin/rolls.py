# SPDX-License-Identifier: Apache-2.0
"""Rolls between two tips, as commands for a simulation."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from microhand_planner.core.pose import Pose

AWAY_UM = (0.0, 0.0, 1000.0)
PERIOD_S = 0.002
RATE_DEG_S = 90.0


@dataclass(frozen=True)
class Rolled:
    """What a roll gave, setpoint by setpoint."""

    angle_deg: np.ndarray
    error_deg: np.ndarray
    friction_use: np.ndarray
    normal_uN: np.ndarray
    offset_um: float

    @property
    def slipped_deg(self):
        """Return the angle at which a tip began to slip."""
        return float(self.angle_deg[np.flatnonzero(self.friction_use > 0.999)[0]])


def roll(simulation, contacts, axis, to_deg, grip_uN):
    """Roll by an angle about an axis; contacts(angles) gives contact points and normals.

    The object is fixed until both tips grip it. The angle grows by the minimum-jerk law.
    """
    count = max(2, int(1.875 * abs(to_deg) / RATE_DEG_S / PERIOD_S))
    share = np.arange(count + 1) / count
    angle_rad = np.radians(to_deg) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    points_um, normals = contacts(angle_rad)
    line = points_um[:, 1] - points_um[:, 0]
    line /= np.linalg.norm(line, axis=1)[:, None]
    radius_um = simulation.world.finger_radius_um
    tips_um = np.zeros((count + 1, 3, 3))
    tips_um[:, :2] = points_um + radius_um * normals
    tips_um[:, 2] = AWAY_UM
    command_um = tips_um.copy()
    stiffness = simulation.world.stiffness_uN_per_um
    command_um[:, 0] += grip_uN * line / stiffness[0]
    command_um[:, 1] -= grip_uN * line / stiffness[1]
    simulation.place(Pose(), tips_um[0], fixed=True)
    simulation.advance(command_um[0], 0.1)
    simulation.release_object()
    simulation.advance(command_um[0], 0.05)
    errors, uses, normals_uN = [], [], []
    for i in range(count + 1):
        simulation.advance(command_um[i], PERIOD_S)
        planned = Rotation.from_rotvec(angle_rad[i] * np.asarray(axis))
        errors.append(np.degrees((planned.inv() * simulation.object_rotation).magnitude()))
        felt = simulation.contacts()
        uses.append(felt.friction_use[:2].max())
        normals_uN.append(felt.normal_uN[:2].copy())
    return Rolled(
        np.degrees(angle_rad),
        np.array(errors),
        np.array(uses),
        np.array(normals_uN),
        float(np.linalg.norm(simulation.object_position_um)),
    )


def along_curve(curve, start_rad, radius_um=4.5):
    """Return contacts(angles) for two tips on an offset curve of the planner."""

    def contacts(angle_rad):
        turned = Rotation.from_rotvec(np.outer(angle_rad, curve.plane.normal))
        found = [curve.at(phase - np.asarray(angle_rad)) for phase in start_rad]
        to_station = [
            (turned.apply(curve.plane.to_object(p.contact_um)),
             turned.apply(curve.plane.to_object(p.normal)))
            for p in found
        ]  # fmt: skip
        return tuple(np.stack(values, axis=1) for values in zip(*to_station, strict=True))

    return contacts
