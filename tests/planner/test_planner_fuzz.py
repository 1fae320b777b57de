# SPDX-License-Identifier: Apache-2.0
"""Bad input: the answer is a plan, 'no plan', or one line that names the field at fault."""

import math
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.errors import BadRequest, MicrohandError, NoPlan
from microhand_planner.core.force_check import check_forces
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, Mode, SearchOptions
from microhand_planner.core.plan_check import check_plan
from microhand_planner.core.planar import solve_planar
from microhand_planner.core.planar_problem import problem_from_dict
from microhand_planner.core.planner import goal_error_deg, plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.search_result import Outcome
from microhand_planner.core.section import XY_PLANE, XZ_PLANE
from microhand_planner.core.section_curves import SectionCurves
from tests.planner.solids import ellipsoid

WEIRD = [
    math.nan, math.inf, -math.inf, -1.0, -0.0, 0.0, 5e-324, -1e-300, 1e-9, 1e9, 1e300, -1e300,
    90.00001, 1e400,
]  # fmt: skip
weird = st.sampled_from(WEIRD)


def number(low, high):
    """Return mostly sensible numbers, and some that are not."""
    return st.floats(low, high) | st.floats(low, high) | weird


def spoken(error, fields):
    """Check what every error owes its reader, and return its text."""
    message = str(error)
    assert message
    assert '\n' not in message
    assert len(message) < 500
    if isinstance(error, BadRequest):
        assert error.exit_status == 2
        assert error.field in fields, message
        assert message.startswith(f'{error.field} is ')
        assert '; allowed: ' in message
    else:
        assert isinstance(error, NoPlan)
        assert error.exit_status == 3
    return message


# ---------------------------------------------------------------- settings


@settings(derandomize=True, max_examples=200, deadline=None)
@given(number(0.0, 2.0), number(0.0, 10.0), number(0.1, 50.0), st.booleans())
def test_contact_laws(friction, pull_off_uN, max_force_uN, adhesion):
    """A contact law is in its ranges, or the number at fault is named."""
    try:
        law = ContactLaw(friction, pull_off_uN, max_force_uN, adhesion)
    except BadRequest as error:
        spoken(error, {'friction', 'pull-off', 'max-force'})
    else:
        assert 0.0 <= law.friction <= 2.0
        assert 0.0 <= law.pull_off_uN < math.inf
        assert 0.0 < law.max_force_uN < math.inf


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.tuples(*[number(0.0, 1.0)] * 3, *[number(0.0, 100.0)] * 2))
def test_rules_of_grips(values):
    """Rules are in their ranges, or the number at fault is named."""
    try:
        rules = GripRules(*values)
    except BadRequest as error:
        spoken(error, {'margin', 'roll-margin', 'least-margin', 'grip', 'grip-tolerance'})
    else:
        assert 0.0 < rules.margin_factor <= 1.0
        assert 0.0 < rules.roll_factor <= 1.0
        assert all(0.0 < value < math.inf for value in vars(rules).values())


@settings(derandomize=True, max_examples=200, deadline=None)
@given(number(0.01, 100.0), number(0.0, 10.0), number(0.1, 90.0), st.none() | number(0.1, 10.0))
def test_fingers_and_search_options(radius_um, clearance_um, step_deg, time_limit_s):
    """Fingers and options are in their ranges, or the number at fault is named."""
    try:
        finger = Finger(radius_um, clearance_um)
        options = SearchOptions(math.radians(step_deg), time_limit_s=time_limit_s)
    except BadRequest as error:
        spoken(error, {'finger-radius', 'clearance', 'step-deg', 'time-limit'})
    else:
        assert finger.min_distance_um >= 2 * finger.radius_um > 0.0
        assert 0.0 < options.step_rad <= math.pi / 2 + 1e-12
        assert options.time_limit_s is None or 0.0 < options.time_limit_s < math.inf


@settings(derandomize=True, max_examples=300, deadline=None)
@given(
    st.lists(number(-1e5, 1e5), min_size=0, max_size=4),
    st.lists(number(-1.0, 1.0), min_size=0, max_size=5),
)
def test_poses(position_um, quaternion):
    """A pose has a unit quaternion and a finite position, or the one at fault is named."""
    try:
        pose = Pose(position_um, quaternion)
    except BadRequest as error:
        spoken(error, {'position', 'quaternion'})
    else:
        assert math.sqrt(sum(part**2 for part in pose.quaternion_wxyz)) == pytest.approx(1.0)
        assert pose.position_um == pytest.approx(position_um, abs=1e-6)


# ---------------------------------------------------------------- PROBLEM.json

