# SPDX-License-Identifier: Apache-2.0
"""The planner as the sequencer sees it."""

from __future__ import annotations

import threading
import time

from microhand_msgs_py.msg import ErrorCode, Plan
from microhand_msgs_py.srv import PlanRotation
from rclpy.node import Node

from microhand_node.life_sign import LifeSign
from microhand_planner.core.errors import RunFailed
from microhand_station.sequencer.run_control import RunControl
from microhand_station.service_call import GONE_S, POLL_S, greet

FIND_S = 4.0
"""Longest wait for the planner to be there; a new one is found after up to 3 s [s]."""


class PlannerLink:
    """The sequencer's end of the connection to the planner.

    Parameters
    ----------
    node : Node
        Of the sequencer.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._life = LifeSign(node, 'planner')
        self._client = node.create_client(PlanRotation, 'planner/plan_rotation')

    def plan(self, request: PlanRotation.Request, control: RunControl) -> Plan:
        """Ask for a plan and wait for it, as long as the caller wants it and the planner is there.

        Raises
        ------
        RunFailed
            What the planner says, CANCELLED, or that the planner is gone.
        """
        control.check_orders()
        greet(
            self._node,
            'planner',
            deadline_s=FIND_S,
            who='the planner',
            missing_code=ErrorCode.PLANNER_MISSING,
        )
        losses, seen_s = self._life.losses, time.monotonic()
        answered = threading.Event()
        future = self._client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        try:
            while not answered.wait(POLL_S):
                control.check_orders()
                if self._client.service_is_ready():
                    seen_s = time.monotonic()
                if self._life.losses != losses or time.monotonic() > seen_s + GONE_S:
                    raise RunFailed(
                        'the planner ended before it answered', ErrorCode.PLANNER_MISSING
                    )
        finally:
            self._client.remove_pending_request(future)
        answer = future.result()
        if answer.error_code:
            raise RunFailed(answer.error_msg, answer.error_code)
        return answer.plan
