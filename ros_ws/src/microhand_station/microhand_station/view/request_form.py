# SPDX-License-Identifier: Apache-2.0
"""The fields of the request form → what to ask the planner for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import BadRequest, InvalidNumber
from microhand_planner.core.pose import FloatArray, Pose, angle_between_rad

HOLDING = 2
"""Plans begin with so many fingers that hold the object, or with none."""

MOVED_RAD, MOVED_UM = math.radians(2.0), 1.0
"""An object that is farther than this from where a plan begins has been moved [rad], [µm]."""

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


@dataclass(frozen=True)
class FormValues:
    """The fields, as they were filled in.

    Parameters
    ----------
    object_name : str
        Catalogue name, or path of a mesh file.
    unit_um : float
        Length of one unit of the mesh file [µm]; 0: the catalogue's.
    by_quaternion : bool
        Which of the two rotations counts.
    euler_zyz_deg : (3,) float
        Rotation Rz(A) Ry(B) Rz(C) [deg], object frame.
    quaternion_wxyz : (4,) float
        Rotation, object frame.
    translation_um : (3,) float
        Station frame [µm].
    afresh : bool
        The object is put at the station's origin, wherever it is now.
    """

    object_name: str
    unit_um: float = 0.0
    by_quaternion: bool = False
    euler_zyz_deg: Triple = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quadruple = (1.0, 0.0, 0.0, 0.0)
    translation_um: Triple = (0.0, 0.0, 0.0)
    afresh: bool = False


@dataclass(frozen=True)
class Held:
    """An object that fingers hold now.

    Parameters
    ----------
    sha256 : str
        Of the part.
    pose : Pose
        Station frame.
    tip_um : (3, 3) float
        Tips that hold it, station frame [µm]; NaN: free.
    """

    sha256: str
    pose: Pose
    tip_um: FloatArray


@dataclass(frozen=True)
class Request:
    """What is to be planned.

    Parameters
    ----------
    object_name, unit_um
        As in the form.
    start, goal : Pose
        Object in the station frame.
    start_tip_um : (3, 3) float or None
        Tips that hold it at the start; None: it is put there, and grasped.
    words : str
        The rotation as it was asked for.
    """

    object_name: str
    unit_um: float
    start: Pose
    goal: Pose
    start_tip_um: FloatArray | None
    words: str = ''


def to_request(values: FormValues, sha256: str, held: Held | None) -> Request:
    """Return what a filled-in form asks for.

    The object goes on from where it is, if the fingers hold it; otherwise it is put at the
    station's origin. The rotation is about its own frame, as everywhere: R_goal = R_start R.

    Parameters
    ----------
    values : FormValues
        The fields.
    sha256 : str
        Of the part that they name.
    held : Held or None
        What the fingers hold now.

    Raises
    ------
    BadRequest
        Names the field, its value and what is allowed.
    """
    if not values.object_name:
        raise BadRequest('object', 'empty', 'a name of the catalogue, or the path of a mesh file')
    turn = _rotation(values)
    shift_um = np.asarray(values.translation_um)
    if not np.all(np.isfinite(shift_um)):
        raise InvalidNumber('translation', values.translation_um, 'three finite numbers')
    if held is None or held.sha256 != sha256 or values.afresh:
        start, start_tip_um = Pose(), None
    else:
        start, start_tip_um = held.pose, held.tip_um
        holding = int(np.count_nonzero(np.all(np.isfinite(held.tip_um), axis=1)))
        if holding != HOLDING:
            raise BadRequest(
                'object', f'held by {holding} fingers', f'held by {HOLDING}, or put afresh'
            )
    return Request(
        object_name=values.object_name,
        unit_um=values.unit_um,
        start=start,
        goal=Pose.of(np.asarray(start.position_um) + shift_um, start.rotation * turn),
        start_tip_um=start_tip_um,
        words='quaternion {:g} {:g} {:g} {:g}'.format(*values.quaternion_wxyz)
        if values.by_quaternion
        else 'ZYZ {:g}° {:g}° {:g}°'.format(*values.euler_zyz_deg),
    )


def check_start(request: Request, held: Held | None) -> None:
    """Return if a plan can still begin as it was asked for.

    Parameters
    ----------
    request : Request
        Of the plan.
    held : Held or None
        What the fingers hold now.

    Raises
    ------
    BadRequest
        The plan begins with an object in the fingers, and it is not there any more.
    """
    if request.start_tip_um is None:
        return
    if held is not None:
        turned_rad = angle_between_rad(held.pose.rotation, request.start.rotation)
        moved_um = np.subtract(held.pose.position_um, request.start.position_um)
        if turned_rad < MOVED_RAD and float(np.linalg.norm(moved_um)) < MOVED_UM:
            return
    raise BadRequest('object', 'no longer held where the plan begins', 'a plan from where it is')


def _rotation(values: FormValues) -> Rotation:
    """Return the rotation that counts."""
    if values.by_quaternion:
        return Pose((0.0, 0.0, 0.0), values.quaternion_wxyz).rotation
    if not all(math.isfinite(angle) for angle in values.euler_zyz_deg):
        raise InvalidNumber('angles', values.euler_zyz_deg, 'three finite numbers')
    return Rotation.from_euler('ZYZ', values.euler_zyz_deg, degrees=True)