GOOD = {
    'ellipse_um': [10.0, 8.0],
    'finger_radius_um': 4.5,
    'contacts': 16,
    'step_deg': 20,
    'orientations': 5,
    'friction': 0.3,
    'pull_off_uN': 1.5,
    'max_force_uN': 30,
    'adhesion': True,
    'start': [1, 9, 0, 1],
    'goal': [9, 1, 0, 4],
}
NAMED_OTHERWISE = {
    'finger_radius_um': {'finger-radius'},
    'friction': {'friction'},
    'pull_off_uN': {'pull-off'},
    'max_force_uN': {'max-force'},
    'ellipse_um': {'ellipse_um a', 'ellipse_um b'},
    'contacts': {'start', 'goal', 'contacts'},
    'orientations': {'start', 'goal', 'orientations'},
}
json_scalars = (
    st.none()
    | st.booleans()
    | st.integers(-3, 40)
    | weird
    | st.text(max_size=4)
    | st.just(10**400)
)
json_values = json_scalars | st.lists(json_scalars, max_size=5) | st.just({}) | st.just([[1], 2])


def answered(content):
    """Solve a problem if it is a small one."""
    problem = problem_from_dict(content)
    if problem.contacts > 100 or problem.orientations > 100:
        return None
    answer = solve_planar(problem)
    assert answer.outcome in (Outcome.FOUND, Outcome.NO_PATH)
    assert (answer.outcome is Outcome.FOUND) == bool(answer.path)
    return answer


@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.dictionaries(st.sampled_from(sorted(GOOD)), json_values, min_size=1, max_size=3))
def test_problems_with_wrong_values(changes):
    """Wrong types, shapes and numbers: an answer, or the key at fault with what is allowed."""
    try:
        answered({**GOOD, **changes})
    except BadRequest as error:
        allowed = set(changes).union(*(NAMED_OTHERWISE.get(key, ()) for key in changes))
        spoken(error, allowed)


@pytest.mark.parametrize('key', sorted(GOOD))
def test_problems_with_a_key_less(key):
    """A key that is missing is named, or has a default."""
    content = {name: value for name, value in GOOD.items() if name != key}
    if key in ('ellipse_um', 'contacts', 'step_deg', 'orientations', 'start', 'goal'):
        with pytest.raises(BadRequest, match=f'{key} is missing; allowed: .*{key}'):
            answered(content)
    else:
        answers = [solve_planar(problem_from_dict(c)) for c in (content, GOOD)]
        assert answers[0] == answers[1], 'the defaults are those of the good problem'


def test_problems_with_a_key_more():
    """A key that nobody knows, a slip of the pen, is named."""
    with pytest.raises(BadRequest, match=r'frictoin is unknown; allowed: .*friction'):
        problem_from_dict({**GOOD, 'frictoin': 0.5})


@pytest.mark.parametrize('content', [None, 3, 'x', [], [GOOD], True])
def test_problems_that_are_no_objects(content):
    """What is no JSON object is called by its type."""
    with pytest.raises(BadRequest, match=f'problem is {type(content).__name__}'):
        problem_from_dict(content)


@pytest.mark.parametrize(
    ('key', 'value', 'message'),
    [
        ('start', [1, 9, 0], r'start is \[1, 9, 0\]; allowed: 4'),
        ('start', [1, 9, 3, 1], 'two fingers'),
        ('start', [1, 0, 0, 1], 'two fingers'),
        ('start', [1, 17, 0, 1], 'contacts from 0 to 16'),
        ('start', [-1, 9, 4, 1], 'start is'),
        ('goal', [1, 9, 0, 6], 'orientation from 1 to 5'),
        ('goal', [1, 9, 0, 0], 'orientation from 1 to 5'),
        ('goal', [1.5, 9, 0, 1], 'whole numbers'),
        ('goal', [True, 9, 0, 1], 'goal is'),
        ('contacts', 3, 'contacts is 3.*; allowed: a number >= 4'),
        ('contacts', 15.5, 'contacts is 15.5; allowed: a whole number'),
        ('step_deg', 0, 'step_deg is 0.*; allowed: a number >= 0.1 and <= 90'),
        ('step_deg', 91, 'step_deg is 91.*; allowed'),
        ('friction', -0.1, 'friction is -0.1; allowed: a number >= 0 and <= 2'),
        ('pull_off_uN', -1, 'pull-off is -1.*; allowed: a number >= 0'),
        ('max_force_uN', 0, 'max-force is 0.*; allowed: a number > 0'),
        ('friction', math.nan, 'friction is nan; allowed'),
        ('friction', '0.3', 'friction is 0.3; allowed: a number'),
        ('ellipse_um', [10], 'ellipse_um is .*; allowed: 2 numbers'),
        ('ellipse_um', [0, 10], 'ellipse_um a is 0.*; allowed: a number'),
        ('adhesion', 1, 'adhesion is 1; allowed: true or false'),
    ],
)
def test_problems_in_words(key, value, message):
    """The commonest mistakes are answered with the field, its value, and what is allowed."""
    with pytest.raises(BadRequest, match=message):
        problem_from_dict({**GOOD, key: value})


