# SPDX-License-Identifier: Apache-2.0
"""The grip with which a finger can be removed for certain: before, while and after it pulls.

[Kumar2021] Eq. 4 asks for forces that balance the pull of the leaving finger. A real grip must
hold without that pull, too, and the fingers, which are springs, do not choose anew in between:
one and the same grip force F must do for the pull of 0, of the pull-off force, and all between.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from microhand_planner.core.hold import Hold
from microhand_planner.core.parameters import ContactLaw, GripRules
from microhand_planner.core.pose import FloatArray
from microhand_planner.core.removal import contact_lines, narrow


@nb.njit(cache=True)
def preload_window_uN(
    stay_um: FloatArray,
    stay_normal: FloatArray,
    leave_um: FloatArray,
    leave_normal: FloatArray,
    friction: float,
    pull_off_uN: float,
    max_force_uN: float,
    margin_uN: float,
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return the grip forces F that keep a margin while a third finger is removed.

    With the pull at s = 0 and s = 1 times the pull-off force, and so for all s between, both
    contacts that stay keep ``friction (f_n + pull_off) - |f_t|``, ``f_n + pull_off`` and
    ``friction (max_force - f_n)`` at `margin_uN` or above.

    Parameters
    ----------
    stay_um, stay_normal, leave_um, leave_normal : float arrays
        As in `grip_window_uN`.
    friction, pull_off_uN, max_force_uN, margin_uN : float
        Contact law, and the margin.

    Returns
    -------
    low_uN, high_uN : float
        Range of F [µN], F > 0 pressing; ``low > high``: no grip keeps the margin.

    Examples
    --------
    As for `grip_window_uN`: the pull is shared by two contacts, where it is tangential.

    >>> import numpy as np
    >>> low, high = preload_window_uN(
    ...     np.array([[10.0, 0.0], [-10.0, 0.0]]), np.array([[1.0, 0.0], [-1.0, 0.0]]),
    ...     np.array([0.0, 10.0]), np.array([0.0, 1.0]), 0.3, 1.5, 30.0, 0.0)
    >>> round(low, 6), round(high, 6)
    (1.0, 30.0)
    """
    lines = contact_lines(stay_um, stay_normal, leave_um, leave_normal, pull_off_uN)
    if math.isnan(lines[0, 0]):
        return 1.0, -1.0
    low, high = -math.inf, math.inf
    for contact in range(2):
        slope = lines[contact, 2]
        slide = lines[contact, 3]
        for pull in (0.0, 1.0):
            normal = pull * lines[contact, 0]
            tangent = pull * lines[contact, 1]
            cone = friction * (normal + pull_off_uN) - margin_uN
            low, high = narrow(low, high, friction * slope - slide, cone - tangent)
            low, high = narrow(low, high, friction * slope + slide, cone + tangent)
            low, high = narrow(low, high, slope, normal + pull_off_uN - margin_uN)
            over = friction * (max_force_uN - normal) - margin_uN
            low, high = narrow(low, high, -friction * slope, over)
        if low > high:
            return 1.0, -1.0
    return low, high


def preload(
    stay_um: FloatArray,
    stay_normal: FloatArray,
    leave_um: FloatArray,
    leave_normal: FloatArray,
    law: ContactLaw,
    rules: GripRules,
) -> Hold:
    """Return the smallest grip with enough margin for a removal; arguments in the plane.

    Parameters
    ----------
    stay_um, stay_normal : (2, 2) float
        Contacts that stay [µm], and outward normals there.
    leave_um, leave_normal : (2,) float
        Contact that is given up, and its outward normal.
    law : ContactLaw
        True friction and pull-off.
    rules : GripRules
        Share of the friction to plan with, and the margin.

    Returns
    -------
    Hold
        ``low_uN > high_uN``: there is no such grip.
    """
    friction = rules.margin_factor * law.friction
    low_uN, high_uN = preload_window_uN(
        stay_um,
        stay_normal,
        leave_um,
        leave_normal,
        friction,
        law.stick_uN,
        law.max_force_uN,
        rules.least_margin_uN,
    )
    room_uN = min(rules.grip_tolerance_uN, 0.5 * max(0.0, high_uN - low_uN))
    grip_uN = (
        float(np.clip(0.0, low_uN + room_uN, high_uN - room_uN)) if low_uN <= high_uN else 0.0
    )
    lines = contact_lines(stay_um, stay_normal, leave_um, leave_normal, law.stick_uN)
    margin_uN = min(
        contact_margin_uN(
            pull * line[0] + grip_uN * line[2], pull * line[1] + grip_uN * line[3], friction, law
        )
        for line in lines
        for pull in (0.0, 1.0)
    )
    return Hold(grip_uN, low_uN, high_uN, margin_uN)


def contact_margin_uN(
    normal_uN: float, tangent_uN: float, friction: float, law: ContactLaw
) -> float:
    """Return how far a contact force is from slipping, detaching and overload [µN]."""
    return min(
        friction * (normal_uN + law.stick_uN) - abs(tangent_uN),
        normal_uN + law.stick_uN,
        friction * (law.max_force_uN - normal_uN),
    )
