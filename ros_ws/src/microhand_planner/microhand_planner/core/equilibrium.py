# SPDX-License-Identifier: Apache-2.0
"""Can contacts balance a wrench? The equilibrium of [Kumar2021] Eq. 3 and 4 as a linear program.

Slower and more general than the closed forms that the searches use, and independent of them: it
takes contacts in space, any number of fingers, and any external wrench.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from microhand_planner.core.parameters import ContactLaw
from microhand_planner.core.pose import FloatArray

_ARM_UM = 10.0  # torques are divided by it, so that all rows of the program are of one size


def wrench_of(force_uN: FloatArray, at_um: FloatArray) -> FloatArray:
    """Return force and torque about the origin of a force at a point, (6,) [µN, µN·µm] (Eq. 2)."""
    return np.concatenate([force_uN, np.cross(at_um, force_uN)])


def can_balance(
    contact_um: FloatArray,
    normal: FloatArray,
    plane_normal: FloatArray,
    law: ContactLaw,
    external_wrench: FloatArray | None = None,
    *,
    least_normal_uN: float | None = None,
) -> bool:
    """Return whether contact forces within the law sum up to nothing with an external wrench.

    Friction is bounded by ``|f_1| + |f_2| <= friction (f_n + pull_off)`` for the tangents in the
    section plane and normal to it: exact for forces in the plane, on the safe side otherwise.

    Parameters
    ----------
    contact_um, normal : (k, 3) float
        Contacts [µm] and outward unit normals.
    plane_normal : (3,) float
        Normal of the section plane.
    law : ContactLaw
        Friction, pull-off force, largest normal force ([Kumar2021] Eq. 1).
    external_wrench : (6,) float, optional
        Force [µN] and torque about the origin [µN·µm] on the object; none by default.
    least_normal_uN : float, optional
        Smallest normal force allowed [µN]; by default the contacts may pull with `pull_off`.

    Returns
    -------
    bool

    Examples
    --------
    Two fingers on opposite sides hold a weight of 1 µN across; they could not hold 20.

    >>> sides = np.array([[10.0, 0.0, 0.0], [-10.0, 0.0, 0.0]])
    >>> across = np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    >>> z = np.array([0.0, 0.0, 1.0])
    >>> [can_balance(sides, sides / 10.0, z, ContactLaw(), load * across) for load in (1, 20)]
    [True, False]
    """
    stick_uN = law.stick_uN
    least_uN = -stick_uN if least_normal_uN is None else least_normal_uN
    columns, limits, bounds = [], [], []
    for finger, (at_um, outward) in enumerate(zip(contact_um, normal, strict=True)):
        tangents = (np.cross(plane_normal, outward), plane_normal)
        columns += [wrench_of(direction, at_um) for direction in (-outward, *tangents)]
        bounds += [(least_uN, law.max_force_uN), (None, None), (None, None)]
        for first in (-1.0, 1.0):
            for second in (-1.0, 1.0):
                row = np.zeros(3 * len(contact_um))
                row[3 * finger : 3 * finger + 3] = (-law.friction, first, second)
                limits.append(row)
    scale = np.repeat([1.0, 1.0 / _ARM_UM], 3)
    load = np.zeros(6) if external_wrench is None else np.asarray(external_wrench)
    program = linprog(
        np.zeros(len(bounds)),
        A_ub=np.array(limits),
        b_ub=np.full(len(limits), law.friction * stick_uN),
        A_eq=np.array(columns).T * scale[:, None],
        b_eq=-load * scale,
        bounds=bounds,
    )
    return bool(program.status == 0)
