# SPDX-License-Identifier: Apache-2.0
"""What both searches have in common: they are given starts and room, until they have an answer."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from microhand_planner.core.key_table import NOBODY
from microhand_planner.core.rotation_lattice import IntArray
from microhand_planner.core.search_result import Outcome, SearchResult
from microhand_planner.core.search_state import Packing, named_fingers, unpack_all
from microhand_planner.core.states import DONE, EXPANDED, STATES, States, way_to, with_more

MORE_STARTS = -1
"""What a step returns if only states that are dearer than the next start wait."""
MORE_ROOM = -2
"""What a step returns if its states need more room."""
ENDED = 10
"""A step that ends the search without a path returns its `Outcome` less this."""

Step = Callable[[States, int, bool], int]
"""Goes on with a search, with its states, a packed grasp to start from or `NOBODY`, and whether
there may be more of those. Returns the number of the state that is the goal, or one of the above.
It may be asked for the same again."""


def explore(
    step: Step,
    states: States,
    starts: Iterator[int],
    bits: Packing,
    interrupt: IntArray,
    *,
    several: bool,
    interchangeable: bool,
    reverse: bool,
) -> SearchResult:
    """Search until there is an answer.

    Parameters
    ----------
    step : callable
        See `Step`.
    states : States
        None, as yet.
    starts : iterator of int
        Packed grasps to start from, the best first.
    bits : Packing
        Of the states.
    interrupt : (2,) int64
        See `interruption`.
    several : bool
        False: there is one start only.
    interchangeable, reverse : bool
        As in `swap_search`.

    Raises
    ------
    TimeLimitReached
        There is no room for more states.
    """
    if interrupt.shape != (2,):  # compiled code writes to it, and does not look
        raise ValueError(f'a flag of shape (2,) is needed, not {interrupt.shape}')
    start = next(starts, NOBODY)
    while True:
        several = several and start != NOBODY
        ended = step(states, start, several)
        if ended == MORE_STARTS:
            start = next(starts, NOBODY)
        elif ended == MORE_ROOM:
            states = with_more(states, interrupt)
        else:
            break
    expanded = int(states.counts[EXPANDED])
    waiting = int(states.counts[STATES] - states.counts[DONE])
    if ended < 0:
        no_path = np.zeros((0, 4), dtype=np.int64)
        return SearchResult(Outcome(ended + ENDED), -1, no_path, expanded, waiting)
    path = unpack_all(way_to(states, ended, bits.orientation), bits)
    if reverse:
        path = path[::-1]
    if interchangeable:
        path = named_fingers(path)
    return SearchResult(Outcome.FOUND, int(states.cost[ended]), path, expanded, waiting)
