# SPDX-License-Identifier: Apache-2.0
"""Setpoints and measured positions → how late each finger was, and fingers among each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from microhand_station.analysis.finger_record import FingerRecord

_SLOWEST_UM_S = 1.0  # slower fingers say little about time
_FEWEST = 5


def lag_s(finger: FingerRecord, begin_s: float, end_s: float) -> float | None:
    """Return how late a finger was behind its command [s]; None: it hardly moved.

    The delay that, in the sense of least squares, explains best how far the stage was off:
    ``off = -lag * velocity of the command``.

    Parameters
    ----------
    finger : FingerRecord
        Of one finger.
    begin_s, end_s : float
        From when until when, since the start of the run.
    """
    chosen = (finger.state_time_s >= begin_s) & (finger.state_time_s <= end_s) & finger.streaming
    # states out of order say nothing about speeds
    chosen &= finger.state_time_s > np.maximum.accumulate(np.r_[-np.inf, finger.state_time_s[:-1]])
    if chosen.sum() < _FEWEST:
        return None
    time_s, command_um = finger.state_time_s[chosen], finger.commanded_um[chosen]
    velocity_um_s = np.gradient(command_um, time_s, axis=0)
    moving = np.linalg.norm(velocity_um_s, axis=1) > _SLOWEST_UM_S
    if moving.sum() < _FEWEST:
        return None
    off_um = (finger.measured_um[chosen] - command_um)[moving]
    velocity_um_s = velocity_um_s[moving]
    return -float(np.sum(off_um * velocity_um_s) / np.sum(velocity_um_s**2))


def skew_s(fingers: Mapping[int, FingerRecord], begin_s: float, end_s: float) -> float | None:
    """Return the difference between the latest and the earliest finger [s]; None: fewer than two.

    Parameters
    ----------
    fingers : mapping
        Fingers by number.
    begin_s, end_s : float
        From when until when, since the start of the run.
    """
    known = [lag for f in fingers.values() if (lag := lag_s(f, begin_s, end_s)) is not None]
    return max(known) - min(known) if len(known) > 1 else None


def setpoint_skew_s(fingers: Mapping[int, FingerRecord]) -> float | None:
    """Return the largest difference between the times at which fingers were to be at a setpoint.

    0 where all streams have one clock and none is cut short; None: fewer than two fingers.

    Parameters
    ----------
    fingers : mapping
        Fingers by number.
    """
    known = [finger for finger in fingers.values() if len(finger.setpoint_time_s)]
    count = min((len(finger.setpoint_time_s) for finger in known), default=0)
    if len(known) < 2 or not count:
        return None
    times_s = np.stack([finger.setpoint_time_s[:count] for finger in known])
    return float(np.max(times_s.max(axis=0) - times_s.min(axis=0)))
