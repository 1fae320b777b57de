# SPDX-License-Identifier: Apache-2.0
"""The planar problem by the paper's numbers: what its Table 3 says, and what a path looks like."""

import itertools
import math

import numpy as np
import pytest
from scipy.optimize import brentq

from microhand_planner.core.parameters import ContactLaw, Finger
from microhand_planner.core.planar import solve_planar
from microhand_planner.core.planar_problem import PlanarProblem
from microhand_planner.core.search_result import Outcome
from tests.planner.oracles import Ellipse, removal_window_lp

CONTACTS = 74
STEP_DEG = 20.0
SIX_GOALS = list(itertools.permutations((1, 38, 0)))


def ellipse_of_ratio(ratio):
    """Return the semi-axes of the ellipse with 74 contacts of 20 deg for a tip of 4.5 um."""
    turn_rad = math.radians(CONTACTS * STEP_DEG)
    b_um = brentq(lambda b: Ellipse(ratio * b, b, 4.5).turn_rad - turn_rad, 1.0, 100.0)
    return ratio * b_um, b_um


def second_rotation(goal, ratio=1.4, orientation=12, **law):
    """Return the rotation by 220 deg of [Kumar2021] Table 3, from [1 38 0 1] to a goal."""
    return PlanarProblem(
        ellipse_of_ratio(ratio),
        CONTACTS,
        STEP_DEG,
        orientations=19,
        start=(1, 38, 0, 1),
        goal=(*goal, orientation),
        law=ContactLaw(**law),
    )


def test_the_six_goals_of_table_3_cost_what_the_model_says():
    """The costs of the six permutations are 1880 twice, 2240 three times, and 2600."""
    costs = [solve_planar(second_rotation(goal)).cost_deg for goal in SIX_GOALS]
    assert sorted(costs) == [1880.0, 1880.0, 2240.0, 2240.0, 2240.0, 2600.0]


def test_the_best_goal_of_table_3_needs_eight_reconfigurations():
    """1880 = 2 x 220 of rolling + 8 x 180, as in the paper."""
    answers = [solve_planar(second_rotation(goal)) for goal in SIX_GOALS]
    best = [answer for answer in answers if answer.cost_deg == 1880.0]
    assert [answer.reconfigurations for answer in best] == [8, 8]


def test_the_fingers_that_stay_where_they_were_are_the_dearest_goal_of_table_3():
    """From [1 38 0] back to [1 38 0] costs 2600 with 12 reconfigurations, as in the paper."""
    answer = solve_planar(second_rotation((1, 38, 0)))
    assert (answer.cost_deg, answer.reconfigurations) == (2600.0, 12)


@pytest.mark.parametrize('ratio', [1.35, 1.4, 1.45])
def test_without_adhesion_there_is_no_path_for_the_papers_ellipse(ratio):
    """At friction 0.3 a few hundred states can be reached, and none of the six goals is there."""
    for goal in SIX_GOALS:
        answer = solve_planar(second_rotation(goal, ratio, adhesion=False, friction=0.3))
        assert answer.outcome is Outcome.NO_PATH
        assert answer.path == ()
        assert answer.cost_deg is None
        assert 100 <= answer.expanded < 1000


@pytest.mark.parametrize('goal', [(57, 20, 0, 19), (20, 57, 0, 12)])
@pytest.mark.parametrize(
    ('ratio', 'outcome'), [(1.3, Outcome.FOUND), (1.35, Outcome.NO_PATH), (1.4, Outcome.NO_PATH)]
)
def test_without_adhesion_a_rounder_ellipse_rolls_on_to_its_flat_sides(goal, ratio, outcome):
    """At axis ratio 1.3 two fingers roll on from the tips; from 1.35 on they slip before."""
    problem = PlanarProblem(
        ellipse_of_ratio(ratio), CONTACTS, STEP_DEG, 19, start=(1, 38, 0, 1), goal=goal,
        law=ContactLaw(adhesion=False, friction=0.3),
    )  # fmt: skip
    assert solve_planar(problem).outcome is outcome


