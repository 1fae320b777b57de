# SPDX-License-Identifier: Apache-2.0
"""May a finger be removed? The two that stay must balance the pull-off force of the one that goes.

Two contacts in a plane leave one number free: the grip force F along the line that joins them.
Everything that Coulomb's law asks of both contacts is linear in F, so the answer is an interval.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from microhand_planner.core.pose import FloatArray


@nb.njit(cache=True, inline='always')
def narrow(
    low: float, high: float, slope: float, offset: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Intersect ``[low, high]`` with ``{F : slope F + offset >= 0}``."""
    if slope > 1e-12:
        return max(low, -offset / slope), high
    if slope < -1e-12:
        return low, min(high, -offset / slope)
    if offset < -1e-12:
        return 1.0, -1.0
    return low, high


@nb.njit(cache=True)
def contact_lines(
    stay_um: FloatArray,
    stay_normal: FloatArray,
    leave_um: FloatArray,
    leave_normal: FloatArray,
    pull_off_uN: float,
) -> FloatArray:  # pragma: no cover - compiled
    """Return what the pull of a leaving finger does to the two contacts that stay.

    The pull ``pull_off * n`` is answered by the response of two equal springs, and a grip force F
    along the line between the contacts is added to it; so every component is linear in F.

    Returns
    -------
    (2, 4) float
        For each contact the normal force, pressing > 0, and the tangential force in response to
        the pull [µN], and the same two per unit of F. NaN: the two contacts are one.
    """
    lines = np.full((2, 4), np.nan)
    line_x = stay_um[1, 0] - stay_um[0, 0]
    line_y = stay_um[1, 1] - stay_um[0, 1]
    length = math.sqrt(line_x * line_x + line_y * line_y)
    if length < 1e-9:
        return lines
    line_x /= length
    line_y /= length
    pull_x = pull_off_uN * leave_normal[0]
    pull_y = pull_off_uN * leave_normal[1]
    arm_x = leave_um[0] - 0.5 * (stay_um[0, 0] + stay_um[1, 0])
    arm_y = leave_um[1] - 0.5 * (stay_um[0, 1] + stay_um[1, 1])
    couple = (arm_x * pull_y - arm_y * pull_x) / length
    for contact in range(2):
        sign = 1.0 - 2.0 * contact
        base_x = -0.5 * pull_x - sign * couple * line_y
        base_y = -0.5 * pull_y + sign * couple * line_x
        grip_x = sign * line_x
        grip_y = sign * line_y
        normal_x = stay_normal[contact, 0]
        normal_y = stay_normal[contact, 1]
        lines[contact, 0] = -(base_x * normal_x + base_y * normal_y)
        lines[contact, 1] = base_y * normal_x - base_x * normal_y
        lines[contact, 2] = -(grip_x * normal_x + grip_y * normal_y)
        lines[contact, 3] = grip_y * normal_x - grip_x * normal_y
    return lines


@nb.njit(cache=True)
def grip_window_uN(
    stay_um: FloatArray,
    stay_normal: FloatArray,
    leave_um: FloatArray,
    leave_normal: FloatArray,
    friction: float,
    pull_off_uN: float,
    max_force_uN: float,
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return the grip forces with which two fingers let a third one go ([Kumar2021] Eq. 4).

    The leaving finger pulls with ``pull_off * n`` at its contact. The two that stay answer with
    the response of equal springs plus or minus F along the line between them. Wanted is F with
    ``0 <= f_n <= max_force`` and ``|f_t| <= friction (f_n + pull_off)`` at both contacts: they
    must not pull themselves while a third one detaches.

    Parameters
    ----------
    stay_um, stay_normal : (2, 2) float
        Contacts that stay, and outward normals there; object frame in the plane [µm].
    leave_um, leave_normal : (2,) float
        Contact that is given up, and its outward normal.
    friction, pull_off_uN, max_force_uN : float
        Contact law.

    Returns
    -------
    low_uN, high_uN : float
        Range of F [µN], F > 0 pressing; ``low > high``: the finger cannot be removed.

    Examples
    --------
    Two fingers hold a disc on opposite sides; the third, at right angles, lets go.

    >>> import numpy as np
    >>> low, high = grip_window_uN(
    ...     np.array([[10.0, 0.0], [-10.0, 0.0]]), np.array([[1.0, 0.0], [-1.0, 0.0]]),
    ...     np.array([0.0, 10.0]), np.array([0.0, 1.0]), 0.3, 1.5, 30.0)
    >>> round(low, 6), round(high, 6)
    (1.0, 30.0)
    """
    lines = contact_lines(stay_um, stay_normal, leave_um, leave_normal, pull_off_uN)
    if math.isnan(lines[0, 0]):
        return 1.0, -1.0
    low, high = -math.inf, math.inf
    for contact in range(2):
        normal_base, tangent_base, normal_slope, tangent_slope = lines[contact]
        low, high = narrow(low, high, normal_slope, normal_base)
        low, high = narrow(low, high, -normal_slope, max_force_uN - normal_base)
        cone_base = friction * (normal_base + pull_off_uN)
        cone_slope = friction * normal_slope
        low, high = narrow(low, high, cone_slope - tangent_slope, cone_base - tangent_base)
        low, high = narrow(low, high, cone_slope + tangent_slope, cone_base + tangent_base)
        if low > high:
            return 1.0, -1.0
    return low, high


def can_remove(
    stay_um: FloatArray,
    stay_normal: FloatArray,
    leave_um: FloatArray,
    leave_normal: FloatArray,
    friction: float,
    pull_off_uN: float,
    max_force_uN: float,
) -> bool:
    """Return whether any grip force lets the finger go; arguments as `grip_window_uN`."""
    low, high = grip_window_uN(
        np.asarray(stay_um, dtype=np.float64),
        np.asarray(stay_normal, dtype=np.float64),
        np.asarray(leave_um, dtype=np.float64),
        np.asarray(leave_normal, dtype=np.float64),
        friction,
        pull_off_uN,
        max_force_uN,
    )
    return low <= high
