# SPDX-License-Identifier: Apache-2.0
"""How firmly two fingers hold during a step."""

from __future__ import annotations

import math
from dataclasses import dataclass

from microhand_planner.core.errors import InvalidPlan


@dataclass(frozen=True)
class Hold:
    """Grip, the window that it may lie in, and the margin that it leaves.

    Parameters
    ----------
    grip_uN : float
        Force along the line between the two contacts, > 0 pressing [µN]; in a roll the smallest.
    low_uN, high_uN : float
        Grip forces that keep the margin that was asked for [µN].
    margin_uN : float
        Least distance to slipping, detaching and overload, with the friction that was planned
        with [µN].
    """

    grip_uN: float
    low_uN: float
    high_uN: float
    margin_uN: float

    def __post_init__(self) -> None:
        """Check that the values are numbers; they become whole piconewtons."""
        for name, value in list(vars(self).items()):
            if not math.isfinite(value):
                raise InvalidPlan(f'hold: {name}', value, 'a finite number')
            object.__setattr__(self, name, round(float(value), 6))
