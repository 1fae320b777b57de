# SPDX-License-Identifier: Apache-2.0
"""What planning needs to know of a part and a finger: computed once, for all requests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
from scipy.spatial import cKDTree

from microhand_planner.core.cut_section import cut_section
from microhand_planner.core.joints import check_joints
from microhand_planner.core.offset_curve import OffsetCurve, offset_curve
from microhand_planner.core.parameters import Finger
from microhand_planner.core.part import Part
from microhand_planner.core.pose import FloatArray
from microhand_planner.core.section import XY_PLANE, XZ_PLANE
from microhand_planner.core.tip_clearance import distance_to_part

_TOUCH_UM = 0.05  # facets may stand this far out of the smooth outline that the tip follows


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

    @cached_property
    def bounding_radius_um(self) -> float:
        """Radius of the sphere about the origin that holds the part [µm]."""
        return float(np.max(np.linalg.norm(self.part.vertices_um, axis=1)))

    def touches(self, centres_um: FloatArray) -> bool:
        """Return whether a tip touches the part at any of the given centres.

        Parameters
        ----------
        centres_um : (k, 3) float
            Object frame [µm].
        """
        closest_um = self.finger.radius_um - _TOUCH_UM
        tree, reach_um = self._faces
        # a face is no nearer than its middle less its size: mostly that decides
        doubtful = tree.query(centres_um)[0] - reach_um < closest_um
        if not np.any(doubtful):
            return False
        near_um = distance_to_part(centres_um[doubtful], self.part, self.finger.radius_um)
        return bool(np.any(near_um < closest_um))

    @cached_property
    def _faces(self) -> tuple[cKDTree, float]:
        """Middles of the faces in a tree, and the farthest that a corner is from its middle."""
        corners_um = self.part.vertices_um[self.part.faces]
        middles_um = corners_um.mean(axis=1)
        reach_um = np.linalg.norm(corners_um - middles_um[:, None], axis=2).max()
        return cKDTree(middles_um), float(reach_um)


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
