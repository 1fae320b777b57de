# SPDX-License-Identifier: Apache-2.0
"""Whole plans: they reach the goal, are the same each time, or say why there is none."""

import itertools
import json
import math
import subprocess
import sys
import threading
from types import MappingProxyType

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.catalogue import find_part
from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.errors import (
    Cancelled,
    InadmissibleContact,
    InvalidParameter,
    InvalidRotation,
    NoPlanExists,
    TimeLimitReached,
)
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import ContactLaw, Finger, Mode, SearchOptions
from microhand_planner.core.plan import StepKind
from microhand_planner.core.plan_check import check_plan
from microhand_planner.core.plan_file import plan_hash
from microhand_planner.core.planner import goal_error_deg, plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.section import XY_PLANE, XZ_PLANE
from microhand_planner.core.section_curves import SectionCurves, section_curves
from tests.planner.solids import ellipsoid

AXES_UM = (16.22, 11.586, 11.586)
PAPERS_TURN = Rotation.from_euler('ZYZ', [80.0, 220.0, 100.0], degrees=True)


def analytic(semi_axes_um, finger=None):
    """Return an ellipsoid with the exact curves of its sections."""
    a, b, c = semi_axes_um
    finger = finger or Finger()
    curves = {
        'z': offset_curve(ellipse_section(a, b, XY_PLANE), finger.radius_um),
        'y': offset_curve(ellipse_section(a, c, XZ_PLANE), finger.radius_um),
    }
    return SectionCurves(ellipsoid(semi_axes_um, 3), finger, MappingProxyType(curves))


@pytest.fixture(scope='module')
def geometry():
    """Return the paper's ellipsoid."""
    return analytic(AXES_UM)


def plan_for(geometry, goal, start=None, law=None, options=None, **more):
    """Plan with default fingers, and with defaults for the rest."""
    return plan_reorientation(
        geometry,
        start or Pose(),
        goal,
        geometry.finger,
        law or ContactLaw(),
        options or SearchOptions(),
        **more,
    )


def turned_by(rotation):
    """Return a goal at the origin."""
    return Pose.of((0.0, 0.0, 0.0), rotation)


def rolled(plan):
    """Return the product of all rolls of a plan, from the angles of its steps."""
    product = np.eye(3)
    for step in plan.steps:
        axis = {'z': [0, 0, 1], 'y': [0, 1, 0]}[plan.rotations[step.rotation].axis]
        product = product @ Rotation.from_rotvec(step.angle_rad * np.array(axis)).as_matrix()
    return Rotation.from_matrix(product)


quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.05)
positions = st.tuples(*[st.floats(-80.0, 80.0)] * 3)


@settings(derandomize=True, max_examples=25, deadline=None)
@given(positions, quaternions, positions, quaternions)
def test_any_goal_is_reached_to_a_millionth_of_a_degree(geometry, at, facing, to, turned):
    """The last waypoint and the product of all rolls are the goal; the position is met exactly."""
    start, goal = Pose(at, facing), Pose(to, turned)
    plan = plan_for(geometry, goal, start)
    assert goal_error_deg(plan) < 1e-6
    assert plan.reached.position_um == pytest.approx(goal.position_um, abs=1e-6)
    by_rolls = start.rotation * rolled(plan)
    assert np.degrees((by_rolls.inv() * goal.rotation).magnitude()) < 1e-6
    assert plan.steps[0].object_position_um[0] == pytest.approx(start.position_um, abs=1e-6)
    check_plan(plan)


@settings(derandomize=True, max_examples=15, deadline=None)
@given(
    st.tuples(*[st.sampled_from([0.0, 90.0, 180.0, 270.0])] * 3),
    st.sampled_from([0.0, 1e-9, 1e-6, 1e-3]),
)
def test_special_goals_are_reached_as_exactly(geometry, angles_deg, offset_deg):
    """Quarter and half turns, and what lies just beside them, lose no accuracy."""
    turn = Rotation.from_euler('ZYZ', np.add(angles_deg, [0.0, offset_deg, 0.0]), degrees=True)
    plan = plan_for(geometry, turned_by(turn))
    assert goal_error_deg(plan) < 1e-6
    assert np.degrees((rolled(plan).inv() * turn).magnitude()) < 1e-6


