# SPDX-License-Identifier: Apache-2.0
"""The planar searches are optimal: as cheap as Dijkstra on the paper's whole graph, never cheaper.

The problems are small and random. Their oracle has all grasps of two and three fingers, rolls
with both, and looks at removals by another formula; see `oracles`.
"""

import itertools
import math
import time

import numpy as np
import pytest

from microhand_planner.core import (
    graph_search,
    planar,
    starting_grasps,
    swap_search,
    swap_steps,
)
from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.interruption import uninterrupted
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, Mode, SearchOptions
from microhand_planner.core.planar import solve_planar
from microhand_planner.core.planar_problem import PlanarProblem
from microhand_planner.core.planned_rotation import Problem, plan_planar_rotation
from microhand_planner.core.search_result import Outcome
from microhand_planner.core.search_state import ABSENT, NDEG
from microhand_planner.core.section import XY_PLANE
from tests.planner.oracles import Ellipse, presses_lp, removal_window_lp
from tests.planner.paper_graph import NO_FINGER, PaperGraph, paper_lattice, robust_lattice

PAPER_AXES_UM = (16.22, 11.586)  # 74 contacts of 20 deg for a tip of 4.5 um


# ---------------------------------------------------------------- optimality, paper mode


def random_planar_problem(rng, *, adhesion):
    """Return a small problem on the paper's lattice; most starts and goals are stable."""
    tip_um = rng.uniform(2.0, 5.0)
    axes_um = rng.uniform(1.0 if adhesion else 2.0, 4.0, 2) * tip_um
    contacts = int(rng.integers(10, 17))
    orientations = int(rng.integers(4, 9))
    law = ContactLaw(
        friction=rng.uniform(0.1, 0.9) if adhesion else rng.uniform(0.5, 1.3),
        pull_off_uN=rng.uniform(0.5, 3.0),
        max_force_uN=rng.uniform(2.0, 30.0),
        adhesion=adhesion,
    )
    finger = Finger(radius_um=tip_um, clearance_um=float(rng.choice([0.0, 0.5])))
    shape = Ellipse(*axes_um, tip_um)
    graph = PaperGraph(
        shape, paper_lattice(shape, contacts, 1.0, orientations), law, finger.min_distance_um
    )

    def node():
        while True:
            grasp = rng.choice(contacts, 2, replace=False)
            if graph.holds(tuple(grasp.tolist())) or rng.random() < 0.05:
                break
        numbers = rng.permutation([*(grasp + 1), 0]).tolist()
        return (*numbers, int(rng.integers(1, orientations + 1)))

    return PlanarProblem(
        ellipse_um=tuple(axes_um.tolist()),
        contacts=contacts,
        step_deg=float(rng.uniform(5.0, 60.0)),
        orientations=orientations,
        start=node(),
        goal=node(),
        finger=finger,
        law=law,
    )


def dijkstra_cost(problem):
    """Return the cost of a planar problem by the oracle [deg], or None."""
    shape = Ellipse(*problem.ellipse_um, problem.finger.radius_um)
    lattice = paper_lattice(shape, problem.contacts, problem.step_deg, problem.orientations)
    graph = PaperGraph(shape, lattice, problem.law, problem.finger.min_distance_um)
    start, goal = (tuple(number - 1 for number in node) for node in (problem.start, problem.goal))
    return graph.cheapest([start], [goal])


@pytest.mark.parametrize(('adhesion', 'count', 'seed'), [(True, 30, 101), (False, 25, 202)])
def test_paper_mode_costs_what_dijkstra_on_the_whole_graph_costs(adhesion, count, seed):
    """Over random problems: equal costs, or both say that there is no path."""
    rng = np.random.default_rng(seed)
    solved = 0
    for _ in range(count):
        problem = random_planar_problem(rng, adhesion=adhesion)
        answer, expected = solve_planar(problem), dijkstra_cost(problem)
        assert (answer.outcome is Outcome.FOUND) == (expected is not None), problem
        if expected is not None:
            assert answer.cost_deg == pytest.approx(expected, abs=1e-6), problem
            solved += 1
    assert 0.3 * count < solved < count, 'the cases do not try both answers'


