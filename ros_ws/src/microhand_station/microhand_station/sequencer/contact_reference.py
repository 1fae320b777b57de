# SPDX-License-Identifier: Apache-2.0
"""Where fingers really met the object → commands that press as hard as the plan says.

A finger presses by how far it is commanded into the object. So what counts is where it touched:
how far that is from the planned contact is added to all its commands until it leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.motions import Motion
from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import FloatArray, readonly
from microhand_planner.core.trajectory import Trajectory

NO_CONTACT = 310

SHORTEST_BLEND_S = 0.05
"""Fingers that stand beside the beginning of a motion are led onto it within this time [s], ..."""
PEAK_OF_BLEND = 1.875
"""... or more slowly; largest speed of the blend over its mean speed."""


@dataclass(frozen=True)
class ContactReference:
    """How far the commands of each finger are from the planned ones.

    Parameters
    ----------
    offset_um : (3, 3) float
        Contact met less contact planned, for fingers 1, 2, 3 [µm]; 0: none met.
    """

    offset_um: FloatArray = field(default_factory=lambda: np.zeros((FINGERS, 3)))

    def __post_init__(self) -> None:
        """Freeze the array."""
        object.__setattr__(self, 'offset_um', readonly(self.offset_um))

    def learn(self, motion: Motion, met_um: FloatArray, tolerance_um: float) -> ContactReference:
        """Return the reference after a guarded motion.

        Parameters
        ----------
        motion : Motion
            What was executed.
        met_um : (3, 3) float
            Where the guarded fingers touched, station frame [µm]; NaN: nothing met.
        tolerance_um : float
            Largest distance from the planned contact [µm].

        Raises
        ------
        RunFailed
            NO_CONTACT: names the finger, and by how much.
        """
        offset_um = np.array(self.offset_um)
        for finger in np.flatnonzero(motion.guarded):
            off_um = met_um[finger] - motion.contact_um[finger]
            if np.isnan(off_um).any():
                raise RunFailed(f'finger {finger + 1} met nothing', NO_CONTACT)
            way_um = motion.contact_um[finger] - motion.trajectory.tip_um[0, finger]
            distance_um = float(np.linalg.norm(off_um))
            if distance_um > tolerance_um:
                when = 'early' if float(off_um @ way_um) < 0.0 else 'late'
                raise RunFailed(
                    f'finger {finger + 1} met the object {distance_um:.2f} µm too {when}; '
                    f'allowed: {tolerance_um:g} µm',
                    NO_CONTACT,
                )
            offset_um[finger] = off_um
        return ContactReference(offset_um)

    def forget(self, in_contact: tuple[bool, bool, bool]) -> ContactReference:
        """Return the reference when only these fingers still touch."""
        return ContactReference(np.where(np.array(in_contact)[:, None], self.offset_um, 0.0))

    def commands(
        self, trajectory: Trajectory, standing_um: FloatArray, speed_um_s: float
    ) -> Trajectory:
        """Return the commands of a motion that begins where the fingers stand.

        Parameters
        ----------
        trajectory : Trajectory
            As planned.
        standing_um : (3, 3) float
            Present commands, station frame [µm].
        speed_um_s : float
            How fast a finger beside its way is led onto it [µm/s].
        """
        aside_um = standing_um - (trajectory.tip_um[0] + self.offset_um)
        farthest_um = float(np.linalg.norm(aside_um, axis=1).max())
        blend_s = max(SHORTEST_BLEND_S, PEAK_OF_BLEND * farthest_um / speed_um_s)
        count = len(trajectory)
        last = min(count - 1, math.ceil(blend_s / trajectory.period_s))
        share = np.minimum(np.arange(count) / max(last, 1), 1.0)
        left = (1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[:, None, None]
        rate = -30.0 * share**2 * (1.0 - share) ** 2 / (max(last, 1) * trajectory.period_s)
        return replace(
            trajectory,
            tip_um=trajectory.tip_um + self.offset_um + left * aside_um,
            velocity_um_s=trajectory.velocity_um_s + rate[:, None, None] * aside_um,
        )