@pytest.mark.parametrize('adhesion', [True, False])
def test_costs_are_those_of_the_steps(adhesion):
    """What the rotations report is what the steps do: fingers times angle, and 180 per change."""
    law = ContactLaw(friction=0.5, adhesion=adhesion)
    plan = plan_for(analytic((15.0, 13.5, 14.0)), turned_by(PAPERS_TURN), law=law)
    cost_deg = [0.0] * len(plan.rotations)
    changes = [0] * len(plan.rotations)
    for step in plan.steps:
        cost_deg[step.rotation] += sum(step.in_contact) * math.degrees(abs(step.angle_rad))
        changes[step.rotation] += step.kind in (StepKind.PLACE, StepKind.REMOVE)
    for report, cost, count in zip(plan.rotations, cost_deg, changes, strict=True):
        assert report.cost_deg == pytest.approx(cost + 180.0 * count, abs=1e-6)
        assert report.reconfigurations == count
    assert plan.cost_deg == pytest.approx(sum(cost_deg) + 180.0 * sum(changes))
    assert plan.reconfigurations == sum(changes) > 0


def test_no_rotation_at_all_is_a_grasp(geometry):
    """A goal that is the start needs the first grasp, closed, and nothing else."""
    pose = Pose((1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5))
    plan = plan_for(geometry, pose, pose)
    assert [step.kind for step in plan.steps] == [StepKind.APPROACH, StepKind.GRIP]
    assert (plan.cost_deg, plan.reconfigurations) == (0.0, 0)
    assert plan.reached == pose


def test_translation_alone_is_a_grasp_and_a_carry(geometry):
    """Fingers take hold and translate together; the free one goes with them."""
    plan = plan_for(geometry, Pose((30.0, 0.0, -40.0)))
    *closing, carry = plan.steps
    assert [step.kind for step in closing] == [StepKind.APPROACH, StepKind.GRIP]
    assert carry.kind is StepKind.TRANSLATE
    carried = np.diff(carry.tip_um, axis=0)
    moved = np.diff(carry.object_position_um, axis=0)
    assert carried == pytest.approx(np.repeat(moved[:, None], 3, axis=1), abs=2e-6)
    assert carry.tip_um[-1] - carry.tip_um[0] == pytest.approx(
        np.tile([30.0, 0.0, -40.0], (3, 1)), abs=1e-5
    )
    assert np.all(carry.force_uN == closing[-1].force_uN[-1])


@pytest.mark.parametrize('angle_deg', [-170.0, 33.3, 180.0])
def test_rotation_about_z_alone_is_one_planar_rotation(geometry, angle_deg):
    """With theta2 = 0 one rotation, with whatever grasp rolls that far, is the cheapest."""
    plan = plan_for(geometry, turned_by(Rotation.from_rotvec([0, 0, math.radians(angle_deg)])))
    assert [report.axis for report in plan.rotations] == ['z']
    assert plan.cost_deg == pytest.approx(2 * abs(angle_deg))
    kinds = [step.kind for step in plan.steps]
    assert kinds == [StepKind.APPROACH, StepKind.GRIP, StepKind.ROLL]


def test_the_papers_rotation_in_paper_mode(geometry):
    """Table 4, ellipsoid at friction 0.3: 0, 8, 0 reconfigurations; without adhesion no plan."""
    triple = [('z', 80.0), ('y', 220.0), ('z', 100.0)]
    parts = [PlanarRotation(axis, math.radians(angle)) for axis, angle in triple]
    options = SearchOptions(mode=Mode.PAPER)
    goal = turned_by(PAPERS_TURN)
    plan = plan_for(geometry, goal, options=options, decomposition=parts)
    assert [report.reconfigurations for report in plan.rotations] == [0, 8, 0]
    assert [report.angle_deg for report in plan.rotations] == pytest.approx([80.0, 220.0, 100.0])
    law = ContactLaw(adhesion=False)
    with pytest.raises(NoPlanExists, match='no plan exists: the search was exhaustive') as caught:
        plan_for(geometry, goal, law=law, options=options, decomposition=parts)
    assert caught.value.expanded > 0
    assert caught.value.exit_status == 3


def test_choosing_the_decomposition_is_never_dearer(geometry):
    """The planner's own choice costs no more than the paper's triple."""
    triple = [('z', 80.0), ('y', 220.0), ('z', 100.0)]
    parts = [PlanarRotation(axis, math.radians(angle)) for axis, angle in triple]
    goal = turned_by(PAPERS_TURN)
    chosen = plan_for(geometry, goal)
    given_one = plan_for(geometry, goal, decomposition=parts)
    assert chosen.cost_deg < given_one.cost_deg
    assert goal_error_deg(given_one) < 1e-6


def test_decomposition_of_another_rotation_is_refused(geometry):
    """Rotations that do not make up the goal are a bad request, not a plan to elsewhere."""
    with pytest.raises(InvalidRotation, match='decomposition'):
        plan_for(geometry, turned_by(PAPERS_TURN), decomposition=[PlanarRotation('z', 1.0)])


def test_angles_off_the_lattice_are_refused_in_paper_mode(geometry):
    """The paper reaches multiples of the step only; the message says which mode reaches all."""
    with pytest.raises(InvalidParameter, match='robust mode takes any angle'):
        plan_for(
            geometry,
            turned_by(Rotation.from_rotvec([0, 0, 0.5])),
            options=SearchOptions(mode=Mode.PAPER),
        )


