# SPDX-License-Identifier: Apache-2.0
"""Object and fingers for RViz: transforms of their frames, and markers large enough to be seen.

RViz cannot come closer than a centimetre, so markers are enlarged; transforms are true to scale,
but for the frame `object_enlarged`, in which the mesh of the object is fixed.
"""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Transform, TransformStamped, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from microhand_planner.core.part import Part
from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import FloatArray
from microhand_planner.ros.conversions import m_from_um
from microhand_twin.ros.live_world import ObjectReport
from microhand_twin.ros.twin_parameters import TwinParameters

ARROW_M_PER_UN = 1e-6
"""Length of the arrow of 1 µN, before it is enlarged [m]."""
OBJECT_COLOR = ColorRGBA(r=0.35, g=0.55, b=0.75, a=0.8)
TIP_COLOR = ColorRGBA(r=0.75, g=0.75, b=0.75, a=1.0)
TOUCHING_COLOR = ColorRGBA(r=0.95, g=0.6, b=0.2, a=1.0)
LOST_COLOR = ColorRGBA(r=0.8, g=0.15, b=0.1, a=1.0)


def transforms(
    stamp: Time, parameters: TwinParameters, report: ObjectReport
) -> list[TransformStamped]:
    """Return the frames of object and tips in the station frame.

    Parameters
    ----------
    stamp : Time
        To which they refer.
    parameters : TwinParameters
        Names of the frames, and the scale of the display.
    report : ObjectReport
        Where object and tips are.
    """
    pose, tip_um = report.pose, report.tip_um
    w, x, y, z = (float(value) for value in pose.quaternion_wxyz)
    turned, straight = Quaternion(x=x, y=y, z=z, w=w), Quaternion(w=1.0)
    enlarged_um = parameters.display_scale * np.asarray(pose.position_um)
    frames = [
        ('object', np.asarray(pose.position_um), turned),
        ('object_enlarged', enlarged_um, turned),
        *((f'finger_{finger + 1}_tip', tip_um[finger], straight) for finger in range(FINGERS)),
    ]
    return [
        TransformStamped(
            header=Header(stamp=stamp, frame_id=parameters.frame),
            child_frame_id=f'{parameters.frame_prefix}{name}',
            transform=Transform(translation=_vector(m_from_um(at_um)), rotation=rotation),
        )
        for name, at_um, rotation in frames
    ]


def object_marker(stamp: Time, parameters: TwinParameters, part: Part) -> MarkerArray:
    """Return the mesh of the object, fixed in the frame `object_enlarged`: it is sent once."""
    corners_m = parameters.display_scale * m_from_um(part.vertices_um[part.faces.ravel()])
    marker = Marker(
        header=Header(stamp=stamp, frame_id=f'{parameters.frame_prefix}object_enlarged'),
        ns='object',
        type=Marker.TRIANGLE_LIST,
        pose=PoseMsg(orientation=Quaternion(w=1.0)),
        scale=Vector3(x=1.0, y=1.0, z=1.0),
        color=OBJECT_COLOR,
        frame_locked=True,
        points=[Point(x=x, y=y, z=z) for x, y, z in corners_m.tolist()],
    )
    return MarkerArray(markers=[marker])


def finger_markers(
    stamp: Time,
    parameters: TwinParameters,
    report: ObjectReport,
    radius_um: float,
) -> MarkerArray:
    """Return a sphere for each tip, and an arrow for each force on the object."""
    scale = parameters.display_scale
    contacts = report.contacts
    header = Header(stamp=stamp, frame_id=parameters.frame)
    diameter_m = float(2.0 * scale * m_from_um(radius_um))
    markers = []
    for finger in range(FINGERS):
        touching = contacts is not None and bool(contacts.touching[finger])
        centre_m = scale * m_from_um(report.tip_um[finger])
        color = TOUCHING_COLOR if touching else TIP_COLOR
        if report.lost_because:
            color = LOST_COLOR
        markers.append(
            Marker(
                header=header,
                ns='tips',
                id=finger + 1,
                type=Marker.SPHERE,
                pose=PoseMsg(position=_point(centre_m), orientation=Quaternion(w=1.0)),
                scale=Vector3(x=diameter_m, y=diameter_m, z=diameter_m),
                color=color,
            )
        )
        arrow = Marker(header=header, ns='forces', id=finger + 1, type=Marker.ARROW)
        if touching and contacts is not None:
            arrow_m = scale * ARROW_M_PER_UN * contacts.force_uN[finger]
            arrow.points = [_point(centre_m), _point(centre_m + arrow_m)]
            arrow.scale = Vector3(x=0.1 * diameter_m, y=0.2 * diameter_m, z=0.0)
            arrow.color = color
        else:
            arrow.action = Marker.DELETE
        markers.append(arrow)
    return MarkerArray(markers=markers)


def _point(position_m: FloatArray) -> Point:
    x, y, z = position_m.tolist()
    return Point(x=x, y=y, z=z)


def _vector(position_m: FloatArray) -> Vector3:
    x, y, z = position_m.tolist()
    return Vector3(x=x, y=y, z=z)
