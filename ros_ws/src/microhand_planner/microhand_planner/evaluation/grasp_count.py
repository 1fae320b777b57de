# SPDX-License-Identifier: Apache-2.0
"""How many stable grasps a section offers: the nodes of the graph of [Kumar2021]."""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np

from microhand_planner.core.grasp import pair_presses, triple_presses
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.parameters import Finger
from microhand_planner.core.pose import FloatArray
from microhand_planner.core.rotation_lattice import BoolArray

_TOUCH_UM = 1e-9
_NAMES_OF_TWO = 6  # fingers 1, 2, 3: ordered choices of two
_NAMES_OF_THREE = 6


@dataclass(frozen=True)
class GraspCount:
    """Stable grasps on the contact points of a section, whatever the object's orientation.

    Parameters
    ----------
    pairs, triples : int
        Sets of two and of three contact points.
    """

    pairs: int
    triples: int

    @property
    def grasps(self) -> int:
        """Grasps ``[i j k]``: sets of contact points, times the ways to name the fingers."""
        return _NAMES_OF_TWO * self.pairs + _NAMES_OF_THREE * self.triples


@dataclass(frozen=True)
class SectionContacts:
    """The contact points of a section, equidistant on its offset curve ([Kumar2021] Eq. 8).

    Parameters
    ----------
    contact_um, normal : (c, 2) float
        Contact points [µm] and outward normals.
    together : (c, c) bool
        Whether two tips can stand on both points at once.
    """

    contact_um: FloatArray
    normal: FloatArray
    together: BoolArray

    def __len__(self) -> int:
        """Return the number of contact points, the paper's c."""
        return len(self.contact_um)


def section_contacts(curve: OffsetCurve, finger: Finger, step_rad: float) -> SectionContacts:
    """Place contact points around a section, the first on joint I.

    Parameters
    ----------
    curve : OffsetCurve
        Path of the tip's centre.
    finger : Finger
        Tips.
    step_rad : float
        Δθ [rad]; the nearest spacing that divides the curve is used.
    """
    count = round(curve.length_rad / step_rad)
    points = curve.at(np.arange(count, dtype=np.float64) * (curve.length_rad / count))
    apart_um = np.linalg.norm(points.centre_um[:, None] - points.centre_um[None, :], axis=2)
    together = apart_um >= finger.min_distance_um - _TOUCH_UM
    together &= points.admissible[:, None] & points.admissible[None, :]
    return SectionContacts(points.contact_um.copy(), points.normal.copy(), together)


def count_adhesive(contacts: SectionContacts) -> GraspCount:
    """Count the grasps that are stable with adhesion: those whose tips do not overlap."""
    together = contacts.together.astype(np.int64)
    closed = int(np.einsum('ij,ji->', together @ together, together))
    return GraspCount(int(together.sum()) // 2, closed // 6)


def count_pressing(contacts: SectionContacts, friction: float) -> GraspCount:
    """Count the grasps that are stable without adhesion: every finger presses ([Kumar2021] Eq. 3).

    Parameters
    ----------
    contacts : SectionContacts
        The contact points.
    friction : float
        Coulomb coefficient.
    """
    pairs, triples = _count_pressing(
        contacts.contact_um, contacts.normal, contacts.together, friction
    )
    return GraspCount(pairs, triples)


@nb.njit(cache=True, nogil=True)
def _count_pressing(
    contact_um: FloatArray, normal: FloatArray, together: BoolArray, friction: float
) -> tuple[int, int]:  # pragma: no cover - compiled
    """Return the pairs and triples of contacts that hold by pressing."""
    pairs = 0
    triples = 0
    at_um = np.zeros((3, 2))
    at_normal = np.zeros((3, 2))
    for i in range(len(contact_um)):
        at_um[0] = contact_um[i]
        at_normal[0] = normal[i]
        for j in range(i):
            if not together[i, j]:
                continue
            at_um[1] = contact_um[j]
            at_normal[1] = normal[j]
            pairs += pair_presses(at_um[:2], at_normal[:2], friction)
            for k in range(j):
                if together[i, k] and together[j, k]:
                    at_um[2] = contact_um[k]
                    at_normal[2] = normal[k]
                    triples += triple_presses(at_um, at_normal, friction)
    return pairs, triples
