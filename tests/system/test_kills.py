# SPDX-License-Identifier: Apache-2.0
"""Each process of a station killed while the fingers move: who learns what, and what comes after.

One station lives through all of it: the run in which a process is killed shows that the station
was usable after the kill before.
"""

import contextlib
import math
import os
import signal
import threading
import time
import urllib.request
from pathlib import Path

from mcap.reader import make_reader
from microhand_msgs_py.action import Reorient
from microhand_msgs_py.msg import ErrorCode, SequencerState, StageState
from rclpy.action import ActionClient

from microhand_planner.core.errors import MicrohandError
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, SearchOptions
from microhand_planner.core.plan import StepKind
from microhand_planner.core.pose import Pose
from microhand_planner.ros.conversions import options_to_msg, pose_to_msg
from microhand_station.client import StationClient
from microhand_station.recording.recover import recover
from tests.station.bench import Watcher
from tests.system.test_station import by_mcap, finished, processes_of, running, turn

NAME = 'kills'
ANSWER_S = 30.0
KNOWN_S = 1.0
"""Who waits for a run learns within this time that it will not end well, on a machine at rest."""
BUSY_S = 3.0
"""What a machine that is busy with other things may add; DDS alone would take 20 s."""
LONG_SEARCH = {
    'options': SearchOptions(step_rad=math.radians(0.4)),
    'rules': GripRules(least_margin_uN=0.3),
}
"""Takes several seconds."""
WORK_TICKS = 30
"""Processor time of a search that is well under way [10 ms]."""
POLL_S = 0.02


class Scene:
    """A running station, a client of it, and a plan that takes a while."""

    def __init__(self, station, client):
        self.station = station
        self.client = client
        self.watcher = Watcher(client.node)
        self.plan = client.plan('ellipsoid', Pose(), turn(0, 90, 0)).plan

    def kill(self, name):
        """Kill a process, and return when it is dead."""
        os.kill(processes_of(self.station.folder)[name], signal.SIGKILL)

    @contextlib.contextmanager
    def rolling(self, name):
        """Execute the plan until fingers roll; on leaving wait for its end, which is in a list."""
        ends = []
        rolling = threading.Event()
        kinds = [step.kind for step in self.plan.steps]
        first_roll = kinds.index(StepKind.ROLL)

        def execute():
            try:
                ends.append(
                    self.client.execute(
                        self.plan,
                        name,
                        on_progress=lambda p: p.step >= first_roll and rolling.set(),
                    )
                )
            except MicrohandError as error:
                ends.append(error)

        thread = threading.Thread(target=execute)
        thread.start()
        assert rolling.wait(ANSWER_S), ends
        try:
            yield ends
        finally:
            thread.join(ANSWER_S)
        assert ends, 'the caller waits in vain'

    def kill_rolling(self, name):
        """Kill a process while fingers roll; return how the run ended, known soon enough."""
        with self.rolling(name) as ends:
            self.kill(name)
            killed_s = time.monotonic()
        took_s = time.monotonic() - killed_s
        assert took_s < KNOWN_S + BUSY_S
        return ends[0]

    def wait_for_work(self, name):
        """Return when a process has computed for a while."""
        stat = Path(f'/proc/{processes_of(self.station.folder)[name]}/stat')

        def ticks():
            return sum(map(int, stat.read_text().rpartition(')')[2].split()[11:13]))

        begin, give_up_s = ticks(), time.monotonic() + ANSWER_S
        while ticks() < begin + WORK_TICKS:
            assert time.monotonic() < give_up_s, f'{name} does nothing'
            time.sleep(POLL_S)

    def wait_modes(self, *modes):
        """Return when the stages of fingers 1, 2, 3 are in these modes; None: any."""

        def there():
            stages = self.watcher.stages
            return all(mode in (None, stages[f].mode) for f, mode in enumerate(modes, start=1))

        self.watcher.wait(there)

    def wait_for_restart(self, name, since):
        """Return when the station has said, since a line, that a process died, and is back."""
        assert 'status -9' in self.station.wait_for_line(f'{name} ended', since=since)
        self.station.wait_for_line(f'{name} runs again', since=since)


def end_of(record):
    """Return what a record says of its own end."""
    with record.open('rb') as file:
        entries = {entry.name: entry.metadata for entry in make_reader(file).iter_metadata()}
    return entries['microhand_end']['end']


def driver_dies(scene):
    """Let it die: STAGE_MISSING names the finger; the other two stop; the record is whole."""
    error = scene.kill_rolling('finger_2')
    assert error.code == ErrorCode.STAGE_MISSING
    assert 'finger 2: its stage driver has ended' in str(error)
    scene.watcher.wait_state(SequencerState.IDLE)
    scene.wait_modes(StageState.STOPPED, None, StageState.STOPPED)
    assert end_of(error.execution.record_file) == 'complete'


