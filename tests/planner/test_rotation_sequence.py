# SPDX-License-Identifier: Apache-2.0
"""Rotations in sequence: the cheapest as a whole, with fingers that carry on in the next."""

import itertools
import math
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.decomposition import PlanarRotation, decompositions
from microhand_planner.core.errors import NoPlanExists
from microhand_planner.core.interruption import uninterrupted
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import ContactLaw, Finger, Mode, SearchOptions
from microhand_planner.core.planned_rotation import Problem
from microhand_planner.core.rotation_sequence import cheapest_sequence
from microhand_planner.core.search_state import ABSENT, NDEG
from microhand_planner.core.section import XY_PLANE, XZ_PLANE
from microhand_planner.core.start_grasp import StartGrasp
from tests.planner.oracles import Ellipse
from tests.planner.paper_graph import NO_FINGER, PaperGraph, robust_lattice

PAPER_ELLIPSOID_UM = (16.22, 11.586, 11.586)
PAPER = SearchOptions(math.radians(20.0), Mode.PAPER)
SMALL_UM, SMALL_TIP_UM = (5.0, 3.4, 4.2), 4.5
SMALL_STEP = SearchOptions(math.radians(85.0))


def curves_of(semi_axes_um, tip_um):
    """Return the curves of a tip around both sections of an ellipsoid."""
    a, b, c = semi_axes_um
    return {
        'z': offset_curve(ellipse_section(a, b, XY_PLANE), tip_um),
        'y': offset_curve(ellipse_section(a, c, XZ_PLANE), tip_um),
    }


def problem_of(options, law=None, finger=None):
    """Return what the searches share, with nobody to interrupt them."""
    interrupt = uninterrupted()
    return Problem(finger or Finger(), law or ContactLaw(), options, time.monotonic, interrupt)


def rotations(*named_deg):
    """Return planar rotations from pairs of axis and angle [deg]."""
    return tuple(PlanarRotation(axis, math.radians(angle)) for axis, angle in named_deg)


def total_deg(sequence):
    """Return what a sequence costs [deg]."""
    return sum(planned.cost_ndeg for planned in sequence) / NDEG


def phases_of(planned, state):
    """Return the contact phases of fingers 1, 2, 3 in a state, NaN if free."""
    *tracks, at = planned.states[state].tolist()
    lattice = planned.lattice
    return np.array(
        [math.nan if t == ABSENT else lattice.phase_rad[lattice.sample_of[t, at]] for t in tracks]
    )


PAPERS_TRIPLE = rotations(('z', 80.0), ('y', 220.0), ('z', 100.0))


def test_the_papers_rotation_needs_eight_reconfigurations_in_the_middle():
    """Table 4, ellipsoid with adhesion: 0, 8 and 0 reconfigurations."""
    curves = curves_of(PAPER_ELLIPSOID_UM, 4.5)
    sequence = cheapest_sequence([PAPERS_TRIPLE], curves, problem_of(PAPER))
    assert [planned.reconfigurations for planned in sequence] == [0, 8, 0]
    assert [planned.cost_ndeg / NDEG for planned in sequence] == [160.0, 1880.0, 200.0]


def test_the_papers_rotation_is_impossible_without_adhesion():
    """Table 4, ellipsoid without adhesion: no path; the error says what was tried."""
    curves = curves_of(PAPER_ELLIPSOID_UM, 4.5)
    law = ContactLaw(friction=0.3, adhesion=False)
    with pytest.raises(NoPlanExists, match='220 deg about y') as caught:
        cheapest_sequence([PAPERS_TRIPLE], curves, problem_of(PAPER, law))
    assert caught.value.expanded > 100


@pytest.mark.parametrize('seed', [0, 4, 8, 11])
def test_the_whole_is_as_cheap_as_the_cheapest_decomposition_alone(seed):
    """Planned together or one by one, the best of all decompositions is the same.

    Here it is not the gentlest one, so that bounds which cut off too much would show.
    """
    curves = curves_of((25.0, 14.0, 10.0), 4.5)
    problem = problem_of(SearchOptions(), ContactLaw(friction=0.4))
    choices = decompositions(Rotation.random(random_state=seed))
    together = total_deg(cheapest_sequence(choices, curves, problem))
    alone = []
    for choice in choices:
        try:
            alone.append(total_deg(cheapest_sequence([choice], curves, problem)))
        except NoPlanExists:
            alone.append(math.inf)
    assert len(choices) == 16
    assert together == min(alone)
    assert min(alone) < alone[0], 'the first is the best: nothing is shown'


def small_graph(axis, angle_deg, begins_on_joints, ends_on_joints, law):
    """Return the oracle's graph of a small rotation, with its nodes at both ends.

    On the joints, the six nodes are in the order of `itertools.permutations`.
    """
    shape = Ellipse(SMALL_UM[0], SMALL_UM['zy'.index(axis) + 1], SMALL_TIP_UM)
    joints = (0.0, shape.turn_rad / 2)
    lattice = robust_lattice(
        shape.turn_rad,
        SMALL_STEP.step_rad,
        math.radians(angle_deg),
        joints if begins_on_joints else (),
        joints if ends_on_joints else (),
    )
    graph = PaperGraph(shape, lattice, law, 2 * SMALL_TIP_UM)
    ends = []
    for on_joints, theta_deg in ((begins_on_joints, 0.0), (ends_on_joints, angle_deg)):
        at = int(np.argmin(np.abs(lattice.theta_deg - theta_deg)))
        if on_joints:
            grasp = [*(lattice.contact_at(phase, shape.turn_rad) for phase in joints), NO_FINGER]
            ends.append([(*named, at) for named in itertools.permutations(grasp)])
        else:
            nodes = graph.grasps_of_two(at)
            ends.append(
                [(*named, at) for node in nodes for named in itertools.permutations(node[:3])]
            )
    return graph, *ends


