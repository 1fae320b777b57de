# SPDX-License-Identifier: Apache-2.0
"""With which forces the fingers hold the object, step by step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from microhand_planner.core.hold import Hold
from microhand_planner.core.parameters import ContactLaw, GripRules
from microhand_planner.core.pose import FloatArray
from microhand_planner.core.preload import preload
from microhand_planner.core.rolling_grip import rolling_grips_uN

_PAIR = 2
_PRESS_WEIGHT = 1e-3  # beside the margin


@dataclass(frozen=True)
class GripForces:
    """The forces of a plan's fingers; all contacts and forces are in the section plane.

    Parameters
    ----------
    law : ContactLaw
        True friction and pull-off.
    rules : GripRules
        Margins, and the nominal grip.
    planned : bool
        False: every pair presses with the nominal grip, as in plans of the paper, which leave
        forces open.
    """

    law: ContactLaw
    rules: GripRules
    planned: bool

    def while_holding(
        self, contact_um: FloatArray, normal: FloatArray
    ) -> tuple[FloatArray, Hold | None]:
        """Return forces with which k fingers hold, or roll, an object along n waypoints.

        Parameters
        ----------
        contact_um, normal : (n, k, 2) float
            Contacts [µm] and outward normals; k is 2 or 3.

        Returns
        -------
        force_uN : (n, k, 2) float
            Of each finger on the object; they are in balance.
        hold : Hold or None
            Grip and margin of two fingers; None: not planned.
        """
        if contact_um.shape[1] != _PAIR:
            return self._of_three(contact_um, normal), None
        if not self.planned:
            nominal_uN = np.full(len(contact_um), self.rules.nominal_grip_uN)
            return _along_line(contact_um, nominal_uN), None
        grip_uN, high_uN, margin_uN = rolling_grips_uN(contact_um, normal, self.law, self.rules)
        hold = Hold(float(grip_uN.min()), 0.0, float(high_uN.min()), float(margin_uN.min()))
        return _along_line(contact_um, grip_uN), hold

    def while_releasing(
        self,
        stay_um: FloatArray,
        stay_normal: FloatArray,
        leave_um: FloatArray,
        leave_normal: FloatArray,
    ) -> tuple[FloatArray, Hold | None]:
        """Return forces with which two fingers let a third one go.

        Parameters
        ----------
        stay_um, stay_normal : (2, 2) float
            Contacts that stay [µm], and outward normals there.
        leave_um, leave_normal : (2,) float
            Contact that is given up, and its outward normal.

        Returns
        -------
        force_uN : (2, 2) float
            Of the fingers that stay, on the object.
        hold : Hold or None
            As for `while_holding`.
        """
        if not self.planned or self.law.stick_uN == 0.0:
            force_uN, hold = self.while_holding(stay_um[None], stay_normal[None])
            return force_uN[0], hold
        hold = preload(stay_um, stay_normal, leave_um, leave_normal, self.law, self.rules)
        return _along_line(stay_um[None], np.array([hold.grip_uN]))[0], hold

    def _of_three(self, contact_um: FloatArray, normal: FloatArray) -> FloatArray:
        """Return for each waypoint the forces of three fingers that are farthest from slipping."""
        share = self.rules.margin_factor if self.planned else 1.0
        friction = share * self.law.friction
        most_uN = min(self.rules.nominal_grip_uN, self.law.max_force_uN)
        return np.stack(
            [
                _firmest(at, out, friction, self.law.stick_uN, most_uN)
                for at, out in zip(contact_um, normal, strict=True)
            ]
        )


def _along_line(contact_um: FloatArray, grip_uN: FloatArray) -> FloatArray:
    """Return the forces (n, 2, 2) of two fingers that press towards each other."""
    line = contact_um[:, 1] - contact_um[:, 0]
    force_uN = grip_uN[:, None] * line / np.linalg.norm(line, axis=1, keepdims=True)
    return np.stack([force_uN, -force_uN], axis=1)


def _firmest(
    contact_um: FloatArray, normal: FloatArray, friction: float, stick_uN: float, most_uN: float
) -> FloatArray:
    """Return the balanced forces (k, 2) that keep the largest margin in all cones.

    A linear program in normal forces, tangential forces and the margin. Where fingers can hold on
    the edge of a cone only, they hold all the same: pressing counts a little, too.
    """
    count = len(contact_um)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    columns = np.concatenate([-normal, tangent])
    places = np.concatenate([contact_um, contact_um])
    torque = places[:, 0] * columns[:, 1] - places[:, 1] * columns[:, 0]
    scale_um = np.abs(contact_um).max()
    balance = np.column_stack([np.vstack([columns.T, torque / scale_um]), np.zeros(3)])
    one = np.eye(count)
    cones = np.vstack(
        [np.column_stack([-friction * one, sign * one, np.ones(count)]) for sign in (1.0, -1.0)]
    )
    program = linprog(
        [*np.full(count, -_PRESS_WEIGHT), *np.zeros(count), -1.0],
        A_ub=cones,
        b_ub=np.full(2 * count, friction * stick_uN),
        A_eq=balance,
        b_eq=np.zeros(3),
        bounds=[(-stick_uN, most_uN)] * count + [(None, None)] * count + [(0.0, None)],
    )
    press, slide = program.x[:count], program.x[count:-1]
    return np.asarray(-press[:, None] * normal + slide[:, None] * tangent)