@pytest.mark.parametrize('reverse', [False, True])
@pytest.mark.parametrize('margins', [False, True])
def test_each_of_many_goals_costs_what_dijkstra_says(margins, reverse):
    """From one start to random goals at small steps, where what a detour costs decides.

    Searched forward from the start, and backward from the goals.
    """
    rng = np.random.default_rng(606)
    detours = 0
    for _ in range(4):
        shape = Ellipse(rng.uniform(9.0, 13.0), rng.uniform(5.0, 8.0), 4.5)
        law = ContactLaw(friction=rng.uniform(0.1, 0.5))
        rules = GripRules(least_margin_uN=0.01, grip_tolerance_uN=0.05) if margins else None
        contacts, orientations, step_deg = 14, 13, float(rng.uniform(4.0, 30.0))
        oracle = paper_lattice(shape, contacts, step_deg, orientations)
        graph = PaperGraph(shape, oracle, law, Finger().min_distance_um, rules)
        start = (0, contacts // 2, NO_FINGER, int(rng.integers(orientations)))
        goals = [
            (*rng.permutation([*pair, NO_FINGER]).tolist(), at)
            for at in range(orientations)
            for *pair, _, _ in graph.grasps_of_two(at)
            if rng.random() < 0.3
        ]
        expected = dict(graph.reached([start], goals))
        curve = offset_curve(ellipse_section(shape.a_um, shape.b_um, XY_PLANE), 4.5)
        for goal in goals:
            ends = [start, goal]
            tracks = [
                tuple(ABSENT if c == NO_FINGER else (c + at) % contacts for c in fingers)
                for *fingers, at in ends
            ]
            found = swap_search.swap_search(
                planar.paper_lattice(
                    curve, contacts, step_deg, orientations, *(end[3] + 1 for end in ends)
                ),
                Finger(), law, *(tracks[::-1] if reverse else tracks),
                interchangeable=False, reverse=reverse, rules=rules,
            )  # fmt: skip
            cost_deg = found.cost_ndeg / NDEG if found.outcome is Outcome.FOUND else None
            assert cost_deg == pytest.approx(expected.get(goal)), goal
        for goal, cost_deg in expected.items():
            extra_deg = (cost_deg - 2 * step_deg * abs(goal[3] - start[3])) % 360.0
            detours += 1e-3 < extra_deg < 360.0 - 1e-3
    assert detours >= 50, 'no goal needs a detour'


# ---------------------------------------------------------------- optimality, robust mode


def random_rotation(rng, *, adhesion):
    """Return a small rotation with exact phases: shape, finger, law, step, angle, both ends."""
    tip_um = rng.uniform(2.0, 5.0)
    shape = Ellipse(*(rng.uniform(0.7, 1.6, 2) * tip_um), tip_um)
    law = ContactLaw(
        friction=rng.uniform(0.2, 1.2) if adhesion else rng.uniform(0.4, 1.4),
        pull_off_uN=rng.uniform(0.5, 3.0),
        max_force_uN=rng.uniform(2.0, 30.0),
        adhesion=adhesion,
    )
    finger = Finger(radius_um=tip_um, clearance_um=float(rng.choice([0.0, 0.3])))
    step_rad = min(math.radians(90.0), shape.turn_rad / rng.uniform(8.0, 11.0))
    angle_rad = rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 2 * math.pi)
    ends = []
    for _ in range(2):
        first = rng.uniform(0.0, shape.turn_rad)
        second = first + shape.turn_rad * rng.uniform(0.3, 0.7)
        ends.append((first, second))
    which = rng.random()
    if which < 0.2:
        ends[0] = None
    elif which < 0.4:
        ends[1] = None
    elif which < 0.6:
        ends = [(0.0, shape.turn_rad / 2)] * 2
    return shape, finger, law, step_rad, angle_rad, ends


def random_rules(rng):
    """Return margins that some removals keep, and others do not."""
    return GripRules(
        margin_factor=rng.uniform(0.6, 1.0),
        least_margin_uN=rng.uniform(0.001, 0.2),
        grip_tolerance_uN=rng.uniform(0.01, 1.0),
    )


def search(shape, finger, law, options, angle_rad, ends, bound_ndeg=None, rules=None):
    """Return what the planner finds for one rotation: a `PlannedRotation` or None."""
    curve = offset_curve(ellipse_section(shape.a_um, shape.b_um, XY_PLANE), finger.radius_um)
    problem = Problem(finger, law, options, time.monotonic, uninterrupted(), rules)
    bound = {} if bound_ndeg is None else {'bound_ndeg': bound_ndeg}
    rotation = PlanarRotation('z', angle_rad)
    planned, _ = plan_planar_rotation(rotation, curve, problem, *ends, **bound)
    return planned