# ---------------------------------------------------------------- a grasp that is given


def held_tips(plan):
    """Return the tips at the end of a plan, NaN for the finger that is free."""
    tips = np.array(plan.steps[-1].tip_um[-1])
    tips[~np.array(plan.steps[-1].in_contact)] = np.nan
    return tips


@pytest.mark.parametrize('seed', range(5))
def test_plans_can_be_chained(geometry, seed):
    """A plan that begins with the grasp in which another ended carries on from there."""
    first = plan_for(geometry, turned_by(Rotation.random(random_state=seed)))
    goal = Pose.of((5.0, 5.0, 5.0), Rotation.random(random_state=100 + seed))
    second = plan_for(geometry, goal, first.reached, start_tip_um=held_tips(first))
    assert second.steps[0].kind is not StepKind.APPROACH
    held = np.isfinite(held_tips(first)[:, 0])
    assert np.array_equal(second.steps[0].in_contact, held)
    gap_um = second.steps[0].tip_um[0, held] - first.steps[-1].tip_um[-1, held]
    assert np.max(np.abs(gap_um)) < 1e-3
    assert goal_error_deg(second) < 1e-6


@pytest.mark.parametrize(
    ('tips', 'error', 'message'),
    [
        ([[20.72, 0, 0], [-20.72, 0, 0], [0, 16.086, 0]], InvalidParameter, 'start-tips'),
        ([[20.72, 0, 0], [math.nan] * 3, [math.nan] * 3], InvalidParameter, 'start-tips'),
        ([[20.72, 0, 0], [-20.72, 0, 0]], InvalidParameter, 'start-tips'),
        ([[21.0, 0, 0], [-20.72, 0, 0], [math.nan] * 3], InadmissibleContact, 'start-tips'),
        ([[0, 11, 11], [0, -11, -11], [math.nan] * 3], InadmissibleContact, 'start-tips'),
    ],
)
def test_start_grasp_that_is_none_is_refused(geometry, tips, error, message):
    """Three fingers, one, two rows, or tips off the surface or the planes: a clear error."""
    with pytest.raises(error, match=message):
        plan_for(geometry, turned_by(PAPERS_TURN), start_tip_um=np.array(tips, dtype=float))


def test_start_grasp_with_tips_that_overlap_has_no_plan(geometry):
    """Two tips that both touch the object but also each other cannot be a grasp."""
    centres = geometry.curves['z'].at(np.array([0.0, 0.5])).centre_um
    tips = np.vstack([XY_PLANE.to_object(centres), [[math.nan] * 3]])
    with pytest.raises((NoPlanExists, InadmissibleContact, InvalidParameter)):
        plan_for(geometry, turned_by(PAPERS_TURN), start_tip_um=tips)


# ---------------------------------------------------------------- the same each time


def test_equal_requests_have_equal_plans(geometry):
    """The same request gives the same plan, byte for byte but for the times."""
    goal = turned_by(Rotation.random(random_state=17))
    first, second = plan_for(geometry, goal), plan_for(geometry, goal)
    assert plan_hash(first) == plan_hash(second)
    for one, other in zip(first.steps, second.steps, strict=True):
        assert np.array_equal(one.tip_um, other.tip_um)


def test_q_and_minus_q_are_one_request(geometry):
    """Both quaternions of a rotation, and one four times as long, give one plan."""
    quaternion = np.array([0.3, -0.5, 0.1, 0.8])
    hashes = {plan_hash(plan_for(geometry, Pose((0, 0, 0), f * quaternion))) for f in (1, -1, 4)}
    assert len(hashes) == 1


FRESH = """
import json, sys
from scipy.spatial.transform import Rotation
from microhand_planner.core.catalogue import find_part
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.plan_file import plan_hash
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
hashes = []
for adhesion in (True, False):
    law = ContactLaw(friction=0.6, adhesion=adhesion)
    goal = Pose.of((1, 2, 3), Rotation.from_euler('ZYZ', [80, 220, 100], degrees=True))
    plan = plan_reorientation(
        find_part('ellipsoid'), Pose(), goal, Finger(), law, SearchOptions())
    hashes.append(plan_hash(plan))
print(json.dumps(hashes))
"""


