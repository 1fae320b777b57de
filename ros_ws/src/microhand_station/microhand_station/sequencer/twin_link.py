# SPDX-License-Identifier: Apache-2.0
"""The twin as the sequencer sees it: what it reports, and what it can be asked."""

from __future__ import annotations

import time

from microhand_msgs_py.msg import ObjectState, Plan
from microhand_msgs_py.srv import Command, LoadObject
from rclpy.node import Node

from microhand_node.inbox import Inbox
from microhand_node.life_sign import LifeSign
from microhand_node.qos import STATE
from microhand_planner.core.errors import RunFailed
from microhand_planner.ros.conversions import pose_from_msg
from microhand_station.sequencer.object_watch import TWIN_MISSING, ObjectReport
from microhand_station.sequencer.stage_link import NS_PER_S
from microhand_station.service_call import POLL_S, call, greet

LOAD_S = 60.0
"""Longest wait for a world to be built [s]."""
REPORT_S = 5.0
"""Longest wait for the first report of a world [s]."""


class TwinLink:
    """The sequencer's end of the connection to the twin.

    Parameters
    ----------
    node : Node
        Of the sequencer.
    inbox : Inbox
        Of that node; the reports of the object come through it.
    """

    def __init__(self, node: Node, inbox: Inbox) -> None:
        self._node = node
        self._life = LifeSign(node, 'twin')
        self._losses = 0
        self._inbox = inbox
        self._report: ObjectReport | None = None
        self._loaded_ns = 0
        inbox.subscribe(ObjectState, 'object_state', self._receive, STATE)
        self._release = node.create_client(Command, 'twin/release')
        self._load = node.create_client(LoadObject, 'twin/load')

    @property
    def report(self) -> ObjectReport | None:
        """The last state of the object that arrived, since it was loaded."""
        self._inbox.empty()
        return self._report

    def load(self, plan: Plan, object_name: str, unit_m: float, deadline_s: float) -> None:
        """Have the object of a plan put where the plan begins; nothing moves.

        Parameters
        ----------
        plan : Plan
            As it will be executed.
        object_name : str
            Catalogue name or mesh file; empty: the plan's.
        unit_m : float
            Of the mesh file [m]; 0: the default.
        deadline_s : float
            Longest wait for the twin to be there [s].

        Raises
        ------
        RunFailed
            TWIN_MISSING, or what the twin says.
        """
        self._losses = self._life.losses
        greet(self._node, 'twin', deadline_s=deadline_s, who='the twin', missing_code=TWIN_MISSING)
        request = LoadObject.Request(plan=plan, object=object_name, unit=unit_m)
        answer = call(
            self._load, request, deadline_s=LOAD_S, who='the twin', missing_code=TWIN_MISSING
        )
        if answer.error_code:
            raise RunFailed(f'twin: {answer.error_msg}', answer.error_code)
        # what the twin said about the object before this one may still be under way
        self._loaded_ns = self._node.get_clock().now().nanoseconds
        self._report = None
        give_up_s = time.monotonic() + REPORT_S
        while self.report is None:
            if time.monotonic() > give_up_s:
                raise RunFailed(f'the twin says nothing for {REPORT_S:g} s', TWIN_MISSING)
            time.sleep(POLL_S)

    def check(self) -> None:
        """Return if the twin has lived since it was given its object.

        Raises
        ------
        RunFailed
            TWIN_MISSING.
        """
        if self._life.losses != self._losses:
            raise RunFailed('the twin ended before the run did', TWIN_MISSING)

    def release(self, deadline_s: float) -> None:
        """Have the object let go: the fingers have closed their grasp.

        Raises
        ------
        RunFailed
            TWIN_MISSING, or what the twin says.
        """
        answer = call(
            self._release,
            Command.Request(),
            deadline_s=deadline_s,
            who='the twin',
            missing_code=TWIN_MISSING,
        )
        if answer.error_code:
            raise RunFailed(f'twin: {answer.error_msg}', answer.error_code)

    def _receive(self, state: ObjectState) -> None:
        """Keep a report."""
        stamp_ns = state.header.stamp.sec * NS_PER_S + state.header.stamp.nanosec
        if stamp_ns < self._loaded_ns:
            return
        self._report = ObjectReport(
            arrived_s=time.monotonic(),
            stamp_ns=stamp_ns,
            pose=pose_from_msg(state.pose),
            held=state.held,
            released=state.released,
            lost_because=state.lost_because,
        )
