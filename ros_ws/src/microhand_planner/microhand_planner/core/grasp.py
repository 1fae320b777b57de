# SPDX-License-Identifier: Apache-2.0
"""Which grasps are stable.

With adhesion every grasp whose tips do not overlap is stable: zero force is in every cone
([Kumar2021] Eq. 1 and 3, no external wrench). Without it the fingers must press, and the
equilibrium must exist inside the Coulomb cones.
"""

from __future__ import annotations

import itertools
import math

import numba as nb
import numpy as np

from microhand_planner.core.pose import FloatArray

_TINY = 1e-9
_SHARE = 1e-7  # of the largest force: less is none
_FOURS = np.array(list(itertools.combinations(range(6), 4)))


@nb.njit(cache=True)
def tips_clear(
    first_um: FloatArray, second_um: FloatArray, min_distance_um: float
) -> bool:  # pragma: no cover - compiled
    """Return whether two tip centres, (2,) [µm], are at least `min_distance_um` apart."""
    dx = first_um[0] - second_um[0]
    dy = first_um[1] - second_um[1]
    return dx * dx + dy * dy >= (min_distance_um - _TINY) ** 2


@nb.njit(cache=True)
def pair_presses(
    contact_um: FloatArray, normal: FloatArray, friction: float
) -> bool:  # pragma: no cover - compiled
    """Return whether two fingers can hold by pressing alone.

    Two forces balance only along the line between the contacts, so that line must lie in both
    Coulomb cones.

    Parameters
    ----------
    contact_um, normal : (2, 2) float
        Contacts [µm] and outward normals.
    friction : float
        Coulomb coefficient.
    """
    dx = contact_um[1, 0] - contact_um[0, 0]
    dy = contact_um[1, 1] - contact_um[0, 1]
    length = math.sqrt(dx * dx + dy * dy)
    for contact in range(2):
        sign = 1.0 - 2.0 * contact
        press = -sign * (dx * normal[contact, 0] + dy * normal[contact, 1])
        slide = abs(dy * normal[contact, 0] - dx * normal[contact, 1])
        if press <= _TINY * length or slide > friction * press + _TINY * length:
            return False
    return True


@nb.njit(cache=True)
def _normals_balance(
    contact_um: FloatArray, normal: FloatArray, scale_um: float
) -> bool:  # pragma: no cover - compiled
    """Return whether three forces along the normals balance, all of them pressing."""
    along = np.zeros(3)
    moment = 0.0
    for contact in range(3):
        j, k = (contact + 1) % 3, (contact + 2) % 3
        along[contact] = normal[j, 0] * normal[k, 1] - normal[j, 1] * normal[k, 0]
        lever = contact_um[contact, 0] * normal[contact, 1]
        lever -= contact_um[contact, 1] * normal[contact, 0]
        moment += along[contact] * lever / scale_um
    same_sign = along.min() > _SHARE or along.max() < -_SHARE
    return same_sign and abs(moment) <= _TINY


@nb.njit(cache=True)
def triple_presses(
    contact_um: FloatArray, normal: FloatArray, friction: float
) -> bool:  # pragma: no cover - compiled
    """Return whether three fingers can hold with every one of them pressing.

    The forces are non-negative combinations of the six edges of the cones; those in equilibrium
    form a cone whose extreme rays use at most four edges. A finger can press if it does in one
    of these rays, and all three can press together if each can (add the rays).

    Parameters
    ----------
    contact_um, normal : (3, 2) float
        Contacts [µm] and outward normals.
    friction : float
        Coulomb coefficient.
    """
    scale = 0.0
    for contact in range(3):
        scale = max(scale, abs(contact_um[contact, 0]), abs(contact_um[contact, 1]))
    if friction == 0.0:  # the edges of a cone coincide, and the six of them span too little
        return _normals_balance(contact_um, normal, scale)
    fx = np.zeros(6)
    fy = np.zeros(6)
    moment = np.zeros(6)
    for edge in range(6):
        contact = edge // 2
        slide = friction * (1.0 - 2.0 * (edge % 2))
        fx[edge] = -normal[contact, 0] - slide * normal[contact, 1]
        fy[edge] = -normal[contact, 1] + slide * normal[contact, 0]
        moment[edge] = (
            contact_um[contact, 0] * fy[edge] - contact_um[contact, 1] * fx[edge]
        ) / scale
    presses = np.zeros(3, dtype=np.bool_)
    ray = np.zeros(4)
    for kept in _FOURS:
        # the kernel of four edges is one ray: its entries are the 3x3 minors, signs alternating
        for out in range(4):
            i = kept[0] if out > 0 else kept[1]
            j = kept[1] if out > 1 else kept[2]
            k = kept[2] if out > 2 else kept[3]
            minor = (
                fx[i] * (fy[j] * moment[k] - fy[k] * moment[j])
                - fx[j] * (fy[i] * moment[k] - fy[k] * moment[i])
                + fx[k] * (fy[i] * moment[j] - fy[j] * moment[i])
            )
            ray[out] = minor if out % 2 == 0 else -minor
        low = ray.min()
        high = ray.max()
        if high < -low:
            low, high = -high, -low
            ray *= -1.0
        if high <= _TINY or low < -10.0 * _TINY:
            continue
        for col in range(4):
            if ray[col] > _SHARE * high:
                presses[kept[col] // 2] = True
    return presses[0] and presses[1] and presses[2]
