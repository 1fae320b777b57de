# SPDX-License-Identifier: Apache-2.0
"""The view as a process: what it takes along when it dies, and what is left when others die."""

import os
import signal
import threading
import time
import urllib.request

import numpy as np
import pytest
from microhand_msgs_py.msg import ErrorCode
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import Pose
from microhand_station.cli.app import main
from microhand_station.client import StationClient
from microhand_station.config import StationConfig
from microhand_station.sequencer.stage_watch import Mode
from microhand_station.view.listener import Listener
from microhand_station.view.station_commands import StationCommands
from tests.system.test_station import ANSWER_S, processes_of, running

NAME = 'mortal'
TURN = Pose.of(np.zeros(3), Rotation.from_euler('z', 40, degrees=True))
POLL_S = 0.05


def test_the_view_dies_alone_and_the_emergency_stop_needs_no_sequencer(ros_domain, tmp_path):
    """Killed in a run, the view is missed by nobody but told of; the run ends well.

    And with the sequencer killed, the emergency stop of the page still stops all stages.
    """
    options = ('--namespace', NAME, '--view-port', '0', '--no-restart')
    with running(tmp_path, *options) as station, StationClient(NAME) as client:
        url = station.wait_for_line('view: ').partition('view: ')[2]
        with urllib.request.urlopen(url, timeout=ANSWER_S) as page:
            assert page.status == 200
        plan = client.plan('ellipsoid', Pose(), TURN).plan
        view = processes_of(tmp_path)['view']
        killed = threading.Event()

        def kill(_):
            if not killed.is_set():
                killed.set()
                os.kill(view, signal.SIGKILL)

        result = client.execute(plan, on_progress=kill)
        assert killed.is_set()
        assert (result.held, result.record_file.is_file()) == (True, True)
        assert 'view ended with status -9' in station.wait_for_line('view ended')
        assert len(processes_of(tmp_path)) == 7
        listener, commands = Listener(client.node, StationConfig()), StationCommands(client)
        os.kill(processes_of(tmp_path)['sequencer'], signal.SIGKILL)
        station.wait_for_line('sequencer ended with status -9')
        with pytest.raises(RunFailed, match='the stages were stopped without it') as error:
            commands.emergency_stop()
        assert error.value.code == ErrorCode.STAGE_MISSING
        give_up_s = time.monotonic() + ANSWER_S
        while [stage and stage.mode for stage in listener.snapshot().stages] != [Mode.STOPPED] * 3:
            assert time.monotonic() < give_up_s
            threading.Event().wait(POLL_S)


@pytest.mark.parametrize(
    ('options', 'sentence'),
    [
        (('--view-host', '0.0.0.0'), 'view-host is 0.0.0.0, which other machines reach, and'),
        (('--view-token', 'short', '--view'), 'view-token is of 5 characters; allowed: 16 to 200'),
        (('--view-port', '70000'), 'view-port is 70000; allowed: 0 to 65535'),
    ],
)
def test_an_address_that_cannot_be_is_refused_before_anything_starts(
    tmp_path, capsys, options, sentence
):
    """Exit status 2 and one line; no folder is made."""
    folder = tmp_path / 'runs'
    assert main(['station', '--run-dir', str(folder), *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == ''
    (line,) = printed.err.splitlines()
    assert sentence in line
    assert not folder.exists()
