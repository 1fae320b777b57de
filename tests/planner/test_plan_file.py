# SPDX-License-Identifier: Apache-2.0
"""Plan files: they come back as they went, and nothing else is read as a plan."""

import copy
import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import BadRequest, InvalidPlan
from microhand_planner.core.hold import Hold
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, SearchOptions
from microhand_planner.core.plan import Plan, StepKind
from microhand_planner.core.plan_file import (
    plan_from_dict,
    plan_hash,
    plan_to_dict,
    read_plan,
    write_plan,
)
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from tests.planner.solids import ellipsoid


@pytest.fixture(scope='module')
def plan():
    """Return a plan with rolls, regrasps and a translation."""
    turn = Rotation.from_euler('ZYZ', [40.0, 110.0, 30.0], degrees=True)
    return plan_reorientation(
        ellipsoid((18.0, 11.0, 14.0), 4),
        Pose((3.0, -2.0, 1.0), (0.9, 0.1, -0.3, 0.2)),
        Pose.of((6.0, -2.0, -1.0), turn),
        Finger(clearance_um=0.25),
        ContactLaw(friction=0.37),
        SearchOptions(math.radians(17.0), time_limit_s=60.0),
        GripRules(0.85, 0.55, 0.04, 4.4, 0.4),
    )


@pytest.fixture
def content(plan):
    """Return the plan as plain values, to be spoiled."""
    return copy.deepcopy(plan_to_dict(plan))


def assert_same(one: Plan, other: Plan):
    """Compare two plans field by field; angles may differ by rounding."""
    assert plan_hash(one) == plan_hash(other)
    for name in ('object_name', 'object_sha256', 'finger', 'law', 'rules', 'rotations'):
        assert getattr(one, name) == getattr(other, name)
    assert one.options.step_rad == pytest.approx(other.options.step_rad, rel=1e-15)
    for pose, again in ((one.start, other.start), (one.goal, other.goal)):
        assert np.array_equal(pose.position_um, again.position_um)
        assert np.allclose(pose.quaternion_wxyz, again.quaternion_wxyz, rtol=0, atol=1e-15)
    for step, again in zip(one.steps, other.steps, strict=True):
        for field in dataclasses.fields(step):
            value, read = getattr(step, field.name), getattr(again, field.name)
            if field.name == 'angle_rad':
                assert value == pytest.approx(read, rel=1e-14)
            else:
                assert np.array_equal(value, read, equal_nan=field.name == 'normal')


def test_a_plan_comes_back_from_a_file(plan, tmp_path):
    """Written and read again it is the same plan, with the same hash, forces and margins."""
    assert any(step.hold is not None for step in plan.steps)
    assert any(np.any(step.force_uN) for step in plan.steps)
    path = tmp_path / 'plan.json'
    write_plan(plan, path)
    assert_same(plan, read_plan(path))


def test_a_file_is_strict_json_without_nan(plan, tmp_path):
    """Other programs can read it: NaN is null, and units are in the names."""
    path = tmp_path / 'plan.json'
    write_plan(plan, path)

    def refuse(token):
        raise AssertionError(token)

    found = json.loads(path.read_text(encoding='utf-8'), parse_constant=refuse)
    assert found['format_version'] == '2.0'
    assert found['plan_hash'] == plan_hash(plan)
    assert any(
        None in normal for step in found['steps'] for row in step['normal'] for normal in row
    )


def test_writing_twice_gives_the_same_bytes(plan, tmp_path):
    """The file is a function of the plan."""
    paths = [tmp_path / 'one.json', tmp_path / 'two.json']
    for path in paths:
        write_plan(plan, path)
    assert paths[0].read_bytes() == paths[1].read_bytes()


# ---------------------------------------------------------------- the hash


def spoiled(plan, number, **changes):
    """Return the plan with other values in one step."""
    steps = list(plan.steps)
    steps[number] = dataclasses.replace(steps[number], **changes)
    return dataclasses.replace(plan, steps=tuple(steps))


def changed(array, where, by):
    """Return a copy of an array with something added at one place."""
    copy = np.array(array)
    copy[where] += by
    return copy


