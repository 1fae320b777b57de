# SPDX-License-Identifier: Apache-2.0
"""Table 1 of the paper, rebuilt: the exact distance in a problem where everything holds."""

import itertools

import pytest

from microhand_planner.core.search_state import ABSENT, Grasp, reconfigurations_left

GOAL: Grasp = (10, 20, ABSENT)
TRACKS = (ABSENT, 10, 20, 30, 31, 32)
"""Free; both goal tracks; enough others for three fingers."""


def grasps(*, distinct: bool) -> set[Grasp]:
    """Return all grasps of two or three fingers; if `distinct`, on different tracks."""
    found = set()
    for grasp in itertools.product(TRACKS, repeat=3):
        placed = [track for track in grasp if track != ABSENT]
        if len(placed) >= 2 and (not distinct or len(set(placed)) == len(placed)):
            found.add(grasp)
    return found


def moves(grasp: Grasp, known: set[Grasp]) -> set[Grasp]:
    """Return what one placement or removal makes of a grasp."""
    changed = {
        (*grasp[:finger], track, *grasp[finger + 1 :])
        for finger, track in itertools.product(range(3), TRACKS)
        if (grasp[finger] == ABSENT) != (track == ABSENT)
    }
    return changed & known


def distances(goals: set[Grasp], known: set[Grasp]) -> dict[Grasp, int]:
    """Return the least number of moves from every known grasp to the nearest goal."""
    found = dict.fromkeys(goals, 0)
    front = list(goals)
    while front:
        front = [
            near
            for grasp in front
            for near in moves(grasp, known)
            if near not in found and found.setdefault(near, found[grasp] + 1)
        ]
    return found


@pytest.mark.parametrize('interchangeable', [False, True])
def test_estimate_is_the_exact_distance_if_every_grasp_holds(interchangeable: bool) -> None:
    """So it never overestimates, and no move changes it by more than one.

    Fingers with names may even share a track: that makes the problem easier still.
    """
    known = grasps(distinct=interchangeable)
    goals = set(itertools.permutations(GOAL)) if interchangeable else {GOAL}
    exact = distances(goals, known)
    assert exact.keys() == known
    goal = (20, 10, ABSENT) if interchangeable else GOAL
    for grasp, distance in exact.items():
        assert reconfigurations_left(grasp, goal, interchangeable) == distance
