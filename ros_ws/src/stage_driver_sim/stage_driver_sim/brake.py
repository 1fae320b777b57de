# SPDX-License-Identifier: Apache-2.0
"""From a velocity to rest: the ramp behind every stop."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stage_driver_sim.protocol import Vector


@dataclass(frozen=True, eq=False)
class Brake:
    """Constant deceleration along the direction of motion.

    All axes come to rest together: the stage leaves its path only ahead, never sideways.

    Parameters
    ----------
    begin_s : float
        When braking begins [s].
    position_um : (3,) ndarray
        Command at that time [µm].
    velocity_um_s : (3,) ndarray
        Velocity of the command at that time [µm/s].
    deceleration_um_s2 : float
        Deceleration along the path [µm/s²], > 0.

    Examples
    --------
    >>> import numpy as np
    >>> brake = Brake(0.0, np.zeros(3), np.array([200.0, 0.0, 0.0]), deceleration_um_s2=1000.0)
    >>> brake.end_s, brake.position_at(1.0).tolist()
    (0.2, [20.0, 0.0, 0.0])
    """

    begin_s: float
    position_um: Vector
    velocity_um_s: Vector
    deceleration_um_s2: float

    @property
    def end_s(self) -> float:
        """When the command comes to rest [s]."""
        return self.begin_s + math.hypot(*self.velocity_um_s.tolist()) / self.deceleration_um_s2

    def position_at(self, time_s: float) -> Vector:
        """Return the commanded position [µm] at `time_s` [s]; at rest after `end_s`."""
        duration_s = self.end_s - self.begin_s
        if duration_s <= 0.0:
            return self.position_um
        t = min(max(time_s - self.begin_s, 0.0), duration_s)
        return self.position_um + self.velocity_um_s * (t - 0.5 * t * t / duration_s)