def test_the_hash_sees_every_number_that_matters(plan):
    """A change of one picometre, one piconewton, or of any setting, is another plan."""
    number, roll = next(
        (i, step) for i, step in enumerate(plan.steps) if step.kind is StepKind.ROLL
    )
    held = roll.in_contact.index(True)
    others = [
        spoiled(plan, number, tip_um=changed(roll.tip_um, (3, 1, 2), 1e-6)),
        spoiled(plan, number, normal=changed(roll.normal, (2, held, 1), 1e-11)),
        spoiled(plan, number, force_uN=changed(roll.force_uN, (4, held, 0), 1e-6)),
        spoiled(plan, number, hold=None),
        *(
            spoiled(plan, number, hold=dataclasses.replace(roll.hold, **{name: value + 1e-6}))
            for name, value in vars(roll.hold).items()
        ),
        spoiled(plan, number, kind=StepKind.TRANSLATE),
        spoiled(plan, number, rotation=len(plan.rotations) - 1),
        spoiled(plan, number, finger=3),
        spoiled(plan, number, angle_rad=roll.angle_rad + 1e-6),
        dataclasses.replace(plan, object_sha256='0' * 64),
        dataclasses.replace(plan, object_name='another'),
        dataclasses.replace(plan, start=plan.goal),
        dataclasses.replace(plan, finger=Finger()),
        dataclasses.replace(plan, law=dataclasses.replace(plan.law, friction=0.371)),
        dataclasses.replace(plan, law=dataclasses.replace(plan.law, adhesion=False)),
        dataclasses.replace(plan, options=SearchOptions()),
        *(
            dataclasses.replace(
                plan, rules=dataclasses.replace(plan.rules, **{name: value * 1.000001})
            )
            for name, value in vars(plan.rules).items()
        ),
        dataclasses.replace(plan, steps=plan.steps[:-1]),
        dataclasses.replace(plan, rotations=(*plan.rotations, plan.rotations[0])),
    ]
    assert len(others) > 25
    hashes = {plan_hash(other) for other in [plan, *others]}
    assert len(hashes) == len(others) + 1


def test_a_step_of_a_rotation_that_is_not_there_makes_no_plan(plan):
    """Steps and rotations that do not belong together are refused when the plan is built."""
    first = next(i for i, step in enumerate(plan.steps) if step.rotation == 2)
    with pytest.raises(InvalidPlan, match=f'step {first}: rotation is 2; allowed: 0 to 1'):
        dataclasses.replace(plan, rotations=plan.rotations[:-1])
    with pytest.raises(InvalidPlan, match='step 1: rotation is -1; allowed: 0 to 2'):
        spoiled(plan, 1, rotation=-1)


@pytest.mark.parametrize(
    ('name', 'value', 'text'),
    [
        ('force_uN', np.full((2, 3, 3), math.nan), 'force_uN is not finite'),
        ('force_uN', np.full((2, 3, 3), 1e6), 'force_uN is too large; allowed: numbers up to'),
        (
            'force_uN',
            np.zeros((3, 3, 3)),
            r'force_uN is of shape \(3, 3, 3\); allowed: shape \(2,',
        ),
        ('force_uN', np.ones((2, 3, 3)), 'force_uN is not zero for a finger in the air'),
        ('tip_um', np.zeros((1, 3, 3)), 'object_position_um is of shape'),
        ('finger', 4, 'finger is 4; allowed: 0, 1, 2 or 3'),
        ('angle_rad', math.inf, 'angle is inf'),
    ],
)
def test_steps_are_checked_when_they_are_built(plan, name, value, text):
    """Forces that are none, shapes that do not fit, and forces of fingers in the air."""
    grip = next(step for step in plan.steps if step.kind is StepKind.GRIP)
    assert sum(grip.in_contact) == 2
    with pytest.raises(InvalidPlan, match=text):
        dataclasses.replace(grip, **{name: value})


@pytest.mark.parametrize('name', ['grip_uN', 'low_uN', 'high_uN', 'margin_uN'])
def test_a_hold_is_made_of_numbers(name):
    """NaN and infinity are no grip; everything else becomes whole piconewtons."""
    values = dict.fromkeys(('grip_uN', 'low_uN', 'high_uN', 'margin_uN'), 1.23456789)
    assert getattr(Hold(**values), name) == 1.234568
    for value in (math.nan, math.inf):
        with pytest.raises(
            InvalidPlan, match=f'hold: {name} is {value}; allowed: a finite number'
        ):
            Hold(**{**values, name: value})


