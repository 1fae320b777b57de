# SPDX-License-Identifier: Apache-2.0
"""The node `twin`: follows the stages, and says what the object does and what the fingers feel.

Stage states come in; contacts (``finger_N/contact``), the object (``object_state``), transforms
and markers go out. Nothing waits for a clock: the physics advances to the time up to which all
three stages have reported, as soon as they have. So it is behind by the period of their reports
and the way of a message, some ten milliseconds in all.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from microhand_msgs_py.msg import ErrorCode, ObjectState, StageState, TipContact
from microhand_msgs_py.srv import Command, LoadObject
from rclpy.callback_groups import ReentrantCallbackGroup
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from microhand_node.inbox import Inbox
from microhand_node.lean_node import LeanNode
from microhand_node.life_sign import give_life_sign
from microhand_node.qos import CONTACT, LATCHED, STATE
from microhand_node.run_node import run_node
from microhand_node.steady_thread import SteadyThread
from microhand_node.workers import Workers
from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import InvalidPlan, MicrohandError, RunFailed
from microhand_planner.core.parameters import check_number
from microhand_planner.core.part import Part
from microhand_planner.core.plan import FINGERS, Plan
from microhand_planner.ros.conversions import UM_PER_M, plan_from_msg, um_from_point
from microhand_twin.ros.conversions import object_state, tip_contacts
from microhand_twin.ros.display import finger_markers, object_marker, transforms
from microhand_twin.ros.follower import Follower
from microhand_twin.ros.live_world import LiveWorld, ObjectReport
from microhand_twin.ros.twin_parameters import declare_parameters, read_parameters
from microhand_twin.world import build_world

NS_PER_S = 1_000_000_000
CONTACT_PERIOD_S = 0.05
"""Contacts are reported at every change, and no less often than this [s]."""
INBOX_PERIOD_S = 0.005
"""Between two looks at what the stages report [s]: half a period of theirs."""
HEARD_S = 3.5
"""Longest wait for the first states of the stages [s]."""
TF_MESSAGES = 'tf2_msgs'
"""Has no wheel: only where ROS comes by apt transforms can be published."""


class TwinNode(LeanNode):
    """Stands in for the object of a simulated station.

    Services ``~/load`` and ``~/release``; topics ``object_state``, ``finger_N/contact``, ``/tf``,
    ``~/markers`` and ``~/object_marker``.
    """

    def __init__(self, **node_options: Any) -> None:
        super().__init__('twin', **node_options)
        give_life_sign(self)
        declare_parameters(self)
        self._station = read_parameters(self)
        self._begin_ns = self.get_clock().now().nanoseconds
        self._touching: tuple[bool, ...] = ()
        self._told_s = dict.fromkeys(('contact', 'state', 'display'), -math.inf)
        self._lost_because = ''
        self._part: Part | None = None
        self._radius_um = 0.0
        self._state = self.create_publisher(ObjectState, 'object_state', STATE)
        self._contacts = [
            self.create_publisher(TipContact, f'finger_{finger}/contact', CONTACT)
            for finger in range(1, FINGERS + 1)
        ]
        self._markers = self.create_publisher(MarkerArray, '~/markers', STATE)
        self._object_marker = self.create_publisher(MarkerArray, '~/object_marker', LATCHED)
        self._publish_transforms = self._transform_publisher()
        self._follower = Follower(self._tell, self.get_logger().fatal)
        self._workers: Workers[None] = Workers(self, threads=1)
        inbox = Inbox(self)
        for finger in range(1, FINGERS + 1):
            inbox.subscribe(
                StageState, f'finger_{finger}/state', partial(self._hear, finger), STATE
            )
        self._listening = SteadyThread(inbox.empty, period_s=INBOX_PERIOD_S, name='inbox')
        # a coroutine holds its group until it is done
        for kind, name, serve in (
            (LoadObject, '~/load', self._load),
            (Command, '~/release', self._release),
        ):
            self.create_service(
                kind, name, partial(self._answer, serve), callback_group=ReentrantCallbackGroup()
            )
        self._follower.start()
        self._listening.start()

    def destroy_node(self) -> None:
        """End the threads, then destroy the node."""
        self._workers.shut_down()
        self._listening.stop()
        self._follower.stop()
        super().destroy_node()

    async def _answer(
        self, serve: Callable[[Any], None], request: Any, response: Any
    ) -> LoadObject.Response | Command.Response:
        """Have a request served by a worker; whatever goes wrong becomes a code and a sentence."""
        try:
            await self._workers.submit(lambda: serve(request))
        except MicrohandError as error:
            response.error_code, response.error_msg = error.code, str(error)
        except Exception as error:
            self.get_logger().error(f'unforeseen: {error!r}')
            response.error_code = ErrorCode.INTERNAL
            response.error_msg = f'{type(error).__name__}: {error}; see the log of the twin'
        return response

    def _load(self, request: LoadObject.Request) -> None:
        """Put the object of a plan where the plan begins, unless it is held there already."""
        plan = plan_from_msg(request.plan)
        self._follower.wait_until_heard(HEARD_S)
        begins_held = bool(plan.steps) and any(plan.steps[0].in_contact)
        if begins_held and self._follower.ask(partial(_holds, plan)):
            return
        unit_um = check_number('unit', request.unit * UM_PER_M, low=0.0, high=1e9) or None
        parameters = read_parameters(self)
        part = find_part(
            request.object or plan.object_name,
            unit_um=unit_um,
            folder=Path(parameters.catalogue) if parameters.catalogue else None,
        )
        if part.sha256 != plan.object_sha256:
            raise InvalidPlan('object_hash', plan.object_sha256, f'{part.sha256} for {part.name}')
        world = build_world(
            part,
            law=parameters.true_law(plan.law),
            finger_radius_um=plan.finger.radius_um,
            stiffness_uN_per_um=parameters.stiffness_uN_per_um.tolist(),
        )
        holding_um = np.full((FINGERS, 3), np.nan)
        if begins_held:
            holding = np.array(plan.steps[0].in_contact)
            holding_um[holding] = plan.steps[0].tip_um[0, holding]
        self._station, self._part = parameters, part
        self._radius_um = plan.finger.radius_um
        self._follower.adopt(LiveWorld(world, plan.start, holding_um))
        stamp = self.get_clock().now().to_msg()
        self._object_marker.publish(object_marker(stamp, parameters, part))

    def _release(self, _: Command.Request) -> None:
        """Leave the object to the fingers."""

        def let_go(world: LiveWorld | None) -> None:
            if world is None:
                raise RunFailed('no object is loaded', ErrorCode.NOT_ALLOWED)
            world.release()

        self._follower.ask(let_go)

    def _hear(self, finger: int, state: StageState) -> None:
        """Take in where a stage is."""
        stamp = state.header.stamp
        time_s = (stamp.sec * NS_PER_S + stamp.nanosec - self._begin_ns) / NS_PER_S
        tip_um = self._station.base_um[finger - 1] + um_from_point(state.position)
        self._follower.hear(finger, time_s, tip_um)

    def _tell(self, time_s: float, report: ObjectReport | None) -> None:
        """Publish what is due; called by the thread of the physics."""
        ns = self._begin_ns + round(time_s * NS_PER_S)
        stamp = Time(sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)
        header = Header(stamp=stamp, frame_id=self._station.frame)
        contacts = None if report is None else report.contacts
        touching = () if contacts is None else tuple(contacts.touching.tolist())
        if touching != self._touching or self._is_due('contact', time_s, CONTACT_PERIOD_S):
            self._touching = touching
            self._told_s['contact'] = time_s
            for publisher, message in zip(
                self._contacts, tip_contacts(header, contacts), strict=True
            ):
                publisher.publish(message)
        if report is None:
            return
        lost_now = report.lost_because != self._lost_because
        if lost_now or self._is_due('state', time_s, self._station.state_period_s):
            self._lost_because = report.lost_because
            if lost_now and report.lost_because:
                self.get_logger().error(f'the object is lost: {report.lost_because}')
            self._told_s['state'] = time_s
            self._state.publish(object_state(header, report, self._radius_um))
        if self._is_due('display', time_s, self._station.display_period_s):
            self._told_s['display'] = time_s
            self._publish_transforms(stamp, report)
            if self._markers.get_subscription_count():
                self._markers.publish(
                    finger_markers(stamp, self._station, report, self._radius_um)
                )

    def _is_due(self, what: str, time_s: float, period_s: float) -> bool:
        return time_s >= self._told_s[what] + period_s - 1e-6

    def _transform_publisher(self) -> Callable[[Time, ObjectReport], None]:
        """Return what publishes transforms: nothing, where their message is not installed."""
        if importlib.util.find_spec(TF_MESSAGES) is None:
            self.get_logger().info(f'{TF_MESSAGES} is not installed: no transforms on /tf')
            return lambda stamp, report: None
        kind = importlib.import_module(f'{TF_MESSAGES}.msg').TFMessage
        publisher = self.create_publisher(kind, '/tf', STATE)

        def publish(stamp: Time, report: ObjectReport) -> None:
            frames = transforms(stamp, self._station, report)
            publisher.publish(kind(transforms=frames))

        return publish


def _holds(plan: Plan, world: LiveWorld | None) -> bool:
    """Return whether the object of a plan is held where the plan begins."""
    return world is not None and world.holds(plan.object_sha256, plan.start)


def main() -> None:
    """Run the twin as a process."""
    sys.exit(run_node(TwinNode))


if __name__ == '__main__':
    main()
