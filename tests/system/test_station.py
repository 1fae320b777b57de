# SPDX-License-Identifier: Apache-2.0
"""The whole station as a user runs it: processes, services, actions, a record, and an end."""

import contextlib
import dataclasses
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from microhand_msgs_py.action import Reorient
from microhand_msgs_py.msg import ErrorCode, PlanOptions, PlanStep
from microhand_msgs_py.srv import ListObjects, PlanRotation
from rclpy.action import ActionClient
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.motions import motions
from microhand_planner.core.pose import Pose
from microhand_planner.core.trajectory import time_steps
from microhand_planner.ros.conversions import plan_from_msg, point_from_um, pose_to_msg
from microhand_station.client import StationClient, StationError
from microhand_station.config import (
    ContactConfig,
    Motion,
    StationConfig,
    TwinConfig,
    write_config,
)
from microhand_station.sequencer.approach_path import way_to_start
from microhand_station.service_call import call

START_S = 60.0
END_S = 20.0
ANSWER_S = 30.0
FAST = StationConfig(
    motion=Motion(roll_rate_deg_s=60.0, transit_um_s=400.0, speed=2.0),
    contact=ContactConfig(speed_um_s=2.0),
)
OWN = ('--namespace', 'own')
COMMAND = shutil.which('microhand', path=f'{Path(sys.executable).parent}{os.pathsep}{os.defpath}')


