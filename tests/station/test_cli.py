# SPDX-License-Identifier: Apache-2.0
"""The command line: exit statuses, one line per mistake, JSON for programs. Nothing moves."""

import json
import os
import select
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

from microhand_planner.core.plan_check import check_plan
from microhand_planner.core.plan_file import read_plan
from microhand_station.cli import app
from microhand_station.cli.plan import plan as plan_command

PLAN_KEYS = {
    'status',
    'error',
    'cost_deg',
    'reconfigurations',
    'rotations',
    'goal_error_deg',
    'planning_time_s',
    'plan_hash',
    'tightest',
    'price_of_margin',
}
PROBLEM = {
    'ellipse_um': [16.22, 11.586],
    'contacts': 74,
    'step_deg': 20,
    'orientations': 19,
    'start': [1, 38, 0, 1],
    'goal': [38, 1, 0, 12],
}


@pytest.fixture
def run(capsys):
    """Return a function that runs `microhand` here: status, stdout, stderr."""

    def call(*arguments):
        status = app.main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return call


@pytest.fixture
def open_mesh(tmp_path):
    """Return the path of a cube without a lid."""
    cube = trimesh.creation.box((20.0, 20.0, 20.0))
    cube.update_faces(np.arange(len(cube.faces)) > 1)
    path = tmp_path / 'open.stl'
    cube.export(path)
    return path


def test_plan_gives_every_key_and_reaches_the_goal(run, tmp_path):
    """JSON has the keys of the contract; the file it writes is a sound plan with that hash."""
    out = tmp_path / 'plan.json'
    status, stdout, stderr = run(
        'plan', 'ellipsoid', '--euler-zyz', 80, 220, 100, '-o', out, '--json'
    )
    assert (status, stderr) == (0, '')
    result = json.loads(stdout)
    assert result.keys() == PLAN_KEYS
    assert result['status'] == 'ok'
    assert result['error'] is None
    assert result['goal_error_deg'] < 1e-6
    keys = {'axis', 'angle_deg', 'cost_deg', 'reconfigurations', 'expanded', 'waiting', 'time_s'}
    assert all(rotation.keys() == keys for rotation in result['rotations'])
    assert sum(rotation['cost_deg'] for rotation in result['rotations']) == result['cost_deg']
    plan = read_plan(out)
    check_plan(plan)
    assert json.loads(out.read_text())['plan_hash'] == result['plan_hash']


def test_a_quaternion_and_its_euler_angles_are_the_same_request(run):
    """Rz(90) as a quaternion and as ZYZ angles give the same cost; a negative angle is a value."""
    half = np.sqrt(0.5)
    _, by_angles, _ = run('plan', 'ellipsoid', '--euler-zyz', 0, 0, 90, '--json')
    _, by_quaternion, _ = run('plan', 'ellipsoid', '--quaternion', half, 0, 0, half, '--json')
    costs = [json.loads(text)['cost_deg'] for text in (by_angles, by_quaternion)]
    assert costs[0] == costs[1] > 0
    status, _, _ = run('plan', 'ellipsoid', '--euler-zyz', -10, 0, 0)
    assert status == 0


def test_paper_mode_takes_the_angles_as_they_are_given(run):
    """Rz(80) Ry(220) Rz(100) is planned as these three rotations, as in the paper's Table 4."""
    _, stdout, _ = run(
        'plan', 'ellipsoid', '--euler-zyz', 80, 220, 100, '--mode', 'paper', '--json'
    )
    rotations = json.loads(stdout)['rotations']
    angles = [rotation['angle_deg'] for rotation in rotations]
    assert angles == pytest.approx([80.0, 220.0, 100.0])
    assert [rotation['axis'] for rotation in rotations] == ['z', 'y', 'z']