def test_other_processes_make_the_same_plan():
    """Fresh processes with other hash seeds find the plans that this one finds, mesh and all."""
    found = []
    for seed in ('1', '2'):
        done = subprocess.run(
            [sys.executable, '-c', FRESH],
            env={'PYTHONHASHSEED': seed, 'PYTHONPATH': ':'.join(sys.path)},
            capture_output=True,
            text=True,
            timeout=100,
            check=True,
        )
        found.append(json.loads(done.stdout))
    here = [
        plan_hash(
            plan_for(
                section_curves(find_part('ellipsoid'), Finger()),
                Pose.of((1, 2, 3), PAPERS_TURN),
                law=ContactLaw(friction=0.6, adhesion=adhesion),
            )
        )
        for adhesion in (True, False)
    ]
    assert found == [here, here]


# ---------------------------------------------------------------- meshes


@pytest.mark.parametrize('turn', [PAPERS_TURN, Rotation.random(random_state=3)])
def test_facets_do_not_matter(geometry, turn):
    """A faceted ellipsoid and the analytic one have the same plan, to hundredths of a um."""
    exact = plan_for(geometry, turned_by(turn))
    faceted = plan_for(section_curves(ellipsoid(AXES_UM, 5), Finger()), turned_by(turn))
    assert [report.cost_deg for report in faceted.rotations] == pytest.approx(
        [report.cost_deg for report in exact.rotations], abs=1e-3
    )
    for one, other in zip(exact.steps, faceted.steps, strict=True):
        assert (one.kind, one.finger, one.in_contact) == (
            other.kind,
            other.finger,
            other.in_contact,
        )
        held = np.array(one.in_contact)
        assert other.tip_um[-1, held] == pytest.approx(one.tip_um[-1, held], abs=0.03)


@pytest.mark.parametrize('name', ['convex', 'concave'])
@pytest.mark.parametrize('adhesion', [True, False])
def test_plans_for_other_shapes_keep_off_the_mesh(name, adhesion):
    """Contacts stand a tip's radius off the mesh, and free fingers nowhere less.

    The judge is the nearest of 400 000 random points on the mesh: never too near, and wrong by
    less than 0.05 um for a tip that touches.
    """
    part = find_part(name)
    geometry = section_curves(part, Finger())
    plan = plan_for(
        geometry,
        Pose.of((10.0, 0.0, 0.0), PAPERS_TURN),
        Pose((0.0, 0.0, 5.0)),
        ContactLaw(friction=0.5, adhesion=adhesion),
    )
    mesh = trimesh.Trimesh(part.vertices_um, part.faces, process=False)
    surface = KDTree(trimesh.sample.sample_surface(mesh, 400_000, seed=1)[0])
    for step in plan.steps:
        rotations = Rotation.from_quat(step.object_quaternion_wxyz[:, [1, 2, 3, 0]])
        relative = step.tip_um - step.object_position_um[:, None]
        tips = np.einsum('nij,nfj->nfi', rotations.inv().as_matrix(), relative)
        distance_um = surface.query(tips)[0]
        assert np.min(distance_um) > 4.5 - 0.05
        assert np.all(np.abs(distance_um[:, np.array(step.in_contact)] - 4.5) < 0.1)
    for before, after in itertools.pairwise(plan.steps):
        assert after.tip_um[0] == pytest.approx(before.tip_um[-1], abs=1e-3)
    assert goal_error_deg(plan) < 1e-6


# ---------------------------------------------------------------- ended from outside


@pytest.fixture(scope='module')
def dear():
    """Return a request that takes minutes: a slippery, long object with a fine step."""
    long_one = analytic((30.0, 12.0, 12.0))
    plan_for(long_one, turned_by(Rotation.identity()))  # the compiler has done its work before
    law = ContactLaw(friction=0.1)
    return lambda options, **more: plan_for(
        long_one, turned_by(PAPERS_TURN), law=law, options=options, **more
    )


class ClockOfSearches:
    """Stands until the planner begins its second search, then it is far beyond any limit.

    The planner reads it when it begins, and before and after each search.
    """

    def __init__(self):
        self._planner = threading.get_ident()
        self._readings = 0

    @property
    def second_search(self):
        """Whether the first search is over."""
        return self._readings >= 4

    def __call__(self):
        """Return the time [s]."""
        if threading.get_ident() == self._planner:
            self._readings += 1
        return 1e6 if self.second_search else 0.0


def test_cancelled_plan(dear):
    """Cancelling is not 'no plan exists', and tells how far the search was."""
    clock = ClockOfSearches()
    with pytest.raises(Cancelled, match='cancelled') as caught:
        dear(SearchOptions(math.radians(0.5)), clock=clock, cancelled=lambda: clock.second_search)
    assert caught.value.expanded > 0


def test_time_limit_of_a_plan(dear):
    """Running out of time is not 'no plan exists', and tells how far the search was."""
    clock = ClockOfSearches()
    with pytest.raises(TimeLimitReached, match='time limit of 100 s') as caught:
        dear(SearchOptions(math.radians(0.5), time_limit_s=100.0), clock=clock)
    assert caught.value.expanded > 0