def sequencer_dies(scene):
    """Let it die: the client says so; all stages are in a fault; the record is finished."""
    error = scene.kill_rolling('sequencer')
    assert str(error) == 'the sequencer ended before it answered'
    assert error.code == ErrorCode.SEQUENCER_MISSING
    assert error.exit_status == 4
    scene.wait_modes(*[StageState.FAULT] * 3)
    for stage in scene.watcher.stages.values():
        assert stage.error_code == ErrorCode.STREAM_BROKEN
        assert 'ran dry' in stage.error_msg
    scene.watcher.wait(
        lambda: any('sequencer ended before the run' in text for text in scene.watcher.events)
    )
    (record,) = scene.station.folder.glob('*/sequencer/sequencer.mcap')
    assert end_of(record) == 'the sequencer ended before the run did'


def twin_dies(scene):
    """Let it die: TWIN_MISSING; the stages hold; nothing is said about the object."""
    error = scene.kill_rolling('twin')
    assert error.code == ErrorCode.TWIN_MISSING
    assert error.execution.held is None
    scene.wait_modes(*[StageState.HOLDING] * 3)


def recorder_dies(scene):
    """Let it die: RECORDER_MISSING; stages and object are held; the file can be recovered."""
    error = scene.kill_rolling('recorder')
    assert error.code == ErrorCode.RECORDER_MISSING
    assert error.execution.held
    scene.wait_modes(*[StageState.HOLDING] * 3)
    repaired = scene.station.folder / 'repaired.mcap'
    recover(error.execution.record_file, repaired)
    assert by_mcap(repaired, 1)


def planner_dies(scene):
    """Let it die in a search: a run goes on and holds its object; who waits for a plan is told."""
    errors = []

    def search():
        try:
            scene.client.plan('ellipsoid', Pose(), turn(80, 220, 100), **LONG_SEARCH)
        except MicrohandError as error:
            errors.append(error)

    searching = threading.Thread(target=search)
    with scene.rolling('planner') as ends:
        searching.start()
        scene.wait_for_work('planner')
        scene.kill('planner')
        killed_s = time.monotonic()
        searching.join(ANSWER_S)
        assert time.monotonic() - killed_s < KNOWN_S + BUSY_S
    assert str(errors[0]) == 'the planner ended before it answered'
    assert errors[0].code == ErrorCode.PLANNER_MISSING
    assert ends[0].held


def planner_dies_first(scene):
    """Let it die while `reorient` waits for its plan: the caller is told, and nothing moves."""
    before = [stage.position for stage in scene.watcher.stages.values()]
    reorient = ActionClient(scene.client.node, Reorient, 'sequencer/reorient')
    assert reorient.wait_for_server(ANSWER_S)
    request = Reorient.Goal(object='ellipsoid')
    request.start_pose, request.goal_pose = pose_to_msg(Pose()), pose_to_msg(turn(80, 220, 100))
    request.options = options_to_msg(Finger(), ContactLaw(), *LONG_SEARCH.values())
    answer = finished(reorient.send_goal_async(request)).get_result_async()
    scene.wait_for_work('planner')
    scene.kill('planner')
    killed_s = time.monotonic()
    result = finished(answer).result
    assert time.monotonic() - killed_s < KNOWN_S + BUSY_S
    assert result.error_code == ErrorCode.PLANNER_MISSING
    assert result.error_msg == 'the planner ended before it answered'
    scene.watcher.wait_state(SequencerState.IDLE)
    for old, stage in zip(before, scene.watcher.stages.values(), strict=True):
        new = stage.position
        assert math.dist((old.x, old.y, old.z), (new.x, new.y, new.z)) < 20e-9  # noise


def test_each_process_is_killed_while_fingers_roll(ros_domain, tmp_path):
    """The caller learns of it within a second, the stages hold, and after a reset all goes on."""
    with running(tmp_path, '--namespace', NAME) as station, StationClient(NAME) as client:
        scene = Scene(station, client)
        for name, dies in (
            ('finger_2', driver_dies),
            ('sequencer', sequencer_dies),
            ('twin', twin_dies),
            ('recorder', recorder_dies),
            ('planner', planner_dies),
        ):
            said = len(station.lines)
            dies(scene)
            scene.wait_for_restart(name, said)
            client.command('reset')
            scene.watcher.wait_state(SequencerState.IDLE)
            scene.wait_modes(*[StageState.HOLDING] * 3)
        assert client.plan('ellipsoid', Pose(), turn(0, 0, 20)).plan.steps
        assert len(processes_of(tmp_path)) == 7
        assert 'Traceback' not in station.logs()


def test_a_planner_is_killed_while_reorient_waits_for_it(ros_domain, tmp_path):
    """Whoever asked for the reorientation is told, and nothing moves; then there is a new one."""
    with running(tmp_path, '--namespace', NAME) as station, StationClient(NAME) as client:
        scene = Scene(station, client)
        scene.watcher.wait(lambda: len(scene.watcher.stages) == 3)
        planner_dies_first(scene)
        scene.wait_for_restart('planner', 0)


def test_a_killed_view_comes_back_where_its_page_was(ros_domain, tmp_path):
    """The port was any that was free; after the restart the page is at the same one."""
    with running(tmp_path, '--namespace', NAME, '--view-port', '0') as station:
        (file,) = tmp_path.glob('*/view_address')
        page = file.read_text()
        os.kill(processes_of(tmp_path)['view'], signal.SIGKILL)
        station.wait_for_line('view runs again')
        assert file.read_text() == page
        with urllib.request.urlopen(page, timeout=ANSWER_S) as answer:
            assert answer.status == 200