def test_the_hash_does_not_see_the_effort(plan):
    """Time and states of the search, and its time limit, make no other plan."""
    rotations = tuple(
        dataclasses.replace(report, time_s=report.time_s + 1.0, expanded=report.expanded + 1)
        for report in plan.rotations
    )
    options = dataclasses.replace(plan.options, time_limit_s=None)
    other = dataclasses.replace(plan, rotations=rotations, options=options)
    assert plan_hash(plan) == plan_hash(other)


def test_the_hash_survives_the_way_through_metres(plan):
    """Lengths in metres and back differ by rounding, and the plan keeps its hash."""
    steps = tuple(
        dataclasses.replace(
            step,
            tip_um=step.tip_um * 1e-6 * 1e6,
            object_position_um=step.object_position_um * 1e-6 / 1e-6,
        )
        for step in plan.steps
    )
    assert plan_hash(dataclasses.replace(plan, steps=steps)) == plan_hash(plan)


# ---------------------------------------------------------------- what is refused


def put(content, path, value):
    """Set a value deep in plain values."""
    *way, last = path
    for key in way:
        content = content[key]
    content[last] = value


@pytest.mark.parametrize(
    ('path', 'value'),
    [
        (['steps', 1, 'tip_um', 0, 0, 0], 1.0),
        (['steps', 1, 'angle_deg'], 12.0),
        (['goal', 'position_um', 0], 7.0),
        (['finger', 'radius_um'], 4.6),
        (['rules', 'margin_factor'], 0.5),
        (['steps', 1, 'force_uN', 1, 0, 0], 0.25),
        (['steps', 2, 'hold', 'margin_uN'], 9.0),
        (['steps', 2, 'hold'], None),
        (['object', 'name'], 'another'),
        (['rotations', 0, 'axis'], 'y'),
        (['plan_hash'], '0' * 64),
        (['plan_hash'], None),
    ],
)
def test_edited_plans_are_refused(content, path, value):
    """Whoever changes a number must know what they do: the hash does not fit any more."""
    put(content, path, value)
    with pytest.raises(InvalidPlan, match='plan_hash is'):
        plan_from_dict(content)


@pytest.mark.parametrize('version', ['1.0', '3.0', '0.9', 'x', None, '', 1])
def test_other_versions_are_refused(content, version):
    """Another major version may mean anything."""
    content['format_version'] = version
    with pytest.raises(InvalidPlan, match=r'format_version is .*; allowed: 2\.0'):
        plan_from_dict(content)


def test_later_minor_versions_are_read(content, plan):
    """2.7 may only add fields."""
    content.update(format_version='2.7', news=42)
    assert plan_hash(plan_from_dict(content)) == plan_hash(plan)


@pytest.mark.parametrize(
    'path',
    [
        *([key] for key in ('object', 'start', 'goal', 'finger', 'law', 'options', 'steps')),
        ['rules'],
        ['options', 'mode'],
        ['rotations', 0, 'waiting'],
        ['steps', 2, 'force_uN'],
        ['steps', 2, 'hold'],
        ['steps', 2, 'hold', 'low_uN'],
    ],
    ids=lambda path: '.'.join(map(str, path)),
)
def test_missing_fields_are_named(content, path):
    """A file without one of its parts says which."""
    *way, key = path
    within = content
    for part in way:
        within = within[part]
    del within[key]
    with pytest.raises(InvalidPlan, match=key):
        plan_from_dict(content)


