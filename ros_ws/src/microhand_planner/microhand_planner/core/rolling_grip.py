# SPDX-License-Identifier: Apache-2.0
"""The grip with which two fingers roll: no constant force suits all pairs of contacts.

Two fingers press along the line between their contacts. Where that line makes an angle β with a
normal, the contact slips once the grip exceeds ``µ f_po / (sin β - µ cos β)``; where
``tan β <= µ``, only the largest force of a finger bounds it.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from microhand_planner.core.parameters import ContactLaw, GripRules
from microhand_planner.core.pose import FloatArray


@nb.njit(cache=True)
def largest_grip_uN(
    contact_um: FloatArray,
    normal: FloatArray,
    friction: float,
    pull_off_uN: float,
    max_force_uN: float,
) -> float:  # pragma: no cover - compiled
    """Return the largest grip with which neither of two contacts slips, or -1 [µN].

    Parameters
    ----------
    contact_um, normal : (2, 2) float
        Contacts [µm] and outward normals, in the plane.
    friction, pull_off_uN, max_force_uN : float
        Contact law.

    Examples
    --------
    Both contacts of a pair stand at 28° to their line:

    >>> import numpy as np
    >>> s, c = np.sin(np.radians(28.0)), np.cos(np.radians(28.0))
    >>> contacts, normals = np.array([[8.0, 0.0], [-8.0, 0.0]]), np.array([[c, s], [-c, s]])
    >>> round(largest_grip_uN(contacts, normals, 0.3, 1.5, 30.0), 4)
    2.1996
    """
    dx = contact_um[1, 0] - contact_um[0, 0]
    dy = contact_um[1, 1] - contact_um[0, 1]
    length = np.sqrt(dx * dx + dy * dy)
    if length < 1e-9:
        return -1.0
    largest = max_force_uN
    for contact in range(2):
        sign = (1.0 - 2.0 * contact) / length
        press = -sign * (dx * normal[contact, 0] + dy * normal[contact, 1])
        slide = abs(dy * normal[contact, 0] - dx * normal[contact, 1]) / length
        if slide > friction * press + 1e-12:
            largest = min(largest, friction * pull_off_uN / (slide - friction * press))
        if press > 1e-12:
            largest = min(largest, max_force_uN / press)
        elif press < -1e-12:
            largest = min(largest, -pull_off_uN / press)
    return largest


@nb.njit(cache=True)
def _largest_grips_uN(
    contact_um: FloatArray,
    normal: FloatArray,
    friction: float,
    pull_off_uN: float,
    max_force_uN: float,
) -> FloatArray:  # pragma: no cover - compiled
    """Return `largest_grip_uN` at each of n waypoints."""
    grips_uN = np.zeros(len(contact_um))
    for k in range(len(contact_um)):
        grips_uN[k] = largest_grip_uN(
            contact_um[k], normal[k], friction, pull_off_uN, max_force_uN
        )
    return grips_uN


def rolling_grips_uN(
    contact_um: FloatArray, normal: FloatArray, law: ContactLaw, rules: GripRules
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the grip of two fingers along a roll.

    Parameters
    ----------
    contact_um, normal : (n, 2, 2) float
        Contacts [µm] and outward normals at n waypoints, in the plane.
    law : ContactLaw
        True friction and pull-off.
    rules : GripRules
        Nominal grip, and the shares of the friction to plan with.

    Returns
    -------
    grip_uN, high_uN, margin_uN : (n,) float
        The nominal grip or, where that is less, the largest that rolling allows; that largest;
        and the distance to slipping, detaching and overload with the friction of removals.
    """
    # where nothing sticks, the search has chosen contacts that hold with the friction of removals
    share = min(rules.roll_factor if law.stick_uN > 0.0 else 1.0, rules.margin_factor)
    high_uN = _largest_grips_uN(
        contact_um, normal, share * law.friction, law.stick_uN, law.max_force_uN
    )
    grip_uN = np.minimum(rules.nominal_grip_uN, high_uN)
    line = contact_um[:, 1] - contact_um[:, 0]
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    direction = np.stack([line, -line], axis=1)
    press_uN = -grip_uN[:, None] * np.einsum('nci,nci->nc', direction, normal)
    cross = direction[..., 0] * normal[..., 1] - direction[..., 1] * normal[..., 0]
    slide_uN = grip_uN[:, None] * np.abs(cross)
    friction = rules.margin_factor * law.friction
    margin_uN = np.minimum(
        np.minimum(friction * (press_uN + law.stick_uN) - slide_uN, press_uN + law.stick_uN),
        friction * (law.max_force_uN - press_uN),
    ).min(axis=1)
    return grip_uN, high_uN, margin_uN
