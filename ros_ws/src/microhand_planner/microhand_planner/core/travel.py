# SPDX-License-Identifier: Apache-2.0
"""Setpoints against what the stages can do, before anything moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microhand_planner.core.errors import InvalidNumber, InvalidParameter, TravelExceeded
from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import FloatArray, readonly

AXES = 'xyz'


@dataclass(frozen=True)
class StageLimits:
    """What the stage of one finger can do; its axes are parallel to the station's.

    Parameters
    ----------
    base_um : (3,) float
        Where the tip is in the station when the stage is at zero [µm].
    lower_um, upper_um : (3,) float
        Travel, stage frame [µm].
    max_velocity_um_s : float
        Per axis [µm/s].
    max_acceleration_um_s2 : float
        Per axis [µm/s²]; infinite: not limited.
    """

    base_um: FloatArray | Sequence[float]
    lower_um: FloatArray | Sequence[float]
    upper_um: FloatArray | Sequence[float]
    max_velocity_um_s: float
    max_acceleration_um_s2: float = math.inf

    def __post_init__(self) -> None:
        """Check the numbers, freeze the arrays."""
        for name in ('base_um', 'lower_um', 'upper_um'):
            array = readonly(getattr(self, name))
            if array.shape != (3,) or not np.all(np.isfinite(array)):
                raise InvalidNumber(name, array.tolist(), 'three finite numbers')
            object.__setattr__(self, name, array)
        if not np.all(np.less(self.lower_um, self.upper_um)):
            raise InvalidParameter('lower_um', list(self.lower_um), 'less than upper_um')
        for name in ('max_velocity_um_s', 'max_acceleration_um_s2'):
            if not getattr(self, name) > 0.0:
                raise InvalidParameter(name, getattr(self, name), '> 0')

    def to_stage(self, tip_um: FloatArray) -> FloatArray:
        """Station to stage frame: where the stage is when its tip is at `tip_um`, (..., 3)."""
        return tip_um - np.asarray(self.base_um)

    def to_station(self, stage_um: FloatArray) -> FloatArray:
        """Stage to station frame: where the tip is when the stage is at `stage_um`, (..., 3)."""
        return stage_um + np.asarray(self.base_um)


def check_travel(
    tip_um: FloatArray,
    velocity_um_s: FloatArray,
    stages: Sequence[StageLimits],
    period_s: float | None = None,
) -> None:
    """Check that every setpoint is within travel, velocity and acceleration of its stage.

    Parameters
    ----------
    tip_um, velocity_um_s : (n, 3, 3) float
        Setpoints of fingers 1, 2, 3, station frame [µm], [µm/s].
    stages : sequence of 3 StageLimits
        Of fingers 1, 2, 3.
    period_s : float, optional
        Time between two setpoints [s]; needed if the acceleration of a stage is limited.

    Raises
    ------
    TravelExceeded
        Names the finger and the axis that are furthest outside, the demand, and what is allowed.
    InvalidParameter
        An acceleration is limited, and there is no period.
    """
    for finger in range(FINGERS):
        stage = stages[finger]
        _check_position(finger, tip_um[:, finger], stage)
        _check_at_most(finger, 'moving', velocity_um_s[:, finger], stage.max_velocity_um_s, 'µm/s')
        if math.isinf(stage.max_acceleration_um_s2):
            continue
        if period_s is None:
            raise InvalidParameter('period_s', None, 'a number where accelerations are limited')
        _check_at_most(
            finger,
            'accelerating',
            np.diff(velocity_um_s[:, finger], axis=0) / period_s,
            stage.max_acceleration_um_s2,
            'µm/s²',
        )


def _check_position(finger: int, tip_um: FloatArray, stage: StageLimits) -> None:
    """Check that tips (n, 3) are within the travel of a stage."""
    tolerance_um = 1e-6  # rounding of setpoints that are meant to be at the limit
    demanded = stage.to_stage(tip_um)
    lower, upper = np.asarray(stage.lower_um), np.asarray(stage.upper_um)
    excess = np.maximum(lower - demanded, demanded - upper)
    at, axis = np.unravel_index(np.argmax(excess), excess.shape)
    if excess[at, axis] > tolerance_um:
        raise TravelExceeded(
            f'finger {finger + 1} {AXES[axis]}',
            f'at {demanded[at, axis]:.3f} µm of its stage',
            f'{lower[axis]:.3f} to {upper[axis]:.3f} µm',
        )


def _check_at_most(finger: int, does: str, demanded: FloatArray, most: float, unit: str) -> None:
    """Check that no component of vectors (n, 3) is larger than allowed."""
    size = np.abs(demanded)
    if size.max(initial=0.0) > most * (1.0 + 1e-9):
        at, axis = np.unravel_index(np.argmax(size), size.shape)
        raise TravelExceeded(
            f'finger {finger + 1} {AXES[axis]}',
            f'{does} at {size[at, axis]:.1f} {unit}',
            f'up to {most:.1f} {unit}',
        )
