# SPDX-License-Identifier: Apache-2.0
"""`microhand verify`: what it answers, and which plans it refuses. Needs no ROS."""

import json
import math
import re
from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.plan_file import plan_hash, write_plan
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_station.cli import app
from tests.twin.test_pictures import draws

KEYS = {
    'status', 'error', 'held', 'final_error_deg', 'max_error_deg', 'max_friction_use', 'wall_s',
    'lost_at',
}  # fmt: skip


@pytest.fixture(scope='module')
def plan():
    """Return a short plan for the ellipsoid."""
    goal = Pose.of((0, 0, 0), Rotation.from_euler('z', 40.0, degrees=True))
    return plan_reorientation(
        find_part('ellipsoid'), Pose(), goal, Finger(), ContactLaw(), SearchOptions()
    )


@pytest.fixture
def plan_file(plan, tmp_path):
    """Return the path of its file."""
    path = tmp_path / 'plan.json'
    write_plan(plan, path)
    return path


@pytest.fixture
def run(capsys):
    """Return a function that runs `microhand verify` here: status, stdout, stderr."""

    def call(*arguments):
        status = app.main(['verify', *map(str, arguments)])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return call


def edited(path, change):
    """Change the content of a plan file in place."""
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def one_line(text):
    """Return the one line that is there; people are told one thing at a time."""
    (line,) = [line for line in text.splitlines() if line.strip()]
    return line


def test_a_plan_that_holds_ends_with_0(run, plan, plan_file):
    """Held: exit status 0, every key, numbers that are near to the plan's."""
    status, out, err = run(plan_file, '--json')
    result = json.loads(out)
    assert (status, err) == (0, '')
    assert result.keys() >= KEYS
    assert (result['status'], result['held'], result['lost_at']) == ('ok', True, None)
    assert result['plan_hash'] == plan_hash(plan)
    assert 0.0 <= result['final_error_deg'] <= result['max_error_deg'] < 0.1
    assert 0.0 < result['max_friction_use'] < 1.0


def test_people_read_a_sentence(run, plan_file):
    """Without --json the answer says that it held, and by how much."""
    status, out, _ = run(plan_file)
    assert status == 0
    assert out.startswith('held: off the goal by ')
    assert 'friction used' in out


def test_a_lost_object_ends_with_4(run, plan_file):
    """Lost: exit status 4, one line that says where, and `held` false beside `lost_at`."""
    status, out, err = run(plan_file, '--friction', 0.005, '--json')
    result = json.loads(out)
    assert status == 4
    assert one_line(err).startswith('microhand: the object is lost in step ')
    assert result['status'] == 'run_failed'
    assert result['held'] is False
    assert result['lost_at'].keys() == {'step', 'kind', 'time_s', 'what'}
    assert result['max_friction_use'] > 0.99


def test_the_seed_decides_the_errors(run, plan_file):
    """With placement errors, one seed gives one result and another seed another."""
    options = ('--placement-nm', 50, '--json', '--seed')
    one, same, other = (
        json.loads(run(plan_file, *options, seed)[1])['final_error_deg'] for seed in (7, 7, 8)
    )
    assert one == same != other


@draws
def test_a_film_and_a_picture_are_written(run, plan_file, tmp_path):
    """The film is as long as the run, at 25 frames a second, and shows its end for a second."""
    film, picture = tmp_path / 'run.mp4', tmp_path / 'end.png'
    status, out, _ = run(plan_file, '--video', film, '--picture', picture, '--json')
    frames, _ = imageio_ffmpeg.count_frames_and_secs(str(film))
    assert status == 0
    assert frames == pytest.approx(25.0 * json.loads(out)['duration_s'] + 25, abs=3)
    assert picture.read_bytes().startswith(b'\x89PNG')


def test_an_edited_plan_is_refused(run, plan_file):
    """A plan whose numbers do not fit its hash any more is not run."""
    edited(plan_file, lambda content: content['law'].update(friction=0.31))
    status, _, err = run(plan_file)
    assert status == 2
    assert 'hash' in one_line(err)


def test_a_plan_that_contradicts_itself_is_refused(run, plan, plan_file):
    """Edited with its hash, a plan whose steps do not join is refused by the step."""
    last = plan.steps[-1]
    moved = replace(last, tip_um=np.add(last.tip_um, (1.0, 0.0, 0.0)))
    write_plan(replace(plan, steps=(*plan.steps[:-1], moved)), plan_file)
    status, _, err = run(plan_file)
    assert status == 2
    assert f'step {len(plan.steps) - 1}' in one_line(err)


def test_a_plan_that_presses_too_hard_is_refused(run, plan, plan_file):
    """Edited with its hash, a grip that pushes the object out is refused, and never simulated."""
    steps = [
        step if step.force_uN is None else replace(step, force_uN=6.0 * step.force_uN)
        for step in plan.steps
    ]
    write_plan(replace(plan, steps=tuple(steps)), plan_file)
    status, out, err = run(plan_file)
    assert (status, out) == (2, '')
    assert re.match(r'microhand: .*step \d+ \(\w+\)', one_line(err))


@pytest.mark.parametrize(
    ('change', 'said'),
    [
        (lambda content: content.update(format_version='1.0'), 'version'),
        (lambda content: content['steps'][1]['tip_um'][0][0].__setitem__(0, math.nan), 'tip_um'),
        (lambda content: content.pop('law'), 'law'),
        (lambda content: content['object'].update(name='concave'), 'hash'),
    ],
)
def test_damaged_plans_are_refused(run, plan_file, change, said):
    """Another version, NaN, a missing field, another name: one line that names it, status 2."""
    edited(plan_file, change)
    status, _, err = run(plan_file)
    assert status == 2
    assert said in one_line(err)


def test_another_object_is_refused(run, plan_file):
    """The plan is of the ellipsoid: with the concave object it is not run."""
    status, _, err = run(plan_file, '--object', 'concave')
    assert status == 2
    assert 'for which the plan was made' in one_line(err)


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (('--friction', '-1'), 'friction'),
        (('--pull-off-uN', 'nan'), 'pull-off'),
        (('--stiffness', '0'), 'stiffness'),
        (('--placement-nm', '-5'), 'placement'),
        (('--object', 'nonsense'), 'object'),
        (('--video', '/nowhere/at/all.mp4'), 'video'),
    ],
)
def test_impossible_options_are_named(run, plan_file, options, said):
    """A value that cannot be is refused by its name, before anything is simulated."""
    status, out, err = run(plan_file, *options)
    assert (status, out) == (2, '')
    assert said in one_line(err)


def test_a_missing_file_is_named(run, tmp_path):
    """There is no such plan."""
    status, _, err = run(tmp_path / 'none.json')
    assert status == 2
    assert 'none.json' in one_line(err)
