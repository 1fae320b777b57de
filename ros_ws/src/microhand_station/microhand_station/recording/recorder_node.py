# SPDX-License-Identifier: Apache-2.0
"""Topics of the running station → one mcap file per run, opened and closed by service.

The recorder listens from its start on, so that a run loses none of its first messages, and writes
while a run is open.
"""

from __future__ import annotations

import json
import platform
import re
import time
from collections.abc import Callable
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from microhand_msgs_py.msg import ErrorCode, Plan, RunEvent, SetpointChunk
from microhand_msgs_py.srv import StartRun, StopRun
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.task import Future

from microhand_node.inbox import Inbox
from microhand_node.lean_node import LeanNode
from microhand_node.life_sign import LifeSign, give_life_sign
from microhand_node.qos import DIAGNOSTICS, EVENTS, LATCHED
from microhand_node.run_node import run_node
from microhand_station.recording.bag_metadata import AnnouncedTopic
from microhand_station.recording.open_run import OpenRun
from microhand_station.recording.parameter_book import ParameterBook
from microhand_station.recording.record_status import record_status
from microhand_station.recording.recorded_topics import (
    PLAN_TOPIC,
    RecordedTopic,
    offered_qos_yaml,
    recorded_topics,
)
from microhand_station.recording.ros2msg_schema import installed_type_hash, ros2msg_schema
from microhand_station.recording.run_writer import PARAMETERS_METADATA, VERSIONS_METADATA
from microhand_station.recording.versions import installed_version, versions

_FINGERS = (1, 2, 3)
_RUN_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9._-]{0,99}')
# Messages published before the request to stop may still be under way: they get this long.
_UNDER_WAY_S = 0.1
_POLL_S = 0.02
INBOX_PERIOD_S = 0.02
"""Between two looks at the topics of many messages [s]; each keeps a second of them or more."""
STATUS_PERIOD_S = 1.0
"""Between two reports on ``/diagnostics`` [s]."""


