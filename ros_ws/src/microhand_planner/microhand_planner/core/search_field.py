# SPDX-License-Identifier: Apache-2.0
"""The planar problem as the compiled searches see it, and the moves that it allows."""

from __future__ import annotations

from typing import NamedTuple

import numba as nb

from microhand_planner.core.grasp import tips_clear
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules
from microhand_planner.core.pose import FloatArray
from microhand_planner.core.rotation_lattice import BoolArray, IntArray, RotationLattice


class SearchField(NamedTuple):
    """The arrays of a `RotationLattice` and the numbers of finger and contact law, for numba."""

    sample_of: IntArray
    theta_ndeg: IntArray
    interior: IntArray
    block: int
    centre_um: FloatArray
    contact_um: FloatArray
    normal: FloatArray
    usable: BoolArray
    min_distance_um: float
    friction: float
    pull_off_uN: float
    max_force_uN: float
    planned_grip: bool
    margin_uN: float
    tolerance_uN: float


def search_field(
    lattice: RotationLattice, finger: Finger, law: ContactLaw, rules: GripRules | None
) -> SearchField:
    """Return what the compiled searches need to know; without `rules` as [Kumar2021] has it."""
    return SearchField(
        lattice.sample_of,
        lattice.theta_ndeg,
        lattice.interior,
        lattice.block,
        lattice.centre_um,
        lattice.contact_um,
        lattice.normal,
        lattice.usable,
        finger.min_distance_um,
        law.friction * (1.0 if rules is None else rules.margin_factor),
        law.stick_uN,
        law.max_force_uN,
        rules is not None,
        0.0 if rules is None else rules.least_margin_uN,
        0.0 if rules is None else rules.grip_tolerance_uN,
    )


@nb.njit(cache=True, inline='always')
def clear_of(field: SearchField, sample: int, other: int) -> bool:  # pragma: no cover - compiled
    """Return whether tips may stand on two samples at once."""
    return tips_clear(field.centre_um[sample], field.centre_um[other], field.min_distance_um)


@nb.njit(cache=True)
def rolls(
    field: SearchField, first: int, second: int, lower: int, arrive: int
) -> bool:  # pragma: no cover - compiled
    """Return whether two tracks stay a grasp between orientation `lower` and the next.

    The orientation that they come from is known to be good; `arrive` is the other one.
    """
    one = field.sample_of[first, arrive]
    two = field.sample_of[second, arrive]
    if not (field.usable[one] and field.usable[two] and clear_of(field, one, two)):
        return False
    one = field.sample_of[first, lower]
    two = field.sample_of[second, lower]
    one_block = one - one % field.block
    two_block = two - two % field.block
    for back in range(1, field.interior[lower] + 1):
        here = one_block + (one - one_block - back) % field.block
        there = two_block + (two - two_block - back) % field.block
        if not (field.usable[here] and field.usable[there] and clear_of(field, here, there)):
            return False
    return True
