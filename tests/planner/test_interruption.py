# SPDX-License-Identifier: Apache-2.0
"""Searches that are ended from outside say so; they would run for minutes."""

import itertools
import math
import threading
import time

import numpy as np
import pytest

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.errors import Cancelled, NoPlanExists, TimeLimitReached
from microhand_planner.core.interruption import interruption
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.planar import solve_planar
from microhand_planner.core.planar_problem import PlanarProblem
from microhand_planner.core.planned_rotation import Problem, plan_planar_rotation
from microhand_planner.core.search_result import Outcome
from microhand_planner.core.section import XY_PLANE

SOON_S = 20.0  # deadline of a wait


class Steps:
    """A clock that shows one second more each time that it is read."""

    def __init__(self):
        self.count = itertools.count()

    def __call__(self):
        """Return the next second."""
        return float(next(self.count))


def from_call(number):
    """Return a callable that says True from its n-th call on."""
    calls = itertools.count(1)
    return lambda: next(calls) >= number


def rotate(
    step_deg, friction, *, adhesion, time_limit_s=None, cancelled=None, clock=time.monotonic
):
    """Plan 220 deg between the joints of a long ellipse."""
    curve = offset_curve(ellipse_section(20.0, 10.0, XY_PLANE), 4.5)
    options = SearchOptions(math.radians(step_deg), time_limit_s=time_limit_s)
    law = ContactLaw(friction=friction, adhesion=adhesion)
    joints = (0.0, curve.phase_of_joint_j)
    with interruption(time_limit_s, cancelled, clock) as flag:
        problem = Problem(Finger(), law, options, clock, flag)
        rotation = PlanarRotation('z', math.radians(220.0))
        return plan_planar_rotation(rotation, curve, problem, joints, joints)


@pytest.fixture(scope='module', params=[True, False], ids=['adhesion', 'no adhesion'])
def dear(request):
    """Return a search that takes minutes; the compiler has done its work before."""
    rotate(20.0, 1.0, adhesion=request.param)
    return {'step_deg': 1.0, 'friction': 0.1 if request.param else 0.6, 'adhesion': request.param}


def test_cancelled_search_says_so(dear):
    """A caller who changes their mind gets `Cancelled`, with the effort so far."""
    with pytest.raises(Cancelled, match='cancelled while planning a rotation about z') as caught:
        rotate(**dear, cancelled=from_call(100))
    assert caught.value.expanded > 0


def test_time_limit_says_so(dear):
    """A search that is out of time is `TimeLimitReached`, which is not 'no plan exists'."""
    with pytest.raises(TimeLimitReached, match=r'of 100 s reached.*may exist') as caught:
        rotate(**dear, time_limit_s=100.0, clock=Steps())
    assert not isinstance(caught.value, NoPlanExists)
    assert caught.value.expanded > 0


def test_planar_problem_can_be_interrupted():
    """The planar problem alone looks at the same flag."""
    problem = PlanarProblem(
        (20.0, 10.0), 1480, 1.0, 361, (1, 741, 0, 1), (1, 741, 0, 221),
        law=ContactLaw(friction=0.1),
    )  # fmt: skip
    with interruption(50.0, None, Steps()) as flag:
        answer = solve_planar(problem, flag)
    assert answer.outcome is Outcome.TIME_LIMIT
    assert answer.path == ()
    assert answer.expanded > 0


def test_limits_that_are_not_reached_change_nothing():
    """With time to spare and nobody who cancels, the path is the same as without limits."""
    free, _ = rotate(20.0, 0.3, adhesion=True)
    limited, _ = rotate(20.0, 0.3, adhesion=True, time_limit_s=1e6, cancelled=lambda: False)
    assert np.array_equal(free.states, limited.states)


@pytest.mark.parametrize('adhesion', [True, False])
def test_effort_can_be_seen_from_outside(adhesion):
    """The flag counts the states of all searches, and the watch tells what it shows."""
    told = []
    law = ContactLaw(friction=0.5, adhesion=adhesion)
    curve = offset_curve(ellipse_section(15.2, 12.7, XY_PLANE), 4.5)
    joints = (0.0, curve.phase_of_joint_j)
    effort = 0
    with interruption(None, None, time.monotonic, told.append) as flag:
        problem = Problem(Finger(), law, SearchOptions(), time.monotonic, flag)
        for angle_deg in (220.0, 80.0):
            turn = PlanarRotation('z', math.radians(angle_deg))
            _, expanded = plan_planar_rotation(turn, curve, problem, joints, joints)
            effort += expanded
        deadline = time.monotonic() + SOON_S
        while effort not in told:
            assert time.monotonic() < deadline
    assert flag[1] == effort > 0


def test_nobody_watches_without_a_reason():
    """Without limit and caller no thread is started, and the flag stays down."""
    before = threading.active_count()
    with interruption(None, None, time.monotonic) as flag:
        assert threading.active_count() == before
        assert flag[0] == 0
    assert flag[0] == 0


@pytest.mark.parametrize('fails', [True, False])
def test_the_watch_ends_with_the_search(fails):
    """However a search ends, the thread that watched it is gone."""
    before = threading.active_count()
    try:
        with interruption(1e6, lambda: False, time.monotonic):
            assert threading.active_count() == before + 1
            if fails:
                raise NoPlanExists('nothing')
    except NoPlanExists:
        assert fails
    assert threading.active_count() == before


def test_cancelling_wins_over_the_time_limit():
    """A caller who cancelled is told so, even if the time is up as well."""
    with interruption(1.0, lambda: True, Steps()) as flag:
        deadline = time.monotonic() + SOON_S
        while flag[0] == 0:
            assert time.monotonic() < deadline
    assert flag[0] == Outcome.CANCELLED
