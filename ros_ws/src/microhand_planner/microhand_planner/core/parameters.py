# SPDX-License-Identifier: Apache-2.0
"""What the planner is told about fingers, contacts and the search; defaults are the paper's."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

from microhand_planner.core.errors import InvalidNumber, InvalidParameter


def check_number(
    field: str,
    value: float,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    low_open: bool = False,
) -> float:
    """Return `value` as a float if it is a number within ``[low, high]``.

    Parameters
    ----------
    field : str
        Name of the value, as the user writes it.
    value : float
        The value to check.
    low, high : float
        Allowed range, ends included.
    low_open : bool
        True: `low` itself is not allowed.

    Raises
    ------
    InvalidNumber
        `value` is NaN or infinite.
    InvalidParameter
        `value` is outside the range.

    Examples
    --------
    >>> check_number('friction', 0.3, low=0.0, high=2.0)
    0.3
    """
    allowed = f'a number {">" if low_open else ">="} {low:g}'
    if math.isfinite(high):
        allowed += f' and <= {high:g}'
    if not math.isfinite(value):
        raise InvalidNumber(field, value, allowed)
    if value < low or value > high or (low_open and value == low):
        raise InvalidParameter(field, value, allowed)
    return float(value)


class Mode(Enum):
    """How the planar problem is made discrete."""

    ROBUST = 'robust'
    """Exact phases: fingers never slip to the next lattice point; any goal angle."""
    PAPER = 'paper'
    """The lattice of [Kumar2021]: contacts and angles in multiples of the step."""


@dataclass(frozen=True)
class ContactLaw:
    """Adhesive Coulomb contact, ``|f_t| <= friction (f_n + pull_off)`` ([Kumar2021] Eq. 1).

    Parameters
    ----------
    friction : float
        Coulomb coefficient µ [-].
    pull_off_uN : float
        Force that detaches a tip [µN].
    max_force_uN : float
        Largest normal force of a tip [µN].
    adhesion : bool
        False: nothing sticks, and `pull_off_uN` is ignored.
    """

    friction: float = 0.3
    pull_off_uN: float = 1.5
    max_force_uN: float = 30.0
    adhesion: bool = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('friction', self.friction, low=0.0, high=2.0)
        check_number('pull-off', self.pull_off_uN, low=0.0, high=1e3)
        check_number('max-force', self.max_force_uN, low=0.0, high=1e4, low_open=True)

    @property
    def stick_uN(self) -> float:
        """The pull-off force that counts [µN]: zero without adhesion."""
        return self.pull_off_uN if self.adhesion else 0.0


@dataclass(frozen=True)
class Finger:
    """A spherical finger tip.

    Parameters
    ----------
    radius_um : float
        Radius of the tip [µm].
    clearance_um : float
        Free distance kept between two tips [µm], on top of not overlapping.
    """

    radius_um: float = 4.5
    clearance_um: float = 0.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('finger-radius', self.radius_um, low=0.01, high=1e4)
        check_number('clearance', self.clearance_um, low=0.0, high=1e4)

    @property
    def min_distance_um(self) -> float:
        """Smallest distance between two tip centres [µm]."""
        return 2.0 * self.radius_um + self.clearance_um


@dataclass(frozen=True)
class GripRules:
    """How firmly fingers hold: the margins that robust plans keep.

    A real contact has less friction than its data sheet says, and a position-controlled finger
    is a spring: grip forces must be planned, and planned with less friction than there is.

    Parameters
    ----------
    margin_factor : float
        Removals are planned with this share of the friction.
    roll_factor : float
        Rolling grips are planned with this share of the friction, or with that of removals where
        it is less.
    least_margin_uN : float
        Distance to slipping, detaching and overload that a removal keeps, as a force [µN].
    nominal_grip_uN : float
        Grip while rolling, wherever the contacts allow as much [µN].
    grip_tolerance_uN : float
        The grip may be off by as much, and the margins are kept all the same [µN]: stiffness
        times the error of positions.
    """

    margin_factor: float = 0.8
    roll_factor: float = 0.6
    least_margin_uN: float = 0.05
    nominal_grip_uN: float = 5.0
    grip_tolerance_uN: float = 0.5

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('margin', self.margin_factor, low=0.0, high=1.0, low_open=True)
        check_number('roll-margin', self.roll_factor, low=0.0, high=1.0, low_open=True)
        check_number('least-margin', self.least_margin_uN, low=0.0, high=1e3, low_open=True)
        check_number('grip', self.nominal_grip_uN, low=0.0, high=1e4, low_open=True)
        check_number('grip-tolerance', self.grip_tolerance_uN, low=0.0, high=1e4, low_open=True)


def firmest_first(rules: GripRules) -> tuple[GripRules, ...]:
    """Return the rules with the tolerances of grips that plans have by default, the best first.

    Plans that forgive 1.5 µN cost little more than those that forgive 0.5 µN, and hold far more
    often where fingers are off; but slippery objects have none.
    """
    return tuple(replace(rules, grip_tolerance_uN=tolerance) for tolerance in (1.5, 0.5))


ROBUST_RULES = firmest_first(GripRules())
"""Margins of plans, if nothing else is asked for."""


@dataclass(frozen=True)
class SearchOptions:
    """How finely and how long to search.

    Parameters
    ----------
    step_rad : float
        Largest rotation between two chances to regrasp, Δθ [rad].
    mode : Mode
        Robust or paper mode.
    time_limit_s : float or None
        Wall time after which the search gives up [s]; None: no limit.
    """

    step_rad: float = math.radians(20.0)
    mode: Mode = Mode.ROBUST
    time_limit_s: float | None = None

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('step-deg', math.degrees(self.step_rad), low=0.1, high=90.0)
        if self.time_limit_s is not None:
            check_number('time-limit', self.time_limit_s, low=0.0, low_open=True)
