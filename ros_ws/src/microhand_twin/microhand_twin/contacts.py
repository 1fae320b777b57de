# SPDX-License-Identifier: Apache-2.0
"""What the fingers feel, read from MuJoCo's contacts."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.parameters import ContactLaw
from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import FloatArray

_OBJECT_BODY = 1
_FIRST_FINGER_BODY = 2


@dataclass(frozen=True)
class Contacts:
    """What the three fingers feel.

    Parameters
    ----------
    touching : (3,) bool
        Fingers within reach of the object's adhesion: tip and surface at most 5 nm apart.
    normal_uN : (3,) float
        Normal force f_n, pressing > 0; down to minus the pull-off force [µN].
    tangential_uN : (3,) float
        Tangential force |f_t| [µN].
    friction_use : (3,) float
        ``|f_t| / (µ (f_n + f_po))``: 1 slips; 0 without contact.
    force_uN : (3, 3) float
        Force of each finger on the object, station frame [µN].
    direction : (3, 3) float
        From the tip's centre to where it touches, station frame; the mean if it touches in two
        places, 0 if in none.
    """

    touching: NDArray[np.bool_]
    normal_uN: FloatArray
    tangential_uN: FloatArray
    friction_use: FloatArray
    force_uN: FloatArray
    direction: FloatArray


def read_contacts(model: mujoco.MjModel, data: mujoco.MjData, law: ContactLaw) -> Contacts:
    """Return what the fingers felt in the last step of the integration.

    MuJoCo's normal force includes the pull of the adhesion, which is spread evenly over all places
    that a tip touches.

    Parameters
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        Of a world: body 1 is the object, bodies 2, 3, 4 are the fingers.
    law : ContactLaw
        Of that world.
    """
    touching = np.zeros(FINGERS, dtype=bool)
    pressing_uN = np.zeros(FINGERS)
    tangential_uN = np.zeros(FINGERS)
    force_uN = np.zeros((FINGERS, 3))
    direction = np.zeros((FINGERS, 3))
    contact = data.contact
    bodies = model.geom_bodyid[contact.geom]
    places = np.bincount(bodies.ravel(), minlength=_FIRST_FINGER_BODY + FINGERS)
    for (first, second), frame, address in zip(
        bodies.tolist(), contact.frame, contact.efc_address, strict=True
    ):
        finger = max(first, second) - _FIRST_FINGER_BODY
        # the frame's first axis points from the first geometry to the second
        sign = 1.0 if second == _OBJECT_BODY else -1.0
        touching[finger] = True
        direction[finger] += sign * frame[:3] / places[max(first, second)]
        if address < 0:  # within reach, but apart
            continue
        along = data.efc_force[address : address + 3]
        pressing_uN[finger] += along[0]
        tangential_uN[finger] += float(np.hypot(along[1], along[2]))
        force_uN[finger] += sign * (along @ frame.reshape(3, 3))
    limit_uN = law.friction * pressing_uN
    use = np.divide(tangential_uN, limit_uN, out=np.zeros(FINGERS), where=limit_uN > 0.0)
    return Contacts(
        touching=touching,
        normal_uN=np.where(touching, pressing_uN - law.stick_uN, 0.0),
        tangential_uN=tangential_uN,
        friction_use=use,
        force_uN=force_uN - law.stick_uN * direction,
        direction=direction,
    )
