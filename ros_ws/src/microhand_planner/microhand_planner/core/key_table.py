# SPDX-License-Identifier: Apache-2.0
"""Numbers for the keys that a search meets, in the order in which it meets them.

What a search knows of a key stands in rows by its number, which an open-addressing hash table
finds. Nothing depends on the order of that table, so neither does the search.

Functions that run for every key are compiled without numba's reference counts (``_nrt=False``):
they make no arrays, and counting those that they are given takes longer than all else they do.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from microhand_planner.core.rotation_lattice import IntArray

NOBODY = -1

_GOLDEN = -7046029254386353131  # 2**64 over the golden ratio, as a signed integer
_NUMBER = (1 << 32) - 1


class KeyTable(NamedTuple):
    """Keys and their numbers.

    Parameters
    ----------
    slots : (2^k,) int
        Hash table: 0, or the number of a key plus one, beside a part of its hash.
    key : (2^(k-1),) int
        Keys by their numbers.
    """

    slots: IntArray
    key: IntArray


def key_table(room: int) -> KeyTable:
    """Return an empty table with room for at least so many keys."""
    slots = 2 << (room - 1).bit_length()
    return KeyTable(np.zeros(slots, dtype=np.int64), np.zeros(slots // 2, dtype=np.int64))


def with_room(table: KeyTable, known: int, room: int) -> KeyTable:
    """Return a larger table with the `known` keys of this one."""
    grown = key_table(room)
    grown.key[:known] = table.key[:known]
    _fill(grown, known)
    return grown


@nb.njit(cache=True, _nrt=False)
def _fill(table: KeyTable, known: int) -> None:  # pragma: no cover - compiled
    """Put the first keys into the slots."""
    for number in range(known):
        key = table.key[number]
        _, slot = find(table, key)
        add(table, slot, key, number)


@nb.njit(cache=True, _nrt=False)
def spread(key: int) -> int:  # pragma: no cover - compiled
    """Return a hash of an integer, all bits of which can be used."""
    mixed = key * _GOLDEN
    mixed = (mixed ^ (mixed >> 32)) * _GOLDEN
    return mixed ^ (mixed >> 32)


@nb.njit(cache=True, _nrt=False)
def find(table: KeyTable, key: int) -> tuple[int, int]:  # pragma: no cover - compiled
    """Return the number of a key, or `NOBODY`, and the slot where it is or belongs."""
    mask = len(table.slots) - 1
    mixed = spread(key)
    tag = mixed & ~_NUMBER
    slot = mixed & mask
    while True:
        entry = table.slots[slot]
        if entry == 0:
            return NOBODY, slot
        if entry & ~_NUMBER == tag:
            number = (entry & _NUMBER) - 1
            if table.key[number] == key:
                return number, slot
        slot = (slot + 1) & mask


@nb.njit(cache=True, _nrt=False)
def add(table: KeyTable, slot: int, key: int, number: int) -> None:  # pragma: no cover - compiled
    """Add a key with the next number in the slot that `find` named."""
    table.slots[slot] = (spread(key) & ~_NUMBER) | (number + 1)
    table.key[number] = key
