# SPDX-License-Identifier: Apache-2.0
"""The states that a search has met, and the way to each.

A state is a grasp at an orientation. Grasps are numbered, and so are states, both in the order in
which they are met. A grasp has a row with a column for each orientation, so that states which roll
into each other are found without a search, and grasps by a hash table.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import numba as nb
import numpy as np
import numpy.typing as npt

from microhand_planner.core.errors import TimeLimitReached
from microhand_planner.core.key_table import NOBODY, KeyTable, add, find, key_table, with_room
from microhand_planner.core.open_list import (
    Int32Array,
    OpenList,
    leave,
    open_list,
    spare_rows,
    wait,
    with_places,
    with_rows,
)
from microhand_planner.core.rotation_lattice import IntArray

MOST_BYTES = 1_200_000_000
"""A search that needs more memory for its states is cut off."""

GRASP, AT, PARENT, STAGE = 0, 1, 2, 3
"""Columns of `States.fact`."""
GRASPS, STATES, DONE, EXPANDED, NEEDED = 0, 1, 2, 3, 4
"""Places in `States.counts`."""

_Int = TypeVar('_Int', bound=np.signedinteger[Any])

_ROOM = 256  # for grasps and states at first
_BYTES_PER_STATE = 36
_COPIED_AT_ONCE = 1 << 25  # bytes


class States(NamedTuple):
    """Grasps and states.

    Parameters
    ----------
    grasps : KeyTable
        Packed grasps.
    state_of : (g, m) int
        The number of a grasp's state at an orientation plus one; 0: it was not met.
    nearest : (g, m) int
        What is known of a grasp at an orientation, see `outlook`; 0 at first. No columns where
        nobody looks.
    fact : (s, 4) int
        Grasp and orientation of a state; the state before it (of a start: itself); what is to be
        done next when it is expanded, `NOBODY`: nothing.
    cost : (s,) int
        Of the cheapest way that is known [1e-9 deg].
    waiting : OpenList
        States that are to be expanded.
    totals : int
        How many new totals the expansion of a state brings at most.
    counts : (5,) int
        Grasps and states met, states done with, states expanded; how many more grasps and states
        need room.
    """

    grasps: KeyTable
    state_of: Int32Array
    nearest: npt.NDArray[np.int16]
    fact: Int32Array
    cost: IntArray
    waiting: OpenList
    totals: int
    counts: IntArray


def no_states(orientations: int, ranks: int, totals: int, *, looks: bool) -> States:
    """Return nothing at all, with a little room.

    Parameters
    ----------
    orientations, ranks, totals : int
        How many there are, how many values an estimate can have, and see `States`.
    looks : bool
        Whether `nearest` is used.
    """
    return States(
        key_table(_ROOM),
        np.zeros((_ROOM, orientations), dtype=np.int32),
        np.zeros((_ROOM, orientations if looks else 0), dtype=np.int16),
        np.zeros((_ROOM, 4), dtype=np.int32),
        np.zeros(_ROOM, dtype=np.int64),
        open_list(_ROOM, ranks, 2 * totals),
        totals,
        np.zeros(5, dtype=np.int64),
    )


@nb.njit(cache=True, _nrt=False)
def has_room(states: States, more: int) -> bool:  # pragma: no cover - compiled
    """Return whether so many more grasps and states find room, and a few totals.

    If not, the number is noted for `with_more`.
    """
    states.counts[NEEDED] = more
    return (
        states.counts[GRASPS] + more <= len(states.state_of)
        and states.counts[STATES] + more <= len(states.cost)
        and spare_rows(states.waiting) >= states.totals
    )


def with_more(states: States, interrupt: IntArray) -> States:
    """Return the same states with room for those for whom `has_room` found none.

    Parameters
    ----------
    states : States
        What has to grow.
    interrupt : (2,) int64
        See `interruption`; what is returned then is good for nothing but the count of states.

    Raises
    ------
    TimeLimitReached
        That would take more memory than a search may have.
    """
    needed = int(states.counts[NEEDED])
    known = int(states.counts[GRASPS])
    room = len(states.state_of)
    if known + needed > room:
        room = 2 * (known + needed)
    rows_known = int(states.counts[STATES])
    rows = len(states.cost)
    if rows_known + needed > rows:
        rows = 2 * (rows_known + needed)
    bytes_per_grasp = 4 * states.state_of.shape[1] + 2 * states.nearest.shape[1] + 32
    if room * bytes_per_grasp + rows * _BYTES_PER_STATE > MOST_BYTES:
        expanded = int(states.counts[EXPANDED])
        raise TimeLimitReached(
            f'the search was cut off: {expanded} states were expanded, and there is no memory for '
            'more; a plan may exist, a larger step has fewer states',
            expanded,
        )
    if room > len(states.state_of):
        grasps = with_room(states.grasps, known, room)
        room = len(grasps.key)
        states = states._replace(
            grasps=grasps,
            state_of=_longer(states.state_of, known, room, interrupt),
            nearest=_longer(states.nearest, known, room, interrupt),
        )
    if rows > len(states.cost):
        states = states._replace(
            fact=_longer(states.fact, rows_known, rows, interrupt),
            cost=_longer(states.cost, rows_known, rows, interrupt),
            waiting=with_places(states.waiting, rows),
        )
    if states.waiting.counts[2] < states.totals:
        states = states._replace(waiting=with_rows(states.waiting, states.totals))
    return states


def _longer(
    rows: npt.NDArray[_Int], known: int, room: int, interrupt: IntArray
) -> npt.NDArray[_Int]:
    """Return the first rows, and behind them others that are zero.

    Memory that is zero costs nothing before it is used.
    """
    longer = np.zeros((room, *rows.shape[1:]), dtype=rows.dtype)
    at_once = max(1, _COPIED_AT_ONCE * len(rows) // max(1, rows.nbytes))
    for begin in range(0, known, at_once):
        if interrupt[0] != 0:  # hundreds of megabytes take longer than a time limit may
            break
        end = min(known, begin + at_once)
        longer[begin:end] = rows[begin:end]
    return longer


def way_to(states: States, state: int, orientation_bits: int) -> IntArray:
    """Return the packed states from a start to a state, in order."""
    path: list[int] = []
    while True:
        grasp, at, parent, _ = states.fact[state].tolist()
        path.append(int(states.grasps.key[grasp]) << orientation_bits | at)
        if parent == state:
            return np.array(path[::-1], dtype=np.int64)
        state = parent


@nb.njit(cache=True, _nrt=False)
def grasp_number(states: States, code: int) -> int:  # pragma: no cover - compiled
    """Return the number of a packed grasp; a new one, if it is met for the first time."""
    grasp, slot = find(states.grasps, code)
    if grasp == NOBODY:
        grasp = states.counts[GRASPS]
        states.counts[GRASPS] += 1
        add(states.grasps, slot, code, grasp)
    return grasp


@nb.njit(cache=True, _nrt=False)
def reach(
    states: States,
    grasp: int,
    at: int,
    cost_ndeg: int,
    parent: int,
    total_ndeg: int,
    rank: int,
) -> None:  # pragma: no cover - compiled
    """Let a state wait, unless a way to it is known that costs no more.

    Parameters
    ----------
    states : States
        There is room.
    grasp, at : int
        Number of the grasp, and the orientation.
    cost_ndeg, parent : int
        What the new way costs [1e-9 deg], and the state before on it, or `NOBODY`.
    total_ndeg, rank : int
        Where it waits, see `open_list`.
    """
    state = states.state_of[grasp, at] - 1
    if state == NOBODY:
        state = states.counts[STATES]
        states.counts[STATES] += 1
        states.state_of[grasp, at] = state + 1
        states.fact[state, GRASP] = grasp
        states.fact[state, AT] = at
    elif states.cost[state] <= cost_ndeg:
        return
    else:
        leave(states.waiting, state)
        if states.fact[state, STAGE] == NOBODY:
            states.counts[DONE] -= 1
    states.cost[state] = cost_ndeg
    states.fact[state, PARENT] = state if parent == NOBODY else parent
    states.fact[state, STAGE] = 0
    wait(states.waiting, state, total_ndeg, rank)