def dijkstra_cost_of_rotation(shape, finger, law, step_rad, angle_rad, ends, rules=None):
    """Return the cost of a rotation with exact phases by the oracle [deg], or None."""
    lattice = robust_lattice(
        shape.turn_rad, step_rad, angle_rad, *(() if end is None else end for end in ends)
    )
    graph = PaperGraph(shape, lattice, law, finger.min_distance_um, rules)
    nodes = []
    for end, theta_deg in zip(ends, (0.0, math.degrees(angle_rad)), strict=True):
        at = int(np.argmin(np.abs(lattice.theta_deg - theta_deg)))
        pairs = None
        if end is not None:
            pairs = [tuple(lattice.contact_at(phase, shape.turn_rad) for phase in end)]
        nodes.append(graph.grasps_of_two(at, pairs))
    return graph.cheapest(*nodes, named=False)


@pytest.mark.parametrize(
    ('adhesion', 'margins', 'count', 'seed'),
    [(True, False, 20, 303), (True, True, 20, 505), (False, False, 12, 404)],
)
def test_robust_mode_costs_what_dijkstra_on_the_whole_graph_costs(adhesion, margins, count, seed):
    """Over random rotations with ends off the lattice: equal costs, or both say 'no path'."""
    rng = np.random.default_rng(seed)
    solved = 0
    for _ in range(count):
        case = random_rotation(rng, adhesion=adhesion)
        shape, finger, law, step_rad, angle_rad, ends = case
        rules = random_rules(rng) if margins else None
        found = search(shape, finger, law, SearchOptions(step_rad), angle_rad, ends, rules=rules)
        expected = dijkstra_cost_of_rotation(*case, rules)
        assert (found is None) == (expected is None), case
        if expected is not None:
            assert found.cost_ndeg / NDEG == pytest.approx(expected, abs=1e-5), case
            solved += 1
    assert 0.3 * count < solved < count, 'the cases do not try both answers'


def test_backward_search_removes_the_finger_that_leaves():
    """With a free start and a narrow grasp as goal, regrasps are needed, and cost what they must.

    The planner searches backward in time there, where placements and removals change places.
    """
    rng = np.random.default_rng(505)
    regrasped = 0
    for _ in range(12):
        shape = Ellipse(rng.uniform(10.0, 13.0), rng.uniform(3.0, 5.0), 4.5)
        law = ContactLaw(friction=rng.uniform(1.0, 2.0), max_force_uN=rng.uniform(0.5, 5.0))
        angle_rad = rng.choice([-1.0, 1.0]) * rng.uniform(5.0, 2 * math.pi)
        gap = rng.uniform(2.1, 2.35)  # too narrow to roll around the pointed ends
        first = shape.turn_rad / 4 - gap / 2 + rng.uniform(-0.3, 0.3)
        case = (shape, Finger(), law, math.radians(90.0), angle_rad, [None, (first, first + gap)])
        found = search(*case[:3], SearchOptions(case[3]), *case[4:])
        expected = dijkstra_cost_of_rotation(*case)
        assert (found is None) == (expected is None), case
        if expected is not None:
            assert found.cost_ndeg / NDEG == pytest.approx(expected, abs=1e-5), case
            regrasped += found.reconfigurations > 0
            assert recheck(shape, law, Finger(), path_of(found)) == pytest.approx(expected)
    assert regrasped >= 3, 'the cases need no regrasp'


@pytest.mark.parametrize('angle_deg', [110.0, 160.0, 250.0])
@pytest.mark.parametrize(('axes_um', 'friction'), [((7.0, 5.0), 0.274), ((9.0, 6.0), 0.333)])
def test_free_ends_may_be_any_grasps(axes_um, friction, angle_deg):
    """The firmest grasp to begin with is not the one that rolls farthest: all count."""
    law = ContactLaw(friction=friction, adhesion=False)
    step_rad, angle_rad = math.radians(45.0), math.radians(angle_deg)
    case = (Ellipse(*axes_um, 4.5), Finger(), law, step_rad, angle_rad, [None, None])
    found = search(*case[:3], SearchOptions(step_rad), *case[4:])
    expected = dijkstra_cost_of_rotation(*case)
    assert (found and found.cost_ndeg / NDEG) == (expected and pytest.approx(expected, abs=1e-5))