@pytest.mark.parametrize(
    'parts',
    [
        (('z', 140.0), ('y', -205.0), ('z', 75.0)),
        (('z', -33.0), ('y', 160.0), ('z', 250.0)),
        (('y', 133.0), ('z', 310.0)),
    ],
)
def test_fingers_at_the_joints_are_chosen_for_the_whole(parts):
    """No choice of the permutations at the joints is cheaper, over all of them by brute force."""
    law = ContactLaw(friction=0.5)
    curves = curves_of(SMALL_UM, SMALL_TIP_UM)
    sequence = cheapest_sequence([rotations(*parts)], curves, problem_of(SMALL_STEP, law))
    best = {None: 0.0}  # by the permutation with which the next rotation begins
    for index, (axis, angle_deg) in enumerate(parts):
        last = index == len(parts) - 1
        graph, starts, goals = small_graph(axis, angle_deg, index > 0, not last, law)
        after = {}
        for permutation, spent in best.items():
            start = starts if permutation is None else [starts[permutation]]
            for goal, cost in graph.reached(start, goals):
                name = None if last else goals.index(goal)
                after[name] = min(after.get(name, math.inf), spent + cost)
                if last:
                    break
        best = after
    assert total_deg(sequence) == pytest.approx(best[None], abs=1e-6)


@pytest.mark.parametrize('seed', [4, 5, 6, 7])
def test_fingers_carry_on_from_one_rotation_to_the_next(seed):
    """At each joint the same finger stays on I, the same on J, and the same one is free."""
    curves = curves_of((18.0, 11.0, 13.0), 4.5)
    choices = [c for c in decompositions(Rotation.random(random_state=seed)) if len(c) == 3]
    sequence = cheapest_sequence(choices, curves, problem_of(SearchOptions()))
    for before, after in itertools.pairwise(sequence):
        assert math.degrees(before.lattice.theta_rad[before.states[-1, 3]]) == pytest.approx(
            math.degrees(before.part.angle_rad)
        )
        turns = [curves[planned.part.axis].length_rad for planned in (before, after)]
        ends = phases_of(before, -1) / turns[0], phases_of(after, 0) / turns[1]
        assert np.array_equal(np.isnan(ends[0]), np.isnan(ends[1]))
        assert np.count_nonzero(np.isfinite(ends[0])) == 2
        # on an ellipsoid joint J is half a turn from joint I in both sections
        assert np.nan_to_num(ends[0]) == pytest.approx(np.nan_to_num(ends[1]), abs=1e-9)
        assert sorted(end for end in ends[0] if end >= 0) == pytest.approx([0.0, 0.5])


@pytest.mark.parametrize('fingers', [(0, 1), (2, 0), (1, 2)])
@pytest.mark.parametrize('axis', ['z', 'y'])
def test_a_given_start_is_where_the_sequence_begins(fingers, axis):
    """The fingers that hold the object stay on their contacts; a free start costs no more."""
    curves = curves_of((18.0, 11.0, 13.0), 4.5)
    problem = problem_of(SearchOptions())
    half = curves[axis].length_rad / 2
    start = StartGrasp(axis, fingers, (1.234, 1.234 + half))
    choices = decompositions(Rotation.random(random_state=8))
    sequence = cheapest_sequence(choices, curves, problem, start)
    first = sequence[0]
    assert first.part.axis == axis
    phases = phases_of(first, 0)
    assert phases[list(fingers)] == pytest.approx(start.phase_rad, abs=1e-8)
    assert np.isnan(phases[3 - sum(fingers)])
    assert total_deg(sequence) >= total_deg(cheapest_sequence(choices, curves, problem))


def test_a_given_start_costs_what_dijkstra_says():
    """With the start grasp fixed off the lattice, the cost of one rotation is the oracle's."""
    law = ContactLaw(friction=0.5)
    shape = Ellipse(SMALL_UM[0], SMALL_UM[1], SMALL_TIP_UM)
    held = (0.7, 0.7 + 0.4 * shape.turn_rad)
    for angle_deg in (140.0, -250.0, 330.0):
        sequence = cheapest_sequence(
            [rotations(('z', angle_deg))],
            curves_of(SMALL_UM, SMALL_TIP_UM),
            problem_of(SMALL_STEP, law),
            StartGrasp('z', (0, 1), held),
        )
        lattice = robust_lattice(
            shape.turn_rad, SMALL_STEP.step_rad, math.radians(angle_deg), held, ()
        )
        graph = PaperGraph(shape, lattice, law, 2 * SMALL_TIP_UM)
        here, there = (
            int(np.argmin(np.abs(lattice.theta_deg - theta))) for theta in (0.0, angle_deg)
        )
        start = (*(lattice.contact_at(phase, shape.turn_rad) for phase in held), NO_FINGER, here)
        expected = graph.cheapest([start], graph.grasps_of_two(there), named=False)
        assert total_deg(sequence) == pytest.approx(expected, abs=1e-6)


def test_effort_of_failed_searches_is_reported():
    """The states expanded in vain, in all decompositions, are in the error."""
    curves = curves_of(PAPER_ELLIPSOID_UM, 4.5)
    problem = problem_of(PAPER, ContactLaw(friction=0.3, adhesion=False))
    other = rotations(('z', 80.0), ('y', -140.0), ('z', 100.0))
    expanded = []
    for choices in ([PAPERS_TRIPLE], [other], [PAPERS_TRIPLE, other]):
        with pytest.raises(NoPlanExists) as caught:
            cheapest_sequence(choices, curves, problem)
        expanded.append(caught.value.expanded)
    assert expanded[2] > max(expanded[:2])
