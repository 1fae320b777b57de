# SPDX-License-Identifier: Apache-2.0
"""What a planar search answers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from microhand_planner.core.rotation_lattice import IntArray

NO_BOUND = int(np.iinfo(np.int64).max)


class Outcome(IntEnum):
    """How a search ended."""

    FOUND = 0
    NO_PATH = 1
    """Everything reachable was expanded."""
    BOUNDED = 2
    """No path is cheaper than the bound."""
    TIME_LIMIT = 3
    CANCELLED = 4


@dataclass(frozen=True)
class SearchResult:
    """What a planar search found.

    Parameters
    ----------
    outcome : Outcome
        How it ended.
    cost_ndeg : int
        Cost of the path [1e-9 deg]; -1 if there is none.
    states : (k, 4) int
        From start to goal: the tracks of fingers 1, 2, 3 (-1: free) and the orientation.
    expanded : int
        States expanded.
    waiting : int
        States met and not done with at the end: 'to be visited' in [Kumar2021] Table 4.
    """

    outcome: Outcome
    cost_ndeg: int
    states: IntArray
    expanded: int
    waiting: int
