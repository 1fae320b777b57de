# SPDX-License-Identifier: Apache-2.0
"""Joints I and J: where both sections meet, and rotations about Z and Y change over."""

from __future__ import annotations

import numpy as np

from microhand_planner.core.errors import InadmissibleContact
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.parameters import Finger

JOINT_SHARE = 0.005
"""Share of the tip's radius by which the two sections' contacts at a joint may differ."""


def check_joints(xy_curve: OffsetCurve, xz_curve: OffsetCurve, finger: Finger) -> None:
    """Check that fingers can hand over from one section to the other.

    A finger at I (tip centre on +X) or J (on −X) belongs to both sections, so both must find the
    same contact point there, an admissible one, and the tips at I and J must be clear of each
    other.

    Parameters
    ----------
    xy_curve, xz_curve : OffsetCurve
        Of the XY and the XZ section.
    finger : Finger
        The tips.

    Raises
    ------
    InadmissibleContact
        Names the joint and says what is wrong.
    """
    planes = xy_curve.plane, xz_curve.plane
    tolerance_um = JOINT_SHARE * finger.radius_um
    ends = []
    for joint, phases in (
        ('I', (0.0, 0.0)),
        ('J', (xy_curve.phase_of_joint_j, xz_curve.phase_of_joint_j)),
    ):
        at = [curve.at(phase) for curve, phase in zip((xy_curve, xz_curve), phases, strict=True)]
        for points, plane in zip(at, planes, strict=True):
            if not points.admissible[0]:
                raise InadmissibleContact(
                    f'joint {joint}',
                    f'where the tip cannot stand in the plane normal to {plane.axis.upper()}',
                    'a surface normal within the plane, and a tip that touches nothing else',
                )
        contacts = [
            p.to_object(points.contact_um)[0] for p, points in zip(planes, at, strict=True)
        ]
        apart_um = float(np.linalg.norm(contacts[0] - contacts[1]))
        if apart_um > tolerance_um:
            raise InadmissibleContact(
                f'joint {joint}',
                f'touched at points {apart_um:.3g} µm apart by the two sections',
                f'a surface normal along X there: contacts within {tolerance_um:.3g} µm',
            )
        ends.append(planes[0].to_object(at[0].centre_um)[0])
    distance_um = float(np.linalg.norm(ends[0] - ends[1]))
    if distance_um < finger.min_distance_um:
        raise InadmissibleContact(
            'object',
            f'so thin along X that tips at I and J are {distance_um:.4g} µm apart',
            f'at least {finger.min_distance_um:.4g} µm (two radii and the clearance)',
        )
