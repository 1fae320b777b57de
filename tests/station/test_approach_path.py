# SPDX-License-Identifier: Apache-2.0
"""The way to the start of a plan: apart from the object and from each other, or refused."""

import itertools

import numpy as np
import pytest

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.trajectory import Pace, time_steps
from microhand_station.sequencer.approach_path import way_to_start

HOME_UM = np.array([[40.0, 0.0, 0.0], [-40.0, 0.0, 0.0], [0.0, 0.0, 40.0]])


def walk(tip_um, plan):
    """Return the tips (n, 3, 3) along the way, densely, and the steps."""
    steps = way_to_start(tip_um, plan)
    return time_steps(steps, Pace()).tip_um, steps


def nearest_pair_um(tips):
    """Return the smallest distance of two tips on a path (n, 3, 3)."""
    return min(
        np.linalg.norm(tips[:, a] - tips[:, b], axis=1).min() for a, b in ((0, 1), (0, 2), (1, 2))
    )


def test_the_way_ends_where_the_plan_begins_and_one_finger_moves_at_a_time(sphere_plan):
    """From home, each step moves one tip, and the last waypoint is the plan's first."""
    plan = sphere_plan()
    tips, steps = walk(HOME_UM, plan)
    np.testing.assert_allclose(tips[0], HOME_UM, atol=1e-6)
    np.testing.assert_allclose(tips[-1], plan.steps[0].tip_um[0], atol=1e-6)
    for step in steps:
        moved = np.ptp(step.tip_um, axis=0).max(axis=1) > 0
        assert np.flatnonzero(moved).tolist() == [step.finger - 1]


@pytest.mark.parametrize('seed', range(20))
def test_no_tip_comes_near_the_object_or_another_tip(sphere_plan, seed):
    """From anywhere outside, tips keep the plan's own distance from the object, and 2r apart."""
    plan = sphere_plan(wait_um=30.0)
    rng = np.random.default_rng(seed)
    start = np.zeros((3, 3))
    while nearest_pair_um(start[None]) < 9.0:
        start = rng.normal(size=(3, 3))
        start *= rng.uniform(31.0, 50.0, (3, 1)) / np.linalg.norm(start, axis=1, keepdims=True)
    try:
        tips, _ = walk(start, plan)
    except RunFailed:
        return
    assert np.linalg.norm(tips, axis=-1).min() > 30.0 - 0.05
    assert nearest_pair_um(tips) > 9.0 - 1e-3


def test_fingers_that_stand_in_contact_leave_outwards_first(sphere_plan):
    """After a run a finger on the far side goes out and around, never through the object."""
    plan = sphere_plan()
    standing = np.array([[-16.5, 0.0, 0.0], [0.0, -40.0, 0.0], [0.0, 16.5, 0.0]])
    tips, _ = walk(standing, plan)
    distance = np.linalg.norm(tips[:, 0], axis=1)
    assert distance.min() >= 16.5 - 1e-6
    assert nearest_pair_um(tips) > 9.0
    turning = np.abs(np.diff(np.arctan2(tips[:, 0, 1], -tips[:, 0, 0]))) > 1e-4
    assert distance[1:][turning].min() > 36.0 - 0.05


def test_fingers_change_sides(sphere_plan):
    """From home with fingers 1 and 2 on the wrong sides there is a way, as for every labelling."""
    for order in itertools.permutations(range(3)):
        tips, _ = walk(HOME_UM[list(order)] * 1.75, sphere_plan())
        assert nearest_pair_um(tips) > 9.0 - 1e-3
        assert np.linalg.norm(tips, axis=-1).min() > 36.0 - 0.05


def test_fingers_that_are_there_do_not_move(sphere_plan):
    """At the start of the plan there is no way to go."""
    plan = sphere_plan()
    assert way_to_start(plan.steps[0].tip_um[0], plan) == ()


def test_overlapping_tips_are_refused_with_names_and_distance(sphere_plan):
    """Two fingers that start 5 µm apart cannot be moved safely in any order."""
    tips = np.array([[40.0, 20.0, 0.0], [40.0, 25.0, 0.0], [0.0, 0.0, 40.0]])
    with pytest.raises(RunFailed, match=r'fingers \d and \d would come as near as 5\.00 µm') as e:
        way_to_start(tips, sphere_plan())
    assert e.value.code == 308
