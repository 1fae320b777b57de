# SPDX-License-Identifier: Apache-2.0
"""What the physics says → messages, in SI units."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Vector3
from microhand_msgs_py.msg import ContactForce, ObjectState, TipContact
from std_msgs.msg import Header

from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import FloatArray
from microhand_planner.ros.conversions import UN_PER_N, point_from_um, pose_to_msg
from microhand_twin.contacts import Contacts
from microhand_twin.ros.live_world import ObjectReport


def tip_contacts(header: Header, contacts: Contacts | None) -> list[TipContact]:
    """Return what each finger's stage driver is told; without an object nothing touches."""
    if contacts is None:
        return [TipContact(header=header, normal_force=0.0) for _ in range(FINGERS)]
    return [
        TipContact(
            header=header,
            in_contact=bool(contacts.touching[finger]),
            normal_force=float(contacts.normal_uN[finger]) / UN_PER_N,
        )
        for finger in range(FINGERS)
    ]


def object_state(header: Header, report: ObjectReport, radius_um: float) -> ObjectState:
    """Return the message of an object report, with tips of this radius."""
    contacts = report.contacts
    return ObjectState(
        header=header,
        pose=pose_to_msg(report.pose),
        held=not report.lost_because,
        lost_because=report.lost_because,
        released=report.released,
        contacts=[] if contacts is None else contact_forces(contacts, report.tip_um, radius_um),
    )


def contact_forces(
    contacts: Contacts, tip_um: FloatArray, radius_um: float
) -> Sequence[ContactForce]:
    """Return one message per finger, with its tip at `tip_um` (3, 3), station frame."""
    touching = np.asarray(contacts.touching)[:, None]
    point_um = np.where(touching, tip_um + radius_um * contacts.direction, np.nan)
    return [
        ContactForce(
            finger=finger + 1,
            in_contact=bool(contacts.touching[finger]),
            position=point_from_um(point_um[finger]),
            force=_force(contacts.force_uN[finger]),
            normal_force=float(contacts.normal_uN[finger]) / UN_PER_N,
            friction_use=(
                float(contacts.friction_use[finger]) if contacts.touching[finger] else math.nan
            ),
        )
        for finger in range(FINGERS)
    ]


def _force(force_uN: FloatArray) -> Vector3:
    x, y, z = (np.asarray(force_uN) / UN_PER_N).tolist()
    return Vector3(x=x, y=y, z=z)