@pytest.mark.parametrize('axes_um', [(7.0, 5.0), (9.0, 6.0), (12.0, 10.0)])
def test_a_grasp_that_slips_half_way_does_not_roll(axes_um):
    """Without adhesion a roll is refused if its ends hold but not the steepest point between.

    The friction is 97 % of what two opposite fingers need at the steepest point of the ellipse.
    """
    shape = Ellipse(*axes_um, 4.5)
    half = shape.turn_rad / 2
    phases = np.linspace(0.0, half / 2, 401)
    one, other = shape.at(phases), shape.at(phases + half)
    line = other[0] - one[0]
    cosine = -np.einsum('ij,ij->i', one[1], line) / np.linalg.norm(line, axis=1)
    steepest = int(np.argmin(cosine))
    needed = math.tan(math.acos(cosine[steepest]))
    angle_rad = math.radians(80.0)
    first = phases[steepest] + angle_rad / 2
    ends = [(first, first + half), None]
    costs = []
    for friction in (0.97 * needed, 1.03 * needed):
        law = ContactLaw(friction=friction, adhesion=False)
        case = (shape, Finger(), law, angle_rad, angle_rad, ends)
        found = search(*case[:3], SearchOptions(angle_rad), *case[4:])
        costs.append(found and found.cost_ndeg / NDEG)
        expected = dijkstra_cost_of_rotation(*case)
        assert costs[-1] == (expected and pytest.approx(expected, abs=1e-5))
    assert costs[0] is None or costs[0] > 160.0 + 300.0
    assert costs[1] == pytest.approx(160.0)


# ---------------------------------------------------------------- every edge of a path


def recheck(shape, law, finger, nodes, slip_rad=1e-6, overlap_um=1e-3):
    """Walk along a path with formulas of our own, and return what it costs [deg].

    `nodes`: rows of three contact phases [rad] (NaN: free) and the orientation [rad].
    """
    cost_deg = 0.0
    for before, after in itertools.pairwise(np.asarray(nodes)):
        was, now = np.isfinite(before[:3]), np.isfinite(after[:3])
        turn_rad = after[3] - before[3]
        if turn_rad != 0.0:
            assert np.array_equal(was, now), 'a finger comes or goes while the object turns'
            slip = after[:3][now] - before[:3][now] + turn_rad
            slip = np.abs((slip + shape.turn_rad / 2) % shape.turn_rad - shape.turn_rad / 2)
            assert np.max(slip) < slip_rad, 'a finger slips'
            along = np.linspace(0.0, turn_rad, 201)
            contact, normal, centre = shape.at(before[:3][now][None, :] - along[:, None])
            for one, other in itertools.combinations(range(now.sum()), 2):
                apart_um = np.linalg.norm(centre[:, one] - centre[:, other], axis=1)
                assert np.min(apart_um) >= finger.min_distance_um - overlap_um, 'tips overlap'
            if not law.adhesion:
                for row in (100, 200):
                    assert presses_lp(contact[row], normal[row], law.friction) > -1e-9
            cost_deg += now.sum() * abs(math.degrees(turn_rad))
            continue
        both = was & now
        assert np.array_equal(before[:3][both], after[:3][both]), 'a finger jumps'
        assert 1 == np.sum(was != now), 'more than one finger comes or goes'
        cost_deg += 180.0
        contact, normal, centre = shape.at(np.where(was, before[:3], after[:3]))
        placed = was | now
        for one, other in itertools.combinations(np.flatnonzero(placed), 2):
            apart_um = np.linalg.norm(centre[one] - centre[other])
            assert apart_um >= finger.min_distance_um - 1e-6, 'tips overlap'
        if not law.adhesion:
            for grasp in (was, now):
                assert presses_lp(contact[grasp], normal[grasp], law.friction) > 0.0
        elif now.sum() < was.sum():
            assert now.sum() == 2
            gone = int(np.flatnonzero(was & ~now)[0])
            window = removal_window_lp(contact[now], normal[now], contact[gone], normal[gone], law)
            assert window is not None, 'the grasp does not hold the pull of the one that leaves'
    return cost_deg


def path_of(planned):
    """Return a planned rotation as rows of phases and orientation, swaps taken apart."""
    lattice = planned.lattice
    nodes = []
    for *tracks, at in planned.states.tolist():
        phases = [
            math.nan if t == ABSENT else lattice.phase_rad[lattice.sample_of[t, at]]
            for t in tracks
        ]
        row = [*phases, lattice.theta_rad[at]]
        if nodes and np.sum(np.isfinite(nodes[-1][:3]) != np.isfinite(row[:3])) == 2:
            nodes.append(
                [a if math.isfinite(a) else b for a, b in zip(nodes[-1], row, strict=True)]
            )
        nodes.append(row)
    return nodes


