# SPDX-License-Identifier: Apache-2.0
"""One stage as the sequencer sees it: its reports, its services, and the setpoints it is sent."""

from __future__ import annotations

import math
import time

import numpy as np
from builtin_interfaces.msg import Time
from microhand_msgs_py.msg import SetpointChunk, StageState
from microhand_msgs_py.srv import Command, GetStageLimits
from rclpy.node import Node
from rclpy.task import Future

from microhand_node.inbox import Inbox
from microhand_node.life_sign import LifeSign
from microhand_node.qos import SETPOINTS, STATE
from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import FloatArray
from microhand_planner.core.travel import StageLimits
from microhand_planner.ros.conversions import UM_PER_M, m_from_um, um_from_point
from microhand_station.config import FingerConfig
from microhand_station.sequencer.setpoint_stream import Chunk
from microhand_station.sequencer.stage_watch import STAGE_MISSING, Mode, StageReport
from microhand_station.service_call import call

NS_PER_S = 1_000_000_000
LEARN_S = 1.0
"""How often it is looked who listens [s]: names are learnt before they can be lost."""
NO_NAME = '_NODE_NAME_UNKNOWN_'
"""What ROS calls a node whose name it does not know."""


class StageLink:
    """The sequencer's end of the connection to one stage driver.

    Parameters
    ----------
    node : Node
        Of the sequencer.
    inbox : Inbox
        Of that node; the reports of the stage come through it.
    finger : int
        1, 2 or 3.
    config : FingerConfig
        Where the stage stands in the station.
    """

    def __init__(self, node: Node, inbox: Inbox, finger: int, config: FingerConfig) -> None:
        self._finger = finger
        self._config = config
        self._node = node
        self._inbox = inbox
        self._report: StageReport | None = None
        name = f'finger_{finger}'
        self._topic = f'{name}/setpoints'
        self._setpoints = node.create_publisher(SetpointChunk, self._topic, SETPOINTS)
        self._names: dict[bytes, str] = {}
        node.create_timer(LEARN_S, self.listeners)
        inbox.subscribe(StageState, f'{name}/state', self._receive, STATE)
        driver = f'{name}/stage_driver'
        self._life = LifeSign(node, driver)
        self._losses = 0
        self._limits = node.create_client(GetStageLimits, f'{driver}/get_limits')
        self._stop = node.create_client(Command, f'{driver}/stop')
        self._reset = node.create_client(Command, f'{driver}/reset')

    @property
    def report(self) -> StageReport | None:
        """The last state that arrived, even if this process had no time to look until now."""
        self._inbox.empty()
        return self._report

    def expect(self) -> None:
        """Take the driver that is there now for the one that a run is executed by."""
        self._losses = self._life.losses

    @property
    def has_ended(self) -> bool:
        """Whether the driver that was expected has ended, even if there is another one now."""
        return self._life.losses != self._losses

    def limits(self, deadline_s: float) -> StageLimits:
        """Ask the driver what its stage can do.

        Raises
        ------
        RunFailed
            STAGE_MISSING: no driver answers, or it is not configured.
        """
        answer = call(
            self._limits,
            GetStageLimits.Request(),
            deadline_s=deadline_s,
            who=f'finger {self._finger}: its stage driver',
            missing_code=STAGE_MISSING,
            repeatable=True,
        )
        if answer.error_code:
            raise RunFailed(f'finger {self._finger}: {answer.error_msg}', answer.error_code)
        return StageLimits(
            self._config.base_um,
            um_from_point(answer.lower),
            um_from_point(answer.upper),
            answer.max_velocity * UM_PER_M,
            answer.max_acceleration * UM_PER_M or math.inf,
        )

    def listeners(self) -> set[str]:
        """Names of the nodes that receive the setpoints, in this publisher's view.

        A node that was frozen, or cut off, for 20 s is forgotten by DDS. When it is found again
        its subscriptions are the same, but ROS does not learn its name any more.
        """
        if self._setpoints.get_subscription_count() == 0:
            return set()
        infos = self._node.get_subscriptions_info_by_topic(self._setpoints.topic_name)
        for info in infos:
            if info.node_name != NO_NAME:
                self._names[bytes(info.endpoint_gid)] = info.node_name
        names = {self._names.get(bytes(info.endpoint_gid), NO_NAME) for info in infos}
        return names if self._setpoints.get_subscription_count() >= len(infos) else set()

    def has_contact_sensor(self) -> bool:
        """Whether somebody reports the contacts of this finger."""
        return self._node.count_publishers(f'finger_{self._finger}/contact') > 0

    def command_um(self) -> FloatArray:
        """Where the tip is commanded to be, station frame, (3,) [µm].

        Raises
        ------
        RunFailed
            STAGE_MISSING: the stage has not reported yet.
        """
        report = self.report
        if report is None:
            raise RunFailed(f'finger {self._finger}: nothing heard of its stage', STAGE_MISSING)
        return self._config.limits.to_station(report.command_um)

    def contact_um(self) -> FloatArray:
        """Where the tip was when it touched, station frame, (3,) [µm]; NaN: it did not."""
        report = self.report
        if report is None or not report.guard_tripped:
            return np.full(3, np.nan)
        return self._config.limits.to_station(report.contact_um)

    def send(
        self, chunk: Chunk, stream: int, begin_ns: int, period_s: float, guarded: bool
    ) -> None:
        """Publish the finger's part of a chunk.

        Parameters
        ----------
        chunk : Chunk
            Setpoints of all fingers.
        stream : int
            Number of the stream.
        begin_ns : int
            ROS time of the stream's first setpoint [ns].
        period_s : float
            Time between two setpoints [s].
        guarded : bool
            The stage stops at contact.
        """
        finger = self._finger - 1
        positions = self._config.limits.to_stage(chunk.tip_um[:, finger])
        message = SetpointChunk(
            sequence=chunk.first,
            stream=stream,
            period=period_s,
            positions=m_from_um(positions).ravel(),
            velocities=m_from_um(chunk.velocity_um_s[:, finger]).ravel(),
            last=chunk.last,
            guarded=guarded,
        )
        stamp_ns = begin_ns + round(chunk.first * period_s * NS_PER_S)
        message.header.stamp = Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)
        message.header.frame_id = f'finger_{self._finger}_base'
        self._setpoints.publish(message)

    def ask_to_stop(self) -> Future | None:
        """Send the stop command without waiting; None: nobody is there to receive it."""
        return self._stop.call_async(Command.Request()) if self._stop.service_is_ready() else None

    def reset(self, deadline_s: float) -> None:
        """Clear a stop or a fault of the stage.

        Raises
        ------
        RunFailed
            The driver does not answer, or refuses.
        """
        answer = call(
            self._reset,
            Command.Request(),
            deadline_s=deadline_s,
            who=f'finger {self._finger}: its stage driver',
            missing_code=STAGE_MISSING,
            repeatable=True,
        )
        if answer.error_code:
            raise RunFailed(f'finger {self._finger}: {answer.error_msg}', answer.error_code)

    def _receive(self, state: StageState) -> None:
        """Keep a report."""
        self._report = StageReport(
            arrived_s=time.monotonic(),
            mode=Mode(state.mode),
            position_um=um_from_point(state.position),
            command_um=um_from_point(state.command),
            velocity_um_s=um_from_point(state.velocity),
            on_target=state.on_target,
            stream=state.stream,
            received=state.received,
            underruns=state.underruns,
            error_code=state.error_code,
            error_msg=state.error_msg,
            guard_tripped=state.guard_tripped,
            contact_um=um_from_point(state.contact_position),
        )
