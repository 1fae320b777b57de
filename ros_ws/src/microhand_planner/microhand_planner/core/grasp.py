# SPDX-License-Identifier: Apache-2.0
"""Which grasps are stable.

With adhesion every grasp whose tips do not overlap is stable: zero force is in every cone
([Kumar2021] Eq. 1 and 3, no external wrench). Without it the fingers must press, and the
equilibrium must exist inside the Coulomb cones.
"""

from __future__ import annotations

import math

import numba as nb

from microhand_planner.core.pose import FloatArray

_TINY = 1e-9


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
    fx = [0.0] * 6
    fy = [0.0] * 6
    moment = [0.0] * 6
    for contact in range(3):
        for side in range(2):
            slide = friction * (1.0 - 2.0 * side)
            edge = 2 * contact + side
            nx = normal[contact, 0]
            ny = normal[contact, 1]
            fx[edge] = -nx - slide * ny
            fy[edge] = -ny + slide * nx
            moment[edge] = (
                contact_um[contact, 0] * fy[edge] - contact_um[contact, 1] * fx[edge]
            ) / scale
    presses = [False] * 3
    # the kernel of four edges is one ray: its entries are the 3x3 minors with alternating sign
    for drop_a in range(5):
        for drop_b in range(drop_a + 1, 6):
            kept = [edge for edge in range(6) if edge not in (drop_a, drop_b)]
            ray = [0.0] * 4
            for out in range(4):
                i, j, k = [kept[col] for col in range(4) if col != out]
                minor = (
                    fx[i] * (fy[j] * moment[k] - fy[k] * moment[j])
                    - fx[j] * (fy[i] * moment[k] - fy[k] * moment[i])
                    + fx[k] * (fy[i] * moment[j] - fy[j] * moment[i])
                )
                ray[out] = minor if out % 2 == 0 else -minor
            low = min(ray)
            high = max(ray)
            if high < -low:
                low, high = -high, -low
                ray = [-entry for entry in ray]
            if high <= _TINY or low < -_TINY * 10.0:
                continue
            for col in range(4):
                if ray[col] > 1e-7 * high:
                    presses[kept[col] // 2] = True
    return presses[0] and presses[1] and presses[2]
