# SPDX-License-Identifier: Apache-2.0
"""How fingers feel for the object, and what the twin of a simulated station takes to be true."""

from __future__ import annotations

from dataclasses import dataclass

from microhand_planner.core.errors import InvalidParameter
from microhand_planner.core.motions import Touch
from microhand_planner.core.parameters import check_number

STIFFNESS_N_PER_M = 20.0
"""Of a finger, unless the station file says otherwise; real ones have 10 to 100 N/m."""
CONTACT_RATE_UN_S = 20.0
"""How fast the force of a finger that has touched may rise until its stage stops [µN/s].

A contact is known some 15 ms later: then it is 0.3 µN, as much as grips leave for such things.
"""


@dataclass(frozen=True)
class ContactConfig:
    """How a finger meets the object: slowly, and until it feels it.

    Parameters
    ----------
    speed_um_s : float or None
        Speed of a tip that is about to touch [µm/s]. It goes on until a contact is reported, and
        the force rises. None: so fast that it rises by `CONTACT_RATE_UN_S` on the stiffest finger.
    standoff_um : float
        The slow approach begins so far before the planned contact [µm].
    overtravel_um : float
        It ends so far beyond: the finger has met nothing [µm].
    tolerance_um : float
        A contact that is farther from the planned one ends the run [µm]; less than `standoff_um`.
    force_rate_uN_s : float
        How fast forces are ramped [µN/s].
    """

    speed_um_s: float | None = None
    standoff_um: float = Touch.standoff_um
    overtravel_um: float = Touch.overtravel_um
    tolerance_um: float = 0.4
    force_rate_uN_s: float = Touch.force_rate_uN_s

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.speed_um_s is not None:
            check_number('speed_um_s', self.speed_um_s, low=0.01, high=100.0)
        check_number('standoff_um', self.standoff_um, low=0.01, high=100.0)
        check_number('overtravel_um', self.overtravel_um, low=0.01, high=100.0)
        check_number('tolerance_um', self.tolerance_um, low=0.001, high=100.0)
        check_number('force_rate_uN_s', self.force_rate_uN_s, low=0.01, high=1e6)
        # a finger that touches before it feels for the object cannot tell where
        if not self.tolerance_um < self.standoff_um:
            allowed = f'less than standoff_um, {self.standoff_um:g}'
            raise InvalidParameter('tolerance_um', self.tolerance_um, allowed)

    def touch(self, stiffest_uN_per_um: float) -> Touch:
        """Return what time laws need of it, for fingers up to a stiffness [µN/µm]."""
        speed_um_s = self.speed_um_s or CONTACT_RATE_UN_S / stiffest_uN_per_um
        return Touch(speed_um_s, self.standoff_um, self.overtravel_um, self.force_rate_uN_s)


@dataclass(frozen=True)
class TwinConfig:
    """The physics that stands in for the object, and what counts as held.

    Parameters
    ----------
    enabled : bool
        False: nobody judges the object, and contacts are reported by sensors.
    friction : float or None
        True Coulomb coefficient; None: as the plan assumes.
    pull_off_uN : float or None
        True pull-off force [µN], 0: nothing sticks; None: as the plan assumes.
    object_tolerance_deg, object_tolerance_um : float
        An object that is turned or displaced further than this from where the plan has it is lost.
    """

    enabled: bool = True
    friction: float | None = None
    pull_off_uN: float | None = None
    object_tolerance_deg: float = 5.0
    object_tolerance_um: float = 2.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.friction is not None:
            check_number('friction', self.friction, low=0.0, high=2.0)
        if self.pull_off_uN is not None:
            check_number('pull_off_uN', self.pull_off_uN, low=0.0, high=1e3)
        check_number('object_tolerance_deg', self.object_tolerance_deg, low=0.01, high=180.0)
        check_number('object_tolerance_um', self.object_tolerance_um, low=0.001, high=1e4)
