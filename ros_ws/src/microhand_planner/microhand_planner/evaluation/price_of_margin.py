# SPDX-License-Identifier: Apache-2.0
"""What safety costs: one reorientation, planned with more and with less of the friction."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from microhand_planner.core.errors import NoPlanExists, TimeLimitReached
from microhand_planner.core.motions import motions
from microhand_planner.core.parameters import GripRules
from microhand_planner.core.plan import Plan
from microhand_planner.core.trajectory import Pace

FACTORS = (1.0, 0.9, 0.8, 0.7, 0.6)


@dataclass(frozen=True)
class PriceRow:
    """One margin factor, and the cheapest plan that keeps it.

    Parameters
    ----------
    margin_factor : float
        Share of the friction that removals are planned with.
    cost_deg : float or None
        Cost of the plan [deg]; None: there is none.
    reconfigurations : int or None
        Placements and removals.
    motion_s : float or None
        How long the motions take [s].
    tightest_uN : float or None
        Smallest margin of all steps [µN].
    proven : bool
        False: there is no plan because the time was over.
    """

    margin_factor: float
    cost_deg: float | None = None
    reconfigurations: int | None = None
    motion_s: float | None = None
    tightest_uN: float | None = None
    proven: bool = True


def price_of_margin(
    planned: Callable[[Sequence[GripRules]], Plan],
    rules: Sequence[GripRules],
    stiffness_uN_per_um: Sequence[float],
    factors: Iterable[float] = FACTORS,
    pace: Pace | None = None,
) -> Iterator[PriceRow]:
    """Plan the same reorientation with several margin factors.

    Parameters
    ----------
    planned : callable
        Plans it by the first of given rules that allow a plan.
    rules : sequence of GripRules
        All but the margin factor.
    stiffness_uN_per_um : sequence of 3 float
        Of the fingers [µN/µm, which is N/m]; how far commands go beyond the contacts.
    factors : iterable of float
        Margin factors.
    pace : Pace, optional
        How fast the station moves; by default as it does by default.

    Yields
    ------
    PriceRow
        In the order of the factors.
    """
    for factor in factors:
        try:
            plan = planned([replace(one, margin_factor=factor) for one in rules])
        except NoPlanExists:
            yield PriceRow(factor)
        except TimeLimitReached:
            yield PriceRow(factor, proven=False)
        else:
            timed = motions(plan, pace or Pace(), stiffness_uN_per_um)
            yield PriceRow(
                margin_factor=factor,
                cost_deg=plan.cost_deg,
                reconfigurations=plan.reconfigurations,
                motion_s=sum(motion.trajectory.duration_s for motion in timed),
                tightest_uN=None if plan.tightest is None else plan.tightest[1].margin_uN,
            )