def test_the_unit_of_a_mesh_scales_it(run, tmp_path):
    """The same ellipsoid in millimetres needs --unit mm, and then is planned the same way."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    ball.apply_scale([16.2e-3, 11.6e-3, 11.6e-3])
    path = tmp_path / 'ball.stl'
    ball.export(path)
    status, stdout, _ = run('plan', path, '--unit', 'mm', '--euler-zyz', 0, 0, 40, '--json')
    assert status == 0
    assert json.loads(stdout)['cost_deg'] == 80.0
    status, _, stderr = run('plan', path, '--euler-zyz', 0, 0, 40)
    assert status == 2
    assert len(stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ('arguments', 'status', 'words'),
    [
        (['plan', 'no_such_thing'], 2, ['no_such_thing', 'ellipsoid']),
        (['plan', 'ellipsoid', '--quaternion', 0, 0, 0, 0], 2, ['quaternion', 'not all zero']),
        (['plan', 'ellipsoid', '--quaternion', 'nan', 0, 0, 1], 2, ['quaternion', 'finite']),
        (['plan', 'ellipsoid', '--euler-zyz', 'inf', 0, 0], 2, ['euler-zyz', 'finite']),
        (['plan', 'ellipsoid', '--friction', -1], 2, ['friction is -1.0', '>= 0']),
        (['plan', 'ellipsoid', '--friction', 'slippery'], 2, ['--friction', 'slippery']),
        (['plan', 'ellipsoid', '--step-deg', 0], 2, ['step-deg', '0.1']),
        (['plan', 'ellipsoid', '--time-limit', -2], 2, ['time-limit', '> 0']),
        (['plan', 'ellipsoid', '--mode', 'magic'], 2, ['magic', 'robust']),
        (['plan', 'ellipsoid', '--finger-radius-um', 'nan'], 2, ['finger-radius', 'nan']),
        (
            ['plan', 'ellipsoid', '--euler-zyz', 1, 2, 3, '--quaternion', 1, 0, 0, 0],
            2,
            ['quaternion', 'euler-zyz'],
        ),
        (['plan', 'ellipsoid', '-o', '/no/such/folder/plan.json'], 2, ['/no/such/folder']),
        (['plan'], 2, ['OBJECT']),
        (['plan', 'ellipsoid', '--colour', 'red'], 2, ['--colour']),
        (['dance'], 2, ['dance']),
        (['planar', '/no/such/problem.json'], 2, ['/no/such/problem.json', 'No such file']),
        (['recover', '/no/such.mcap', '/tmp/out.mcap'], 2, ['/no/such.mcap']),
        (['station', '--config', '/no/such.yaml'], 2, ['/no/such.yaml', 'No such file']),
        (['station', '--domain-id', 300], 2, ['domain-id', '300']),
        (['demo', '--speed', 0], 2, ['speed is 0.0', '0.01']),
        (['demo', '--namespace', 'my lab'], 2, ['namespace', 'my lab']),
        (['demo', '--quaternion', 0, 0, 0, 0], 2, ['quaternion']),
    ],
)
def test_a_mistake_is_one_line_with_its_exit_status(run, arguments, status, words):
    """Every bad request names the field, and what is allowed; no traceback, nothing on stdout."""
    got, stdout, stderr = run(*arguments)
    assert (got, stdout) == (status, '')
    assert len(stderr.splitlines()) == 1
    assert stderr.startswith('microhand: ')
    assert all(word in stderr for word in words), stderr


def test_a_mesh_with_a_hole_is_refused_in_json_as_well(run, open_mesh):
    """Programs get the same object as on success, with the reason and nulls."""
    status, stdout, stderr = run('plan', open_mesh, '--euler-zyz', 0, 0, 40, '--json')
    result = json.loads(stdout)
    assert status == 2
    assert result.keys() == PLAN_KEYS
    assert result['status'] == 'bad_request'
    assert 'watertight' in result['error']
    assert result['error'] in stderr
    assert result['cost_deg'] is None


def test_no_plan_and_out_of_time_are_told_apart(run):
    """Exit status 3 both times; the words and the JSON status say which."""
    request = ['plan', 'ellipsoid', '--euler-zyz', 80, 220, 100, '--json']
    status, stdout, stderr = run(*request, '--no-adhesion', '--friction', 0.05)
    assert (status, json.loads(stdout)['status']) == (3, 'no_plan_exists')
    assert len(stderr.splitlines()) == 1
    status, stdout, stderr = run(*request, '--step-deg', 0.5, '--time-limit', 1e-6)
    assert (status, json.loads(stdout)['status']) == (3, 'time_limit')


def test_the_price_of_margin_is_told_with_the_plan_and_without_one(run):
    """Costs for five margin factors and the one asked for, also where the latter has no plan."""
    request = ['plan', 'ellipsoid', '--euler-zyz', 40, 110, 30, '--price-of-margin']
    status, stdout, stderr = run(*request, '--json')
    result = json.loads(stdout)
    assert (status, stderr) == (0, '')
    rows = result['price_of_margin']
    assert [row['margin_factor'] for row in rows] == [1.0, 0.9, 0.8, 0.7, 0.6]
    costs = [row['cost_deg'] or np.inf for row in rows]
    assert costs == sorted(costs)
    assert rows[2]['cost_deg'] == result['cost_deg']
    assert rows[2]['tightest_uN'] == result['tightest']['margin_uN']
    assert all(row['motion_s'] > 5.0 for row in rows if row['cost_deg'])
    status, stdout, _ = run(*request, '--margin', 0.65, '--json')
    result = json.loads(stdout)
    assert (status, result['status']) == (3, 'no_plan_exists')
    assert [row['margin_factor'] for row in result['price_of_margin']][4] == 0.65
    status, stdout, stderr = run(*request, '--margin', 0.65)
    assert status == 3
    assert stdout.count('no plan') == 3
    assert stderr.count('microhand: ') == 1
    status, _, stderr = run(*request, '--mode', 'paper')
    assert (status, 'price-of-margin is asked for in paper mode' in stderr) == (2, True)


class Terminal:
    """`microhand` with a terminal as stderr, in a process of its own."""

    def __init__(self, *arguments):
        self._reader, writer = os.openpty()
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'microhand_station.cli.app', *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=writer,
            text=True,
        )
        os.close(writer)
        self.shown = ''

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        os.close(self._reader)

    def read_until(self, text, deadline_s=90.0):
        """Read what is shown until `text` is among it, or the end."""
        give_up_s = time.monotonic() + deadline_s
        while text is None or text not in self.shown:
            ready, _, _ = select.select([self._reader], [], [], give_up_s - time.monotonic())
            assert ready, f'{text} was not shown in {deadline_s} s: {self.shown}'
            try:
                self.shown += os.read(self._reader, 4096).decode(errors='replace')
            except OSError:  # the other side has ended
                assert text is None, self.shown
                return


def test_people_see_what_is_being_done():
    """At a terminal: reading, cutting, searching, and for how long; the result stays on stdout."""
    with Terminal('plan', 'ellipsoid', '--euler-zyz', 0, 0, 40) as terminal:
        terminal.read_until(None)
        stdout = terminal.process.stdout.read()
        for words in ('reading ellipsoid', 'cutting the sections of ellipsoid', 'searching'):
            assert words in terminal.shown
        assert '0:00:0' in terminal.shown
        assert 'searching' not in stdout
        assert terminal.process.wait() == 0
    with Terminal('plan', 'ellipsoid', '--euler-zyz', 0, 0, 40, '--json') as terminal:
        terminal.read_until(None)
        assert terminal.shown == '', 'programs see nothing but JSON'


def test_a_search_ends_when_the_user_interrupts_it(tmp_path):
    """Ctrl-C during a search that takes minutes: one line, exit status 130.

    Long, slippery, without adhesion, and in fine steps: there is no dearer request.
    """
    path = tmp_path / 'long.ply'
    sphere = trimesh.creation.icosphere(subdivisions=4)
    trimesh.Trimesh(sphere.vertices * (30.0, 12.0, 12.0), sphere.faces).export(path)
    request = ['plan', path, '--euler-zyz', 80, 220, 100, '--step-deg', 1, '--no-adhesion']
    with Terminal(*request, '--friction', 0.5) as terminal:
        terminal.read_until('searching')
        terminal.process.send_signal(signal.SIGINT)
        terminal.read_until(None)
        stdout = terminal.process.stdout.read()
        assert (terminal.process.wait(), stdout) == (130, '')
        assert 'microhand: interrupted' in terminal.shown
        assert 'Traceback' not in terminal.shown


def test_planar_answers_with_a_path_of_the_papers_grasps(run, tmp_path):
    """The 220° rotation of Table 3: cost, regrasps, and a path from start to goal."""
    path = tmp_path / 'problem.json'
    path.write_text(json.dumps(PROBLEM))
    status, stdout, _ = run('planar', path, '--json')
    result = json.loads(stdout)
    assert status == 0
    keys = {'status', 'error', 'cost_deg', 'reconfigurations', 'path', 'expanded', 'time_s'}
    assert result.keys() == keys
    assert result['path'][0] == PROBLEM['start']
    assert result['path'][-1] == PROBLEM['goal']
    rolled = 0
    changed = 0
    for before, after in zip(result['path'], result['path'][1:], strict=False):
        if before[3] != after[3]:
            assert abs(before[3] - after[3]) == 1
            rolled += 20 * sum(contact > 0 for contact in before[:3])
        changed += sum((a > 0) != (b > 0) for a, b in zip(before[:3], after[:3], strict=True))
    assert changed == result['reconfigurations']
    assert result['cost_deg'] == rolled + 180 * changed


@pytest.mark.parametrize(
    ('changes', 'word'),
    [
        ({'start': [1, 38, 0]}, 'start'),
        ({'contacts': 'many'}, 'contacts'),
        ({'ellipse_um': [16.22]}, 'ellipse_um'),
        ({'colour': 'red'}, 'colour'),
        ({'friction': -1}, 'friction'),
    ],
)
def test_a_wrong_planar_problem_is_named(run, tmp_path, changes, word):
    """Wrong keys and values of PROBLEM.json are bad requests, in one line."""
    path = tmp_path / 'problem.json'
    path.write_text(json.dumps({**PROBLEM, **changes}))
    status, stdout, stderr = run('planar', path)
    assert (status, stdout) == (2, '')
    assert len(stderr.splitlines()) == 1
    assert word in stderr


def test_a_planar_problem_without_a_path_is_status_3(run, tmp_path):
    """Without adhesion the goal cannot be reached from the paper's start."""
    path = tmp_path / 'problem.json'
    path.write_text(json.dumps({**PROBLEM, 'adhesion': False}))
    status, stdout, stderr = run('planar', path, '--json')
    assert (status, json.loads(stdout)['status']) == (3, 'no_plan_exists')
    assert 'no path exists' in stderr


