# SPDX-License-Identifier: Apache-2.0
"""What planning needs to know of a part and a finger: computed once, for all requests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from microhand_planner.core.cut_section import cut_section
from microhand_planner.core.joints import check_joints
from microhand_planner.core.offset_curve import OffsetCurve, offset_curve
from microhand_planner.core.parameters import Finger
from microhand_planner.core.part import Part
from microhand_planner.core.section import XY_PLANE, XZ_PLANE


@dataclass(frozen=True)
class SectionCurves:
    """Where the tips can run around a part, in both manipulation planes.

    Parameters
    ----------
    part : Part
        The part.
    finger : Finger
        The tips.
    curves : mapping
        Offset curves for the axes ``'z'`` (XY plane) and ``'y'`` (XZ plane).
    """

    part: Part
    finger: Finger
    curves: Mapping[str, OffsetCurve]

    @property
    def bounding_radius_um(self) -> float:
        """Radius of the sphere about the origin that holds the part [µm]."""
        return float(np.max(np.linalg.norm(self.part.vertices_um, axis=1)))


def section_curves(part: Part, finger: Finger) -> SectionCurves:
    """Cut a part in both planes, and follow the tips around the sections.

    Parameters
    ----------
    part : Part
        In its object frame; both planes contain the X axis.
    finger : Finger
        The tips.

    Returns
    -------
    SectionCurves

    Raises
    ------
    EmptySection
        A plane misses the part.
    InadmissibleContact
        The tip cannot stand where the curves meet, on joints I and J.
    """
    curves: dict[str, OffsetCurve] = {
        plane.axis: offset_curve(cut_section(part, plane), finger.radius_um, part)
        for plane in (XY_PLANE, XZ_PLANE)
    }
    check_joints(curves['z'], curves['y'], finger)
    return SectionCurves(part, finger, MappingProxyType(curves))