PATHS = [
    ['object'],
    ['object', 'name'],
    ['start', 'quaternion_wxyz'],
    ['goal', 'position_um'],
    ['finger'],
    ['finger', 'radius_um'],
    ['law', 'friction'],
    ['law', 'adhesion'],
    ['options', 'step_deg'],
    ['options', 'mode'],
    ['options', 'time_limit_s'],
    ['rotations'],
    ['rotations', 0],
    ['rotations', 0, 'axis'],
    ['rotations', 0, 'cost_deg'],
    ['rotations', 0, 'reconfigurations'],
    ['rotations', 0, 'waiting'],
    ['rules'],
    ['rules', 'margin_factor'],
    ['rules', 'grip_tolerance_uN'],
    ['steps'],
    ['steps', 0],
    ['steps', 0, 'kind'],
    ['steps', 0, 'rotation'],
    ['steps', 0, 'finger'],
    ['steps', 0, 'angle_deg'],
    ['steps', 0, 'in_contact'],
    ['steps', 0, 'tip_um'],
    ['steps', 0, 'tip_um', 0],
    ['steps', 0, 'tip_um', 0, 0, 0],
    ['steps', 0, 'normal'],
    ['steps', 0, 'object_quaternion_wxyz', 0, 0],
    ['steps', 1, 'force_uN'],
    ['steps', 1, 'force_uN', 0],
    ['steps', 1, 'force_uN', 1, 0, 0],
    ['steps', 2, 'hold'],
    ['steps', 2, 'hold', 'grip_uN'],
]
WRONG = [
    None, True, -1, 0, 10**400, 1e300, math.nan, math.inf, '', 'x', 'yes', [], [[]], {}, {'a': 1},
    [1, 2], [None, None, None],
]  # fmt: skip


@pytest.mark.parametrize('path', PATHS, ids=lambda path: '.'.join(map(str, path)))
def test_wrong_values_are_refused_in_words(plan, path):
    """Any value of a wrong type, shape or range gives one line that is a bad request."""
    plain = plan_to_dict(plan)
    for value in WRONG:
        content = copy.deepcopy(plain)
        put(content, path, value)
        message = ''
        try:
            found = plan_from_dict(content)
        except BadRequest as error:
            message = str(error)
        # what is accepted means the same as what was there, as far as a plan goes
        assert message or plan_hash(found) == plan_hash(plan), (path, value)
        assert '\n' not in message


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)


@settings(
    derandomize=True,
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.dictionaries(st.text(max_size=8), json_values, max_size=5), st.booleans())
def test_any_json_object_is_a_plan_or_a_bad_request(content, with_version):
    """Whatever the dictionary holds, there is no other outcome."""
    if with_version:
        content = {**content, 'format_version': '2.0'}
    with pytest.raises(InvalidPlan):
        plan_from_dict(content)


@pytest.mark.parametrize(
    'text',
    ['', '{', 'null', '[]', '"plan"', '{"format_version": "2.0"}', '\x00', '[' * 100_000, '1e999'],
    ids=['empty', 'open', 'null', 'list', 'text', 'version', 'zero', 'deep', 'number'],
)
def test_files_that_hold_no_plan_are_refused(tmp_path, text):
    """Truncated, empty, endless or other JSON is an invalid plan, and the file is named."""
    path = tmp_path / 'broken.json'
    path.write_text(text, encoding='utf-8')
    with pytest.raises(InvalidPlan) as caught:
        read_plan(path)
    assert '\n' not in str(caught.value)


def test_truncated_plans_are_refused(plan, tmp_path):
    """Half a plan is none, wherever the cut is."""
    path = tmp_path / 'plan.json'
    write_plan(plan, path)
    whole = path.read_bytes()
    for share in (0.01, 0.3, 0.99, 0.999):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InvalidPlan, match=r'plan\.json'):
            read_plan(path)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    """A mesh in place of a plan is an invalid plan."""
    path = tmp_path / 'mesh.stl'
    path.write_bytes(bytes(range(256)))
    with pytest.raises(InvalidPlan, match=r'mesh\.stl'):
        read_plan(path)


def test_files_that_cannot_be_opened_are_a_bad_request(plan, tmp_path):
    """A missing file, or a folder that is not there, is named with the reason."""
    with pytest.raises(BadRequest, match=r'nowhere\.json.*No such file'):
        read_plan(tmp_path / 'nowhere.json')
    with pytest.raises(BadRequest, match='directory'):
        read_plan(tmp_path)
    with pytest.raises(BadRequest, match='No such file'):
        write_plan(plan, tmp_path / 'nowhere' / 'plan.json')