@pytest.mark.parametrize('goal', SIX_GOALS)
def test_a_path_reads_like_the_papers(goal):
    """Every node differs from the one before by one operation that the paper allows."""
    problem = second_rotation(goal)
    answer = solve_planar(problem)
    shape = Ellipse(*problem.ellipse_um, 4.5)
    phases = np.arange(CONTACTS) * shape.turn_rad / CONTACTS
    contact_um, normal, centre_um = shape.at(phases)
    assert answer.path[0] == problem.start
    assert answer.path[-1] == problem.goal
    cost_deg, reconfigurations = 0.0, 0
    for before, after in itertools.pairwise(answer.path):
        used = {i for i, number in enumerate(before[:3]) if number}
        uses = {i for i, number in enumerate(after[:3]) if number}
        for one, other in itertools.combinations(uses, 2):
            apart_um = np.linalg.norm(centre_um[after[one] - 1] - centre_um[after[other] - 1])
            assert apart_um >= 9.0 - 1e-6
        step = after[3] - before[3]
        if step:
            assert abs(step) == 1
            assert used == uses
            assert all((before[i] - step - 1) % CONTACTS + 1 == after[i] for i in uses)
            cost_deg += len(uses) * STEP_DEG
            continue
        assert all(before[i] == after[i] for i in used & uses)
        assert len(used ^ uses) == 1
        if gone := used - uses:
            stay = [after[i] - 1 for i in uses]
            leave = before[gone.pop()] - 1
            assert removal_window_lp(
                contact_um[stay], normal[stay], contact_um[leave], normal[leave], problem.law
            )
        cost_deg += 180.0
        reconfigurations += 1
    assert (cost_deg, reconfigurations) == (answer.cost_deg, answer.reconfigurations)


def test_orientations_do_not_wrap():
    """From l = 19 the object cannot turn on to l = 1: the way back is 18 steps of rolling."""
    ellipse_um = ellipse_of_ratio(1.0)
    problem = PlanarProblem(
        ellipse_um, CONTACTS, STEP_DEG, 19, start=(1, 38, 0, 19), goal=(19, 56, 0, 1)
    )
    answer = solve_planar(problem)
    assert (answer.cost_deg, answer.reconfigurations) == (2 * 18 * STEP_DEG, 0)
    assert [node[3] for node in answer.path] == list(range(19, 0, -1))


def test_start_that_is_the_goal_costs_nothing():
    """No operation is needed: the path is the one node."""
    answer = solve_planar(second_rotation((1, 38, 0), orientation=1))
    assert (answer.cost_deg, answer.reconfigurations) == (0.0, 0)
    assert answer.path == ((1, 38, 0, 1),)


@pytest.mark.parametrize('end', ['start', 'goal'])
def test_ends_with_tips_that_overlap_have_no_path(end):
    """Neighbouring contacts are nearer than a tip is thick: no grasp, so no path."""
    ends = {'start': (1, 9, 0, 1), 'goal': (9, 1, 0, 3), end: (1, 2, 0, 3)}
    answer = solve_planar(PlanarProblem((10.0, 8.0), 16, STEP_DEG, 4, **ends))
    assert answer.outcome is Outcome.NO_PATH


def test_equal_problems_have_equal_answers():
    """The answer is the same each time, path and effort included."""
    problem = second_rotation((0, 1, 38))
    assert solve_planar(problem) == solve_planar(problem)


def test_clearance_between_tips_is_kept():
    """With a clearance no two fingers of a path come nearer than that."""
    shape = Ellipse(*ellipse_of_ratio(1.4), 4.5)
    _, _, centre_um = shape.at(np.arange(CONTACTS) * shape.turn_rad / CONTACTS)

    def nearest_um(clearance_um):
        problem = PlanarProblem(
            ellipse_of_ratio(1.4), CONTACTS, STEP_DEG, 19, (1, 38, 0, 1), (38, 1, 0, 12),
            finger=Finger(clearance_um=clearance_um),
        )  # fmt: skip
        path = solve_planar(problem).path
        return min(
            np.linalg.norm(centre_um[one - 1] - centre_um[other - 1])
            for node in path
            for one, other in itertools.combinations([n for n in node[:3] if n], 2)
        )

    assert nearest_um(0.0) < 12.0 <= nearest_um(3.0)
