# SPDX-License-Identifier: Apache-2.0
"""Verdicts that a search has asked for before, for it asks again at other orientations.

What a roll or a swap needs depends on the contacts alone. Each verdict has one place in a table of
bounded size, and is formed anew if another has taken its place.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from microhand_planner.core.key_table import NOBODY, spread
from microhand_planner.core.pose import FloatArray
from microhand_planner.core.removal_verdicts import RemovalLaw, swap_verdicts
from microhand_planner.core.rotation_lattice import BoolArray, IntArray, RotationLattice

WORD = 64
_MOST_ROLLS = 1 << 16
_MOST_SWAP_WORDS = 1 << 22


class KnownVerdicts(NamedTuple):
    """Tables of verdicts.

    Parameters
    ----------
    one_step : (m - 1,) bool
        Whether an orientation and the next are one step of the lattice apart.
    roll : (2^k,) int
        0, or twice a key plus the verdict on a roll by one step.
    swap : (2^k,) int
        0, or the key of a row of `swap_bits`.
    swap_bits : (2^k, w) int
        For two fingers that hold, a bit for each contact of the lattice: whether a third may be
        placed there so that the second can leave.
    may : (c,) bool
        Room for the verdicts of one row.
    """

    one_step: BoolArray
    roll: IntArray
    swap: IntArray
    swap_bits: IntArray
    may: BoolArray


def known_verdicts(lattice: RotationLattice) -> KnownVerdicts:
    """Return empty tables for a lattice."""
    count = lattice.contacts
    words = -(-count // WORD)
    block_of = lattice.sample_of[0] // lattice.block
    one_step = lattice.interior == lattice.block // count - 1
    swaps = _power_of_two(min(count * count, _MOST_SWAP_WORDS // words))
    return KnownVerdicts(
        one_step & (block_of[1:] == block_of[:-1]),
        np.zeros(_power_of_two(min(count * count, _MOST_ROLLS)), dtype=np.int64),
        np.zeros(swaps, dtype=np.int64),
        np.zeros((swaps, words), dtype=np.int64),
        np.zeros(count, dtype=np.bool_),
    )


def _power_of_two(most: int) -> int:
    """Return the largest power of two that is no larger."""
    return 1 << (most.bit_length() - 1)


@nb.njit(cache=True, _nrt=False)
def known_roll(roll: IntArray, key: int) -> int:  # pragma: no cover - compiled
    """Return what is known of a roll by one step: 1: possible, 0: not, `NOBODY`: nothing.

    The key is that of the two contacts from which it starts, or where it arrives, whichever has
    the lower orientation. One end is good; so the verdict is the same in both directions.
    """
    entry = roll[spread(key) & (len(roll) - 1)]
    return entry & 1 if entry >> 1 == key else NOBODY


@nb.njit(cache=True, _nrt=False)
def note_roll(roll: IntArray, key: int, verdict: bool) -> None:  # pragma: no cover - compiled
    """Remember a verdict on a roll by one step."""
    roll[spread(key) & (len(roll) - 1)] = 2 * key + verdict


@nb.njit(cache=True, _nrt=False)
def swap_row(
    known: KnownVerdicts,
    columns: FloatArray,
    first: int,
    stay: int,
    leave: int,
    reverse: bool,
    law: RemovalLaw,
) -> int:  # pragma: no cover - compiled
    """Return the row of `swap_bits` for two fingers that hold; see `swap_verdicts`.

    The tables belong to one search, so to one direction in time and one law.
    """
    places = columns.shape[1]
    key = (first * places + stay) * places + leave + 1
    slot = spread(key) & (len(known.swap) - 1)
    if known.swap[slot] != key:
        known.swap[slot] = key
        swap_verdicts(columns, first, stay, leave, reverse, law, known.may)
        for word in range(known.swap_bits.shape[1]):
            bits = 0
            for bit in range(min(WORD, len(known.may) - WORD * word)):
                bits |= known.may[WORD * word + bit] << bit
            known.swap_bits[slot, word] = bits
    return slot
