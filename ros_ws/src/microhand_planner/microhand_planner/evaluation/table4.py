# SPDX-License-Identifier: Apache-2.0
"""[Kumar2021] Table 4: whole rotations of three objects, with and without adhesion.

Each rotation is searched alone, in paper mode, as the paper does: the first begins with any
grasp and ends on the joints, the second begins and ends there, the third begins there.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.interruption import uninterrupted
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.parameters import ContactLaw, Finger, Mode, SearchOptions
from microhand_planner.core.part import Part
from microhand_planner.core.planned_rotation import Problem, plan_planar_rotation
from microhand_planner.core.search_state import NDEG
from microhand_planner.core.section_curves import section_curves
from microhand_planner.evaluation.paper_figures import TABLE_4, RotationSearch

_AXES = 'zyz'


@dataclass(frozen=True)
class Table4Row:
    """One planar rotation of an object, and the paper's figures.

    Parameters
    ----------
    object_name : str
        Object of the catalogue.
    rotation : int
        1, 2 or 3.
    axis : str
        ``'z'`` or ``'y'``, of the object frame.
    angle_deg : float
        Angle [deg].
    adhesion : bool
        Whether contacts stick.
    reconfigurations : int or None
        Placements and removals; None: no path available, proven.
    cost_deg : float or None
        Cost of the path [deg].
    expanded, waiting : int
        States expanded, and still waiting in the queue at the end; the paper's 'visited' and 'to
        be visited'. An exhaustive search leaves none waiting.
    time_s : float
        Wall time of the search, contact points included [s].
    paper : RotationSearch
        The paper's figures.
    """

    object_name: str
    rotation: int
    axis: str
    angle_deg: float
    adhesion: bool
    reconfigurations: int | None
    cost_deg: float | None
    expanded: int
    waiting: int
    time_s: float
    paper: RotationSearch


def table4(
    find_part: Callable[[str], Part],
    finger: Finger | None = None,
    law: ContactLaw | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Iterator[Table4Row]:
    """Search the rotations of the paper's three objects.

    Parameters
    ----------
    find_part : callable
        Name of an object to part, see `catalogue.find_part`.
    finger : Finger, optional
        Tips; by default the paper's.
    law : ContactLaw, optional
        Friction and forces; by default the paper's. Its `adhesion` is not used.
    clock : callable
        Current time [s].

    Yields
    ------
    Table4Row
        First all with adhesion, then all without, for one object after the other.
    """
    finger = finger or Finger()
    law = law or ContactLaw()
    for whole in TABLE_4:
        curves = section_curves(find_part(whole.object_name), finger).curves
        for adhesion in (True, False):
            contacts = ContactLaw(law.friction, law.pull_off_uN, law.max_force_uN, adhesion)
            papers = whole.with_adhesion if adhesion else whole.without_adhesion
            for rotation, angle_deg in enumerate(whole.angles_deg):
                yield _row(
                    whole.object_name, rotation, angle_deg, curves,
                    finger, contacts, papers[rotation], clock,
                )  # fmt: skip


def _row(
    object_name: str,
    rotation: int,
    angle_deg: float,
    curves: Mapping[str, OffsetCurve],
    finger: Finger,
    law: ContactLaw,
    paper: RotationSearch,
    clock: Callable[[], float],
) -> Table4Row:
    """Search one rotation; once before, so that compiled code is loaded."""
    part = PlanarRotation(_AXES[rotation], math.radians(angle_deg))
    curve = curves[part.axis]
    joints = (0.0, curve.phase_of_joint_j)
    begin = joints if rotation > 0 else None
    end = joints if rotation < len(_AXES) - 1 else None
    problem = Problem(finger, law, SearchOptions(mode=Mode.PAPER), clock, uninterrupted())
    plan_planar_rotation(part, curve, problem, begin, end)
    started = clock()
    planned, expanded = plan_planar_rotation(part, curve, problem, begin, end)
    return Table4Row(
        object_name=object_name,
        rotation=rotation + 1,
        axis=part.axis,
        angle_deg=angle_deg,
        adhesion=law.adhesion,
        reconfigurations=None if planned is None else planned.reconfigurations,
        cost_deg=None if planned is None else planned.cost_ndeg / NDEG,
        expanded=expanded,
        waiting=0 if planned is None else planned.waiting,
        time_s=clock() - started,
        paper=paper,
    )
