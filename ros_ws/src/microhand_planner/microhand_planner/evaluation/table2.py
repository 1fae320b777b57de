# SPDX-License-Identifier: Apache-2.0
"""[Kumar2021] Table 2: how friction and adhesion decide how many grasps are stable.

The paper does not say how it counts. Counted here are grasps of two and of three fingers, fingers
told apart, on c contact points, times the orientations of the object. For the ellipsoid (c = 74)
that makes 258 630 per orientation; 13 orientations come nearest to the printed 3.373 million.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from microhand_planner.core.parameters import Finger
from microhand_planner.core.part import Part
from microhand_planner.core.section_curves import section_curves
from microhand_planner.evaluation.grasp_count import (
    SectionContacts,
    count_adhesive,
    count_pressing,
    section_contacts,
)
from microhand_planner.evaluation.paper_figures import FRICTIONS, TABLE_2, GraphSize

ORIENTATIONS = 13
"""With these the counts of the ellipsoid agree with the paper's within 0.4 %."""

_STEP_RAD = math.radians(20.0)
_MILLION = 1e6
_AXES = {'L1': 'z', 'L2': 'y'}


@dataclass(frozen=True)
class Table2Row:
    """Stable grasps of a section, in millions, and the paper's figures.

    Parameters
    ----------
    object_name, line : str
        Object of the catalogue, and L1 (XY plane) or L2 (XZ plane).
    contacts : int
        Contact points, c.
    with_adhesion : float
        Stable grasps; the same for all frictions.
    without_adhesion, share : tuple of 3 float
        Stable grasps at each of `paper_figures.FRICTIONS`, and their share of `with_adhesion`.
    paper : GraphSize
        The row of the paper.
    """

    object_name: str
    line: str
    contacts: int
    with_adhesion: float
    without_adhesion: tuple[float, ...]
    share: tuple[float, ...]
    paper: GraphSize


def table2(find_part: Callable[[str], Part], finger: Finger | None = None) -> Iterator[Table2Row]:
    """Count the stable grasps of the paper's objects, row by row.

    Parameters
    ----------
    find_part : callable
        Name of an object to part, see `catalogue.find_part`.
    finger : Finger, optional
        Tips; by default the paper's.

    Yields
    ------
    Table2Row
        As many as in `paper_figures.TABLE_2`, one after the other: this takes a while.
    """
    finger = finger or Finger()
    for paper in TABLE_2:
        curves = section_curves(find_part(paper.object_name), finger).curves
        contacts = section_contacts(curves[_AXES[paper.line]], finger, _STEP_RAD)
        yield _row(paper, contacts)


def _row(paper: GraphSize, contacts: SectionContacts) -> Table2Row:
    """Count the grasps of one section, one friction per core."""
    adhesive = count_adhesive(contacts).grasps
    with ThreadPoolExecutor() as threads:
        pressing = [
            count.grasps
            for count in threads.map(
                lambda friction: count_pressing(contacts, friction), FRICTIONS
            )
        ]
    return Table2Row(
        object_name=paper.object_name,
        line=paper.line,
        contacts=len(contacts),
        with_adhesion=ORIENTATIONS * adhesive / _MILLION,
        without_adhesion=tuple(ORIENTATIONS * count / _MILLION for count in pressing),
        share=tuple(count / adhesive for count in pressing),
        paper=paper,
    )
