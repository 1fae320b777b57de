# SPDX-License-Identifier: Apache-2.0
"""The recorder as the sequencer sees it: opened before anything moves, closed after."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from microhand_msgs_py.msg import Plan
from microhand_msgs_py.srv import StartRun, StopRun
from rclpy.node import Node

from microhand_planner.core.errors import RunFailed
from microhand_station.service_call import call, greet

RECORDER_MISSING = 304


class RecorderLink:
    """The sequencer's end of the connection to the recorder.

    Parameters
    ----------
    node : Node
        Of the sequencer.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._start = node.create_client(StartRun, 'recorder/start_run')
        self._stop = node.create_client(StopRun, 'recorder/stop_run')

    def start(self, name: str, metadata: Mapping[str, Any], plan: Plan, deadline_s: float) -> str:
        """Open the record of a run; return the path of the file.

        Raises
        ------
        RunFailed
            RECORDER_MISSING, or what the recorder says.
        """
        greet(
            self._node,
            'recorder',
            deadline_s=deadline_s,
            who='the recorder',
            missing_code=RECORDER_MISSING,
        )
        answer = call(
            self._start,
            StartRun.Request(name=name, metadata_json=json.dumps(metadata), plan=plan),
            deadline_s=deadline_s,
            who='the recorder',
            missing_code=RECORDER_MISSING,
        )
        if answer.error_code:
            raise RunFailed(f'recorder: {answer.error_msg}', answer.error_code)
        return str(answer.file)

    def stop(self, setpoints: Sequence[int], deadline_s: float) -> str:
        """Close the record of a run that sent so many setpoints; return what is wrong with it.

        Returns
        -------
        str
            Empty if every setpoint is in the file.
        """
        try:
            answer = call(
                self._stop,
                StopRun.Request(expected_setpoints=list(setpoints)),
                deadline_s=deadline_s,
                who='the recorder',
                missing_code=RECORDER_MISSING,
            )
        except RunFailed as error:
            return str(error)
        return f'recorder: {answer.error_msg}' if answer.error_code else ''
