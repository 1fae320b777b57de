# SPDX-License-Identifier: Apache-2.0
"""The station as it is, which need not be the one that a plan was made for."""

from __future__ import annotations

from dataclasses import dataclass, field

from microhand_planner.core.errors import InvalidParameter
from microhand_planner.core.parameters import ContactLaw, check_number
from microhand_planner.core.plan import FINGERS


@dataclass(frozen=True)
class TrueStation:
    """What fingers and contacts are really like.

    Parameters
    ----------
    law : ContactLaw
        True friction and pull-off force.
    stiffness_uN_per_um : tuple of 3 float
        Of fingers 1, 2, 3 [µN/µm = N/m].
    placement_um : float
        Whenever a finger comes to the object it is off by a normally distributed error; its
        standard deviation in each direction [µm].
    """

    law: ContactLaw = field(default_factory=ContactLaw)
    stiffness_uN_per_um: tuple[float, float, float] = (20.0, 20.0, 20.0)
    placement_um: float = 0.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        if len(self.stiffness_uN_per_um) != FINGERS:
            raise InvalidParameter(
                'stiffness', list(self.stiffness_uN_per_um), f'{FINGERS} numbers'
            )
        for stiffness in self.stiffness_uN_per_um:
            check_number('stiffness', stiffness, low=0.1, high=1e4)
        check_number('placement', self.placement_um, low=0.0, high=10.0)