@pytest.mark.parametrize('mode', list(Mode))
@pytest.mark.parametrize('step_deg', [20.0, 10.0])
@pytest.mark.parametrize('adhesion', [True, False])
def test_every_edge_of_a_path_stands_a_second_look(mode, step_deg, adhesion):
    """No slip, no overlap, every removal feasible by a linear program, and the cost adds up."""
    shape = Ellipse(*(PAPER_AXES_UM if adhesion else (15.2, 12.7)), 4.5)
    law = ContactLaw(friction=0.3 if adhesion else 0.5, adhesion=adhesion)
    joints = (0.0, shape.turn_rad / 2)
    options = SearchOptions(math.radians(step_deg), mode)
    slip_rad = math.radians(0.1 if mode is Mode.PAPER and not adhesion else 1e-3)
    for angle_deg, ends in (
        (220.0, [joints, joints]),
        (-140.0, [joints, joints]),
        (160.0, [None, joints]),
        (-300.0, [joints, None]),
        (340.0, [None, None]),
    ):
        found = search(shape, Finger(), law, options, math.radians(angle_deg), ends)
        cost_deg = recheck(shape, law, Finger(), path_of(found), slip_rad)
        assert cost_deg == pytest.approx(found.cost_ndeg / NDEG, abs=1e-6)
        first, last = path_of(found)[0], path_of(found)[-1]
        assert math.degrees(last[3] - first[3]) == pytest.approx(angle_deg)
        for end, node in zip(ends, (first, last), strict=True):
            if end is not None:
                phases = [phase % shape.turn_rad for phase in node[:3] if math.isfinite(phase)]
                assert sorted(phases) == pytest.approx(end, abs=1e-6)


@pytest.mark.parametrize('adhesion', [True, False])
def test_bound_is_sharp(adhesion):
    """What costs as much as the bound is not wanted; what costs a little less is found."""
    shape = Ellipse(15.2, 12.7, 4.5)
    law = ContactLaw(friction=0.5, adhesion=adhesion)
    joints = (0.0, shape.turn_rad / 2)
    case = (shape, Finger(), law, SearchOptions(), math.radians(-140.0), [joints, joints])
    cost_ndeg = search(*case).cost_ndeg
    assert search(*case, bound_ndeg=cost_ndeg) is None
    assert search(*case, bound_ndeg=cost_ndeg + 1).cost_ndeg == cost_ndeg


def test_cost_does_not_depend_on_the_step_here():
    """The 220 deg of Table 3 cost 1880 at steps of 20, 10 and 5 deg, as in the model."""
    shape = Ellipse(*PAPER_AXES_UM, 4.5)
    joints = (0.0, shape.turn_rad / 2)
    for step_deg in (20.0, 10.0, 5.0):
        options = SearchOptions(math.radians(step_deg))
        found = search(
            shape, Finger(), ContactLaw(), options, math.radians(220.0), [joints, joints]
        )
        assert found.cost_ndeg / NDEG == pytest.approx(1880.0, abs=1e-6)
        assert found.reconfigurations == 8


def test_all_requests_share_one_compiled_search():
    """Modes, steps, margins and free ends make no new types: compiling takes seconds each time."""
    shape = Ellipse(15.2, 12.7, 4.5)
    joints = (0.0, shape.turn_rad / 2)
    for adhesion, step_deg, rules in itertools.product(
        (True, False), (20.0, 10.0, 1.5), (None, GripRules())
    ):
        law = ContactLaw(friction=0.5, adhesion=adhesion)
        for ends in ([joints, joints], [None, joints], [None, None]):
            options = SearchOptions(math.radians(step_deg))
            search(shape, Finger(), law, options, math.radians(31.0), ends, rules=rules)
        solve_planar(
            PlanarProblem(PAPER_AXES_UM, 74, 20.0, 3, (1, 38, 0, 1), (1, 38, 0, 3), law=law)
        )
    for compiled in (swap_steps.run, graph_search.run, starting_grasps.next_block):
        assert len(compiled.signatures) == 1


def test_equal_rotations_have_equal_paths():
    """The same search gives the same states, and the same effort, each time."""
    shape = Ellipse(*PAPER_AXES_UM, 4.5)
    joints = (0.0, shape.turn_rad / 2)
    case = (shape, Finger(), ContactLaw(), SearchOptions(), math.radians(211.0), [joints, joints])
    first, second = search(*case), search(*case)
    assert np.array_equal(first.states, second.states)
    assert first.expanded == second.expanded