class Recorder(LeanNode):
    """Records the runs of one station.

    Services ``~/start_run`` and ``~/stop_run``; reports on ``events`` and ``/diagnostics``.
    Parameters ``run_dir`` (folder of the records), ``stop_timeout`` (how long ``stop_run`` waits
    for setpoints that are still missing), ``max_message_size`` (larger ones are left out).
    """

    def __init__(self, clock_ns: Callable[[], int] = time.time_ns, **node_options: Any) -> None:
        super().__init__('recorder', **node_options)
        give_life_sign(self)
        self._clock_ns = clock_ns
        self.declare_parameter(
            'run_dir',
            'runs',
            ParameterDescriptor(description='Folder of the records; made if it is missing.'),
        )
        self.declare_parameter(
            'stop_timeout',
            5.0,
            ParameterDescriptor(
                description='[s] How long stop_run waits for setpoints that are still missing.',
                floating_point_range=[FloatingPointRange(from_value=0.0, to_value=600.0)],
            ),
        )
        self.declare_parameter(
            'max_message_size',
            100_000_000,
            ParameterDescriptor(
                description='[byte] Larger messages are left out of the record, with an event.',
                integer_range=[IntegerRange(from_value=1000, to_value=2**31, step=1)],
            ),
        )
        self._run: OpenRun | None = None
        self._noted_parameters: dict[str, str] = {}
        self._latched: dict[str, bytes] = {}
        self._events = self.create_publisher(RunEvent, 'events', EVENTS)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', DIAGNOSTICS)
        self._parameters_of_all = ParameterBook(self)
        topics = recorded_topics(_FINGERS)
        self._announced = [self._announce(topic) for topic in (PLAN_TOPIC, *topics)]
        self._inbox = Inbox(self)
        for topic in topics:
            name = self.resolve_topic_name(topic.name)
            subscribe = self._inbox.subscribe if topic.is_busy else self.create_subscription
            subscribe(
                topic.message_type, name, partial(self._record, name, topic), topic.qos, raw=True
            )
        self.create_timer(INBOX_PERIOD_S, self._inbox.empty)
        self.create_timer(STATUS_PERIOD_S, self._publish_status)
        self.create_service(StartRun, '~/start_run', self._start_run)
        self._sequencer = LifeSign(self, 'sequencer', self._close_orphan)
        self._losses = 0
        # While stop_run waits it must not hold the group of the subscriptions and timers.
        self.create_service(
            StopRun, '~/stop_run', self._stop_run, callback_group=ReentrantCallbackGroup()
        )

    def destroy_node(self) -> None:
        """Leave the ROS graph; an open record is finished first."""
        self._close_run('the recorder ended before the run did')
        super().destroy_node()

    def _announce(self, topic: RecordedTopic) -> AnnouncedTopic:
        """Return what is said of a topic in every record."""
        return AnnouncedTopic(
            name=self.resolve_topic_name(topic.name),
            type_name=topic.type_name,
            schema=ros2msg_schema(topic.type_name),
            offered_qos=offered_qos_yaml(topic.qos),
            type_hash=installed_type_hash(topic.type_name),
        )

    def _close_run(self, end: str) -> None:
        """Finish the file of the open run, if there is one; `end` says why, in the file."""
        self._inbox.empty()
        run, self._run = self._run, None
        if run is not None:
            self._note_parameters(run)
            run.close(end)

    def _note_parameters(self, run: OpenRun) -> None:
        """Keep the parameters of all nodes, unless they are in the file as they are."""
        known = self._parameters_of_all.text()
        if known != self._noted_parameters:
            self._noted_parameters = known
            run.note(PARAMETERS_METADATA, known)

    def _close_orphan(self) -> None:
        """Finish the file of a run whose sequencer will never ask for it."""
        if self._run is None or self._run.closing:
            return
        if self._sequencer.losses != self._losses:
            path, end = self._run.path, 'the sequencer ended before the run did'
            self._close_run(end)
            self._report(ErrorCode.INTERNAL, f'{path}: {end}')

    def _record(self, name: str, topic: RecordedTopic, cdr: bytes, info: dict[str, int]) -> None:
        if topic.qos is LATCHED:
            self._latched[name] = cdr
        run = self._run
        if run is None or run.failure:
            return
        written = run.write(
            name,
            cdr,
            info['received_timestamp'],
            info['source_timestamp'],
            info['publication_sequence_number'] or 0,
        )
        if not written:
            # once, for each topic that has messages that are too large
            if run.failure or run.left_out[name] == 1:
                self._report(ErrorCode.RECORDER_MISSING, run.fault)
                self._publish_status()
        elif topic.finger:
            chunk = deserialize_message(cdr, SetpointChunk)
            run.count_setpoints(
                topic.finger, chunk.stream, chunk.sequence, len(chunk.positions) // 3
            )

    def _start_run(
        self, request: StartRun.Request, response: StartRun.Response
    ) -> StartRun.Response:
        self._close_orphan()
        self._inbox.empty()  # what came before the run does not belong to it
        started = datetime.fromtimestamp(self._clock_ns() / 1e9, timezone.utc)
        name = request.name or started.strftime('run_%Y%m%dT%H%M%SZ')
        response.error_code, response.error_msg = self._refusal(name, request.metadata_json)
        if response.error_code:
            return response
        metadata = {
            'run': name,
            'started': started.isoformat(),
            'plan_hash': request.plan.plan_hash,
            'metadata_json': request.metadata_json,
            'microhand_station': installed_version('microhand_station') or 'not installed',
            'python': platform.python_version(),
        }
        try:
            run = self._open(name, metadata, request.plan)
        except OSError as error:
            response.error_code = ErrorCode.RECORDER_MISSING
            response.error_msg = (
                f'run_dir is {self._run_dir}; it cannot be written: {error.strerror}'
            )
            return response
        self._run = run
        self._losses = self._sequencer.losses
        response.file = str(run.path)
        self._report(ErrorCode.SUCCESS, f'recording {response.file}')
        if request.mesh_file:
            self._attach_mesh(run, Path(request.mesh_file))
        self._publish_status()
        return response

    @property
    def _run_dir(self) -> Path:
        """Folder of the records."""
        return Path(self.get_parameter('run_dir').value).expanduser()

    def _refusal(self, name: str, metadata_json: str) -> tuple[int, str]:
        """Error code and message of a request that cannot be served; (0, '') for a good one."""
        if self._run is not None:
            return ErrorCode.BUSY, f'{self._run.path} is being recorded; stop that run first'
        if not _RUN_NAME.fullmatch(name):
            allowed = 'up to 100 letters, digits and . _ -, the first a letter or digit'
            return ErrorCode.INVALID_PARAMETER, f'name is {name!r}; allowed: {allowed}'
        try:
            is_object = not metadata_json or isinstance(json.loads(metadata_json), dict)
        except ValueError:
            is_object = False
        if not is_object:
            return ErrorCode.INVALID_PARAMETER, 'metadata_json is not JSON; allowed: a JSON object'
        return ErrorCode.SUCCESS, ''

    def _open(self, name: str, metadata: dict[str, str], plan: Plan) -> OpenRun:
        """Open a record; write what there was before the run and is needed to understand it."""
        largest: int = self.get_parameter('max_message_size').value
        run = OpenRun(self._run_dir, name, metadata, self._announced, _FINGERS, largest)
        run.note(VERSIONS_METADATA, versions())
        self._noted_parameters = {}
        self._note_parameters(run)
        now_ns = self._clock_ns()
        run.write(self._announced[0].name, serialize_message(plan), now_ns, now_ns)
        for topic_name, cdr in self._latched.items():
            run.write(topic_name, cdr, now_ns, now_ns)
        if run.failure:
            failure = run.failure
            run.discard()
            raise OSError(None, failure)
        return run

    def _attach_mesh(self, run: OpenRun, mesh_file: Path) -> None:
        """Keep the mesh of the object; a run goes on without one that cannot be read."""
        try:
            data = mesh_file.read_bytes()
        except OSError as error:
            self._report(
                ErrorCode.SUCCESS,  # the run can do without
                f'mesh_file is {mesh_file}; it cannot be kept in the record: {error.strerror}',
            )
            return
        media_type = f'model/{mesh_file.suffix.lower().lstrip(".")}'
        run.attach(mesh_file.name, media_type, data, self._clock_ns())

    def _publish_status(self) -> None:
        """Tell ``/diagnostics`` how the record is."""
        status = record_status(self.get_fully_qualified_name(), self._run_dir, self._run)
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    async def _stop_run(
        self, request: StopRun.Request, response: StopRun.Response
    ) -> StopRun.Response:
        run = self._run
        if run is None or run.closing:
            response.error_code = ErrorCode.NOT_ALLOWED
            response.error_msg = 'no run is being recorded' if run is None else 'already stopping'
            return response
        run.closing = True
        expected = dict(zip(_FINGERS, map(int, request.expected_setpoints), strict=True))
        give_up_s = time.monotonic() + self.get_parameter('stop_timeout').value
        await self._pause(_UNDER_WAY_S)
        while run.lacks(expected) and time.monotonic() < give_up_s:
            await self._pause(_POLL_S)
        shortfall = run.shortfall(expected)
        self._close_run(shortfall or 'complete')
        shortfall = shortfall or run.failure
        if shortfall:
            response.error_code = ErrorCode.RECORDER_MISSING
            response.error_msg = shortfall
            self._report(ErrorCode.RECORDER_MISSING, shortfall)
        response.file = str(run.path)
        response.messages = run.messages
        response.recorded_setpoints = [run.recorded_setpoints(finger) for finger in _FINGERS]
        return response

    async def _pause(self, seconds: float) -> None:
        """Let the executor do its other work for a while."""
        passed = Future(executor=self.executor)
        timer = self.create_timer(
            seconds, lambda: passed.set_result(None), clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        await passed
        self.destroy_timer(timer)

    def _report(self, error_code: int, text: str) -> None:
        """Tell the log, and whoever listens to the events of the station."""
        # rclpy ties the severity to the line of the call.
        if error_code:
            self.get_logger().error(text)
        else:
            self.get_logger().info(text)
        event = RunEvent(source=self.get_fully_qualified_name(), error_code=error_code, text=text)
        event.header.stamp = self.get_clock().now().to_msg()
        self._events.publish(event)


def main() -> int:
    """Run the recorder until it is told to stop."""
    return run_node(Recorder)
