# SPDX-License-Identifier: Apache-2.0
"""The thread that owns the physics: what it is asked comes before what it has to catch up with."""

import numpy as np
import pytest

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import Pose
from microhand_twin.ros.follower import Follower
from microhand_twin.ros.live_world import LiveWorld
from microhand_twin.world import build_world

AWAY = np.array([[60.0, 0, 0], [-60.0, 0, 0], [0, 60.0, 0]])
BACKLOG_S = 60.0
"""So much takes the physics seconds."""


@pytest.fixture(scope='module')
def ellipsoid():
    """Return the world of the ellipsoid."""
    return build_world(find_part('ellipsoid'), stiffness_uN_per_um=20.0)


@pytest.fixture
def advanced():
    """Return a list that keeps what a follower tells: times and reports."""
    return []


@pytest.fixture
def follower(advanced):
    """Return a follower that is ended after the test."""
    troubles = []
    follower = Follower(lambda *told: advanced.append(told), troubles.append)
    follower.start()
    yield follower
    follower.stop()
    assert troubles == []


def hear(follower, from_s, to_s):
    """Let all fingers report that they stand, once in 10 ms."""
    for time_s in np.arange(from_s, to_s, 0.01):
        for finger in (1, 2, 3):
            follower.hear(finger, float(time_s), AWAY[finger - 1])


def live(world):
    """Return a world with the ellipsoid at the origin."""
    return LiveWorld(world, Pose(), np.full((3, 3), np.nan))


def test_questions_are_answered_before_all_is_caught_up_with(follower, advanced, ellipsoid):
    """A minute behind, it answers between two steps; the minute is not over by then."""
    follower.adopt(live(ellipsoid))
    hear(follower, 0.0, 0.05)
    hear(follower, BACKLOG_S, BACKLOG_S + 0.02)
    reached_s = follower.ask(lambda _: advanced[-1][0] if advanced else 0.0)
    assert reached_s < BACKLOG_S


def test_another_world_does_not_live_through_what_was_before_it(follower, advanced, ellipsoid):
    """Adopted a minute behind, a world begins with the next report, and the rest is dropped."""
    follower.adopt(live(ellipsoid))
    hear(follower, 0.0, 0.05)
    hear(follower, BACKLOG_S, BACKLOG_S + 0.02)
    second = live(ellipsoid)
    follower.adopt(second)
    told = len(advanced)
    hear(follower, BACKLOG_S + 0.02, BACKLOG_S + 0.1)
    last_s = BACKLOG_S + 0.1 - 0.01

    def caught_up(_):
        if advanced[-1][0] < last_s - 1e-6:
            raise RunFailed('not yet')

    while True:
        try:
            follower.ask(caught_up)
            break
        except RunFailed:
            continue
    assert second.report.contacts is not None
    assert len(advanced) - told < 20  # and not one for each hundredth of the minute


def test_what_is_asked_may_fail_and_the_thread_goes_on(follower):
    """An error of the question is the asker's; the next question is answered."""

    def fail(_):
        raise RunFailed('no')

    with pytest.raises(RunFailed, match='no'):
        follower.ask(fail)
    assert follower.ask(lambda world: world) is None


def test_stages_that_never_reported_are_named(follower):
    """STAGE_MISSING after the time given, with the fingers of which nothing was heard."""
    follower.hear(2, 0.0, AWAY[1])
    with pytest.raises(RunFailed, match='finger 1, 3: nothing heard of its stage'):
        follower.wait_until_heard(0.05)