# ---------------------------------------------------------------- whole plans

COARSE = ellipsoid((16.22, 11.586, 11.586), 3)
FIELDS = {
    'friction', 'pull-off', 'max-force', 'finger-radius', 'clearance', 'step-deg', 'position',
    'quaternion', 'angle', 'contact', 'start-tips', 'margin', 'roll-margin', 'least-margin',
    'grip', 'grip-tolerance',
}  # fmt: skip


def geometry_for(finger):
    """Return the paper's ellipsoid with the exact curves for a finger."""
    curves = {
        'z': offset_curve(ellipse_section(16.22, 11.586, XY_PLANE), finger.radius_um),
        'y': offset_curve(ellipse_section(16.22, 11.586, XZ_PLANE), finger.radius_um),
    }
    return SectionCurves(COARSE, finger, MappingProxyType(curves))


RANGES = {
    'radius_um': (1.0, 20.0), 'clearance_um': (0.0, 5.0), 'friction': (0.05, 1.5),
    'pull_off_uN': (0.1, 5.0), 'max_force_uN': (0.1, 50.0), 'step_deg': (12.0, 90.0),
    'margin': (0.3, 1.0), 'roll': (0.1, 1.0), 'least_uN': (1e-3, 0.3), 'grip_uN': (0.1, 20.0),
    'off_uN': (1e-3, 1.0),
    **{f'{end}_{axis}': (-100.0, 100.0) for end in ('from', 'to') for axis in 'xyz'},
    **{f'{end}_q{axis}': (-1.0, 1.0) for end in ('from', 'to') for axis in 'wxyz'},
}  # fmt: skip
sound = st.fixed_dictionaries({name: st.floats(*ends) for name, ends in RANGES.items()})
nothing = st.just({})
spoil = nothing | nothing | st.dictionaries(st.sampled_from(sorted(RANGES)), weird, max_size=2)


@settings(
    derandomize=True,
    max_examples=120,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],  # a busy machine is no fault of the planner
)
@given(sound, spoil, st.booleans(), st.sampled_from(Mode))
def test_requests_end_in_a_plan_or_in_words(request_, changes, adhesion, mode):
    """Numbers of any kind: a plan that passes the check, 'no plan', or the field at fault."""
    of = {**request_, **changes}
    try:
        finger = Finger(of['radius_um'], of['clearance_um'])
        start, goal = (
            Pose(
                [of[f'{end}_{axis}'] for axis in 'xyz'], [of[f'{end}_q{axis}'] for axis in 'wxyz']
            )
            for end in ('from', 'to')
        )
        plan = plan_reorientation(
            geometry_for(finger),
            start,
            goal,
            finger,
            ContactLaw(of['friction'], of['pull_off_uN'], of['max_force_uN'], adhesion),
            SearchOptions(math.radians(of['step_deg']), mode),
            GripRules(of['margin'], of['roll'], of['least_uN'], of['grip_uN'], of['off_uN']),
        )
    except MicrohandError as error:
        spoken(error, FIELDS)
    else:
        assert goal_error_deg(plan) < 1e-6
        if mode is Mode.ROBUST:  # on the paper's lattice fingers slip unless it fits the section
            check_plan(plan)
            check_forces(plan)


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    st.tuples(st.floats(0.0, 26.0), st.floats(0.0, 26.0)),
    st.permutations([0, 1, 2]),
    st.sampled_from(['z', 'y']),
    nothing | st.dictionaries(st.tuples(st.integers(0, 2), st.integers(0, 2)), weird, max_size=2),
)
def test_start_grasps_end_in_a_plan_or_in_words(phases, order, axis, changes):
    """Tips on the object are where the plan begins; others are named; nothing else comes of it."""
    finger = Finger()
    geometry = geometry_for(finger)
    curve = geometry.curves[axis]
    tips_um = np.full((3, 3), math.nan)
    tips_um[:2] = curve.plane.to_object(curve.at(np.array(phases)).centre_um)
    tips_um = tips_um[order]
    for where, value in changes.items():
        tips_um[where] = value
    try:
        plan = plan_reorientation(
            geometry,
            Pose(),
            Pose((0.0, 0.0, 0.0), (1.0, 0.2, 0.3, 0.4)),
            finger,
            ContactLaw(friction=0.5),
            SearchOptions(),
            start_tip_um=tips_um,
        )
    except MicrohandError as error:
        spoken(error, {'start-tips'})
    else:
        check_plan(plan)
        check_forces(plan)
        held = np.all(np.isfinite(tips_um), axis=1)
        assert plan.steps[0].tip_um[0, held] == pytest.approx(tips_um[held], abs=0.1)