class Station:
    """`microhand station` in a process, and what it prints."""

    def __init__(self, folder, *arguments):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        write_config(FAST, folder / 'fast.yaml')
        self.lines = []
        self._changed = threading.Condition()
        self.process = subprocess.Popen(
            [
                *(COMMAND, 'station', '--config', str(folder / 'fast.yaml')),
                *('--run-dir', str(folder), *arguments),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self):
        for line in self.process.stdout:
            with self._changed:
                self.lines.append(line.rstrip())
                self._changed.notify_all()
        with self._changed:
            self.lines.append('<end>')
            self._changed.notify_all()

    def wait_for_line(self, word, deadline_s=START_S, since=0):
        """Return the first line, from a number on, with a word in it; fail if the end comes."""

        def found():
            return any(word in line or line == '<end>' for line in self.lines[since:])

        with self._changed:
            assert self._changed.wait_for(found, deadline_s), f'no {word!r} in {self.lines}'
        lines = [line for line in self.lines[since:] if word in line]
        assert lines, self.lines
        return lines[0]

    def end(self, how=signal.SIGINT):
        """Send a signal and return the exit status; every process of the station must be gone."""
        if self.process.poll() is None:
            self.process.send_signal(how)
        status = self.process.wait(END_S)
        self._reader.join(END_S)
        self.process.stdout.close()
        give_up_s = time.monotonic() + END_S
        while processes_of(self.folder) and time.monotonic() < give_up_s:
            time.sleep(0.05)
        assert processes_of(self.folder) == {}
        return status

    def logs(self):
        """Return what all nodes printed."""
        return '\n'.join(path.read_text() for path in self.folder.glob('*/*.log'))


def processes_of(folder):
    """Return the nodes that run from a folder: process id by name of the parameter file."""
    found = {}
    for entry in Path('/proc').iterdir():
        with contextlib.suppress(OSError, ValueError):
            words = (entry / 'cmdline').read_bytes().decode().split('\0')
            mine = [word for word in words if word.startswith(str(folder)) and 'params' in word]
            if mine:
                found[Path(mine[0]).name.removesuffix('.params.yaml')] = int(entry.name)
    return found


@contextlib.contextmanager
def running(folder, *arguments):
    """Run a station and end it, whatever happens."""
    station = Station(folder, *arguments)
    try:
        station.wait_for_line('station ready')
        yield station
    finally:
        station.end()


@pytest.fixture(scope='module')
def station(ros_domain, tmp_path_factory):
    """Start one station for the tests that leave it as it was."""
    with running(tmp_path_factory.mktemp('station')) as station:
        yield station


@pytest.fixture
def client(station):
    """Return a client in this process, which is not one of the station's."""
    with StationClient() as client:
        yield client


def turn(*angles_deg, position_um=(0.0, 0.0, 0.0)):
    """Return the pose turned by ZYZ angles."""
    return Pose.of(position_um, Rotation.from_euler('ZYZ', angles_deg, degrees=True))


def ask(client, kind, name, request):
    """Call a service of the planner."""
    service = client.node.create_client(kind, f'planner/{name}')
    try:
        return call(service, request, deadline_s=ANSWER_S, who='planner', missing_code=900)
    finally:
        client.node.destroy_client(service)


def expected_setpoints_um(plan, start_um):
    """Return what stages at `start_um` must be sent for a plan: (n, 3, 3), stage frame."""
    base = np.array(FAST.fingers[0].base_um)
    slowest = min(finger.max_velocity_um_s for finger in FAST.fingers)
    way = time_steps(way_to_start(start_um + base, plan), FAST.motion.transit_pace(slowest))
    pieces = motions(plan, FAST.motion.pace(slowest), FAST.stiffness_uN_per_um, FAST.touch)
    return np.concatenate([way.tip_um, *(piece.trajectory.tip_um for piece in pieces)]) - base


def setpoints_um(chunks):
    """Return the setpoints of chunks, after checking that none is missing: (n, 3)."""
    place = None
    for chunk in chunks:
        assert chunk.sequence == 0 or place == (chunk.stream, chunk.sequence)
        place = (chunk.stream, chunk.sequence + len(chunk.positions) // 3)
    return 1e6 * np.concatenate([np.array(c.positions).reshape(-1, 3) for c in chunks])


def by_mcap(path, finger):
    """Read the chunks of a finger with mcap-ros2-support."""
    with open(path, 'rb') as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [
            message
            for _, channel, _, message in reader.iter_decoded_messages()
            if channel.topic.endswith(f'/finger_{finger}/setpoints')
        ]


def by_rosbags(path, finger):
    """Read the chunks of a finger with rosbags."""
    with AnyReader([path]) as reader:
        topic = f'/finger_{finger}/setpoints'
        wanted = [c for c in reader.connections if c.topic.endswith(topic)]
        return [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(wanted)]


def test_a_request_from_another_process_is_planned_executed_and_recorded(ros_domain, tmp_path):
    """Plan by service, execute by action, and every setpoint is in the record, in order."""
    with running(tmp_path, *OWN), StationClient('own') as client:
        request = PlanRotation.Request(object='ellipsoid', options=PlanOptions())
        request.goal_pose = pose_to_msg(turn(0, 60, 0))
        answer = ask(client, PlanRotation, 'plan_rotation', request)
        assert (answer.error_code, answer.error_msg) == (ErrorCode.SUCCESS, '')
        plan = plan_from_msg(answer.plan)
        told = []
        result = client.execute(plan, 'system_test', told.append)
        assert result.record_file.name == 'system_test.mcap'
        assert told[-1].steps == len(plan.steps)
        assert result.held
        assert result.final_error_rad < math.radians(0.5)
    home = np.array([finger.home_um for finger in FAST.fingers])
    for read in (by_mcap, by_rosbags):
        sent = np.stack([setpoints_um(read(result.record_file, f)) for f in (1, 2, 3)], axis=1)
        assert len(sent) == result.setpoints_sent
        np.testing.assert_allclose(sent[0], home, atol=0.02)
        expected = expected_setpoints_um(plan, sent[0])
        off_um = np.abs(sent - expected).max(axis=(1, 2))
        # led by contact: what the stages overshoot until it is reported
        assert np.median(off_um) < 0.02
        assert off_um.max() < FAST.contact.overtravel_um + FAST.contact.tolerance_um


def test_bad_requests_are_answered_and_the_station_stays_up(client, station):
    """NaN, zero and unknown meshes have their codes; afterwards the station plans as before."""
    mistakes = [
        ({'object': '/no/such/mesh.stl'}, ErrorCode.UNKNOWN_OBJECT),
        ({'goal': Quaternion(w=math.nan)}, ErrorCode.INVALID_ROTATION),
        ({'goal': Quaternion(w=0.0)}, ErrorCode.INVALID_ROTATION),
    ]
    for changes, code in mistakes:
        request = PlanRotation.Request(object=changes.get('object', 'ellipsoid'))
        request.goal_pose.orientation = changes.get('goal', Quaternion(w=1.0))
        answer = ask(client, PlanRotation, 'plan_rotation', request)
        assert answer.error_code == code
        assert answer.error_msg
    assert client.plan('ellipsoid', Pose(), turn(0, 0, 40)).plan.steps
    assert len(processes_of(station.folder)) == 7


def test_a_plan_that_needs_more_travel_is_refused_and_nothing_is_recorded(client, station):
    """An object at the edge of the travel: TRAVEL_EXCEEDED names finger, axis, demand, limit."""
    answer = client.plan(
        'ellipsoid',
        turn(0, 0, 0, position_um=(90.0, 0, 0)),
        turn(0, 0, 40, position_um=(90, 0, 0)),
    )
    with pytest.raises(StationError, match=r'finger \d x is at .* µm of its stage; allowed: 0.0'):
        client.execute(answer.plan, 'too_far')
    assert list(station.folder.glob('*/too_far*')) == []


def test_reorient_plans_and_moves_and_goes_on_from_where_it_ended(client):
    """Two goals of `reorient`, the second one begun with the fingers that hold after the first."""
    reorient = ActionClient(client.node, Reorient, 'sequencer/reorient')
    assert reorient.wait_for_server(START_S)
    start, start_tips = Pose(), []
    for goal in (turn(0, 0, 30), turn(20, 0, 40)):
        request = Reorient.Goal(object='ellipsoid', start_tips=start_tips)
        request.start_pose, request.goal_pose = pose_to_msg(start), pose_to_msg(goal)
        result = finished(finished(reorient.send_goal_async(request)).get_result_async()).result
        assert (result.error_code, result.error_msg) == (ErrorCode.SUCCESS, '')
        assert Path(result.record_file).is_file()
        assert (result.object_judged, result.held) == (True, True)
        assert result.final_error < math.radians(0.5)
        last = plan_from_msg(result.plan).steps[-1]
        held = np.where(np.array(last.in_contact)[:, None], last.tip_um[-1], np.nan)
        start, start_tips = goal, [point_from_um(tip) for tip in held]
    assert result.plan.steps[0].kind == PlanStep.ROLL
    reorient.destroy()


def finished(future):
    """Wait for a future that the client's own thread serves."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(START_S), 'no answer'
    return future.result()


def test_two_stations_run_side_by_side_and_names_are_not_shared(client, station, tmp_path):
    """Another namespace is another station, ended alone; the same one is refused in one line."""
    with running(tmp_path / 'left', '--namespace', 'left') as other, StationClient('left') as left:
        for one in (client, left):
            answer = ask(one, ListObjects, 'list_objects', ListObjects.Request())
            assert 'ellipsoid' in [entry.name for entry in answer.objects]
        plan = left.plan('ellipsoid', Pose(), turn(0, 0, 20)).plan
        assert left.execute(plan).record_file.is_relative_to(tmp_path / 'left')
        assert other.end(signal.SIGTERM) == 0
        assert 'Traceback' not in other.logs() + '\n'.join(other.lines)
    assert client.plan('ellipsoid', Pose(), turn(0, 0, 20)).plan.steps
    second = Station(tmp_path / 'second')
    try:
        assert 'another --namespace' in second.wait_for_line('namespace')
        assert second.process.wait(END_S) == 2
    finally:
        second.end()


def test_a_signal_in_the_middle_of_a_run_ends_everything_cleanly(ros_domain, tmp_path):
    """Exit status 0, no process left, no traceback in any log; the record is there."""
    with running(tmp_path, *OWN) as station, StationClient('own') as client:
        plan = client.plan('ellipsoid', Pose(), turn(0, 0, 90)).plan
        moving = threading.Event()
        errors = []

        def execute():
            try:
                client.execute(plan, 'cut_short', lambda _: moving.set())
            except (StationError, RunFailed) as error:
                errors.append(error)

        thread = threading.Thread(target=execute)
        thread.start()
        assert moving.wait(ANSWER_S)
        assert station.end(signal.SIGINT) == 0
        thread.join(ANSWER_S)
        assert errors
        assert 'Traceback' not in station.logs() + '\n'.join(station.lines)
    (record,) = tmp_path.glob('*/cut_short/cut_short.mcap')
    assert by_mcap(record, 1)


def test_nodes_do_not_outlive_a_bring_up_that_is_killed(ros_domain, tmp_path):
    """SIGKILL of the parent ends every node."""
    with running(tmp_path, *OWN) as station:
        assert len(processes_of(tmp_path)) == 7
        assert station.end(signal.SIGKILL) == -signal.SIGKILL


def test_demo_does_it_all_and_says_so_in_json(tmp_path):
    """A mesh file in, a record and a report out; the object is held within 1°; nothing is left."""
    mesh = Path(__file__).parents[2] / 'examples' / 'ellipsoid.stl'
    done = subprocess.run(
        [
            *(COMMAND, 'demo', str(mesh), '--euler-zyz', '0', '40', '0', '--speed', '3'),
            *('--namespace', 'demo', '--run-dir', str(tmp_path), '--json'),
        ],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert (done.returncode, done.stderr) == (0, '')
    result = json.loads(done.stdout)
    assert result['status'] == 'ok'
    assert result['held'] is True
    assert result['final_error_deg'] < 1.0
    assert result['goal_error_deg'] < 1e-6
    report = Path(result['report']).read_text()
    assert report.startswith('<!DOCTYPE html>')
    assert 'The object was held, and ended' in report
    assert sum(len(c.positions) // 3 for c in by_mcap(result['mcap'], 2)) == result['setpoints']
    assert processes_of(tmp_path) == {}


def test_demo_of_an_object_that_slips_says_lost_and_never_held(tmp_path):
    """Far less friction than planned: exit status 4, `held` is false, and the report is there."""
    write_config(dataclasses.replace(FAST, twin=TwinConfig(friction=0.03)), tmp_path / 'slip.yaml')
    done = subprocess.run(
        [
            *(COMMAND, 'demo', 'ellipsoid', '--euler-zyz', '0', '80', '0', '--json'),
            *('--config', str(tmp_path / 'slip.yaml'), '--run-dir', str(tmp_path)),
            *('--namespace', 'slip'),
        ],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 4
    assert done.stderr.startswith('microhand: the object is lost: ')
    assert len(done.stderr.splitlines()) == 1
    result = json.loads(done.stdout)
    assert (result['status'], result['held']) == ('run_failed', False)
    assert result['error'] in done.stderr
    assert result['final_error_deg'] > 0.5
    assert 'The object was lost' in Path(result['report']).read_text()
    assert processes_of(tmp_path) == {}