def test_help_teaches_by_examples(run):
    """Every command shows an example on a line of its own, to be typed as it stands."""
    for command in app.COMMANDS:
        status, stdout, _ = run(command, '--help')
        assert status == 0
        lines = [line.strip() for line in stdout.splitlines()]
        assert any(line.startswith(f'microhand {command}') for line in lines)
        assert '\\b' not in stdout
    status, stdout, _ = run('--help')
    assert status == 0
    assert all(command in stdout for command in app.COMMANDS)


def test_the_unforeseen_is_one_line_and_a_log(run, monkeypatch):
    """A defect of the software gives status 4, one line, and a file with the traceback."""

    def explode(*_args, **_kwargs):
        raise ZeroDivisionError('on purpose')

    monkeypatch.setattr(plan_command, 'callback', explode)
    status, stdout, stderr = run('plan', 'ellipsoid')
    assert (status, stdout) == (4, '')
    assert len(stderr.splitlines()) == 1
    assert 'ZeroDivisionError: on purpose' in stderr
    log = stderr.rsplit(' ', 1)[1].strip()
    with open(log, encoding='utf-8') as file:
        assert 'Traceback' in file.read()


def test_planning_imports_no_ros():
    """`microhand plan` works where ROS is not installed: it does not import it."""
    code = (
        'import sys\n'
        'from microhand_station.cli.app import main\n'
        "assert main(['plan', 'ellipsoid', '--euler-zyz', '0', '0', '20', '--json']) == 0\n"
        "assert 'rclpy' not in sys.modules and 'microhand_msgs_py' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_tables_are_for_people():
    """Without --json a person reads costs and angles, not keys and braces."""
    shown = CliRunner().invoke(app.microhand, ['plan', 'ellipsoid', '--euler-zyz', '0', '0', '40'])
    assert shown.exit_code == 0
    assert '80°' in shown.output
    assert '{' not in shown.output
