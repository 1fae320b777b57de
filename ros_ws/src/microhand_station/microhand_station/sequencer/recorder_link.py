# SPDX-License-Identifier: Apache-2.0
"""The recorder as the sequencer sees it: opened before anything moves, closed after."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from microhand_msgs_py.msg import Plan
from microhand_msgs_py.srv import StartRun, StopRun
from rclpy.node import Node

from microhand_node.life_sign import LifeSign
from microhand_node.qos import DIAGNOSTICS
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
        self._life = LifeSign(node, 'recorder')
        self._losses = 0
        self._start = node.create_client(StartRun, 'recorder/start_run')
        self._stop = node.create_client(StopRun, 'recorder/stop_run')
        self._status_name = f'{node.get_namespace().rstrip("/")}/recorder: record'
        self._file = self._fault = ''
        node.create_subscription(DiagnosticArray, '/diagnostics', self._receive, DIAGNOSTICS)

    @property
    def fault(self) -> str:
        """What the recorder says is wrong with the record being written; empty: nothing."""
        if self._file and self._life.losses != self._losses:
            return 'the recorder ended before the run did'
        return self._fault

    def start(
        self,
        name: str,
        metadata: Mapping[str, Any],
        plan: Plan,
        mesh_file: str,
        deadline_s: float,
    ) -> str:
        """Open the record of a run; return the path of the file.

        Parameters
        ----------
        name : str
            Of the run; empty: made from the time.
        metadata : mapping
            Kept in the file.
        plan : Plan
            Kept in the file.
        mesh_file : str
            Attached to the file; empty: none.
        deadline_s : float
            Longest wait for an answer [s].

        Raises
        ------
        RunFailed
            RECORDER_MISSING, or what the recorder says.
        """
        self._losses = self._life.losses
        greet(
            self._node,
            'recorder',
            deadline_s=deadline_s,
            who='the recorder',
            missing_code=RECORDER_MISSING,
        )
        answer = call(
            self._start,
            StartRun.Request(
                name=name, metadata_json=json.dumps(metadata), plan=plan, mesh_file=mesh_file
            ),
            deadline_s=deadline_s,
            who='the recorder',
            missing_code=RECORDER_MISSING,
        )
        if answer.error_code:
            raise RunFailed(f'recorder: {answer.error_msg}', answer.error_code)
        self._file, self._fault = str(answer.file), ''
        return self._file

    def stop(self, setpoints: Sequence[int], deadline_s: float) -> str:
        """Close the record of a run that sent so many setpoints; return what is wrong with it.

        Returns
        -------
        str
            Empty if every setpoint is in the file.
        """
        fault, self._file, self._fault = self.fault, '', ''
        if self._life.losses != self._losses:
            return fault
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

    def _receive(self, array: DiagnosticArray) -> None:
        """Note what the recorder says of the open record."""
        for status in array.status:
            if status.name != self._status_name or status.level != DiagnosticStatus.ERROR:
                continue
            file = next((item.value for item in status.values if item.key == 'file'), '')
            if self._file and file == self._file:
                self._fault = status.message
