# SPDX-License-Identifier: Apache-2.0
"""The node `planner`: services that plan, check plans and list objects. Nothing moves here."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from geometry_msgs.msg import Vector3
from microhand_msgs_py.msg import ErrorCode, ObjectInfo
from microhand_msgs_py.srv import ListObjects, PlanRotation, ValidatePlan
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from microhand_node.life_sign import give_life_sign
from microhand_node.run_node import run_node
from microhand_node.workers import Workers
from microhand_planner.core.catalogue import CatalogueEntry, find_part, list_objects
from microhand_planner.core.errors import MicrohandError
from microhand_planner.core.force_check import check_forces
from microhand_planner.core.parameters import Finger, check_number
from microhand_planner.core.part import Part
from microhand_planner.core.plan_check import InvalidStep, check_plan
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import angle_between_rad
from microhand_planner.core.section_curves import SectionCurves, section_curves
from microhand_planner.ros.conversions import (
    UM_PER_M,
    m_from_um,
    options_from_msg,
    plan_from_msg,
    plan_to_msg,
    pose_from_msg,
    rules_from_msg,
    tips_from_msg,
)

KEPT_PARTS = 16
"""Parts whose sections are kept for further requests."""
WORKERS = 2
"""A short request is not kept waiting by one search."""

Response = TypeVar('Response', PlanRotation.Response, ValidatePlan.Response, ListObjects.Response)


class PlannerNode(Node):
    """Plans on request. Work is done in threads, so that it always answers."""

    def __init__(self, **node_options: Any) -> None:
        super().__init__('planner', **node_options)
        give_life_sign(self)
        self.declare_parameter(
            'catalogue',
            '',
            ParameterDescriptor(
                description='folder of meshes with their descriptions; empty: the built-in one'
            ),
        )
        self.declare_parameter(
            'frame', 'station', ParameterDescriptor(description='frame_id of plans')
        )
        self._curves: dict[tuple[str, str, Finger], SectionCurves] = {}
        self._workers: Workers[object] = Workers(self, WORKERS)
        # a coroutine holds its group until it is done: each service has a group of its own
        for kind, name, serve in (
            (PlanRotation, 'plan_rotation', self._plan_rotation),
            (ValidatePlan, 'validate_plan', self._validate_plan),
            (ListObjects, 'list_objects', self._list_objects),
        ):
            self.create_service(kind, f'~/{name}', serve, callback_group=ReentrantCallbackGroup())

    def destroy_node(self) -> None:
        """End searches that are under way, then destroy the node."""
        self._workers.shut_down()
        super().destroy_node()

    async def _plan_rotation(
        self, request: PlanRotation.Request, response: PlanRotation.Response
    ) -> PlanRotation.Response:
        response.goal_error = float('nan')
        return await self._answer(self._fill_plan, request, response)

    async def _validate_plan(
        self, request: ValidatePlan.Request, response: ValidatePlan.Response
    ) -> ValidatePlan.Response:
        response.step = -1
        return await self._answer(self._fill_verdict, request, response)

    async def _list_objects(
        self, request: ListObjects.Request, response: ListObjects.Response
    ) -> ListObjects.Response:
        return await self._answer(self._fill_objects, request, response)

    async def _answer(
        self, fill: Callable[[object, Response], None], request: object, response: Response
    ) -> Response:
        """Have `fill` done by a worker; whatever goes wrong becomes a code and a sentence."""
        try:
            await self._workers.submit(lambda: fill(request, response))
        except MicrohandError as error:
            response.error_code, response.error_msg = error.code, str(error)
        except Exception as error:
            self.get_logger().error(f'unforeseen: {error!r}')
            response.error_code = ErrorCode.INTERNAL
            response.error_msg = f'{type(error).__name__}: {error}; see the log of the planner'
        return response

    def _fill_plan(self, request: PlanRotation.Request, response: PlanRotation.Response) -> None:
        began_s = time.monotonic()
        unit_um = check_number('unit', request.unit * UM_PER_M, low=0.0, high=1e9) or None
        start, goal = pose_from_msg(request.start_pose), pose_from_msg(request.goal_pose)
        finger, law, options = options_from_msg(request.options)
        part = find_part(request.object, unit_um=unit_um, folder=self._catalogue())
        plan = plan_reorientation(
            self._geometry(part, finger),
            start,
            goal,
            finger,
            law,
            options,
            rules_from_msg(request.options),
            start_tip_um=tips_from_msg(request.start_tips),
            cancelled=lambda: self._workers.stopping,
        )
        response.plan = plan_to_msg(plan, self.get_parameter('frame').value)
        response.plan.header.stamp = self.get_clock().now().to_msg()
        response.goal_error = angle_between_rad(plan.reached.rotation, goal.rotation)
        response.planning_time = time.monotonic() - began_s

    def _geometry(self, part: Part, finger: Finger) -> SectionCurves:
        """Return where tips can be around a part; the last few are kept."""
        key = (part.sha256, part.name, finger)
        if key not in self._curves:
            while len(self._curves) >= KEPT_PARTS:
                self._curves.pop(next(iter(self._curves)), None)
            self._curves[key] = section_curves(part, finger)
        return self._curves[key]

    def _fill_verdict(
        self, request: ValidatePlan.Request, response: ValidatePlan.Response
    ) -> None:
        try:
            plan = plan_from_msg(request.plan)
            check_plan(plan)
            check_forces(plan)
        except InvalidStep as error:
            response.step = error.step
            raise

    def _fill_objects(self, _request: ListObjects.Request, response: ListObjects.Response) -> None:
        response.objects = [self._describe(entry) for entry in list_objects(self._catalogue())]

    def _describe(self, entry: CatalogueEntry) -> ObjectInfo:
        part = find_part(entry.name, folder=self._catalogue())
        x, y, z = m_from_um(part.vertices_um.max(axis=0) - part.vertices_um.min(axis=0)).tolist()
        return ObjectInfo(
            name=entry.name,
            description=entry.description,
            mesh_file=str(entry.mesh_file),
            unit=entry.unit_um / UM_PER_M,
            frame=entry.frame,
            object_hash=part.sha256,
            size=Vector3(x=x, y=y, z=z),
        )

    def _catalogue(self) -> Path | None:
        folder: str = self.get_parameter('catalogue').value
        return Path(folder) if folder else None


def main(args: Sequence[str] | None = None) -> int:
    """Run the planner until SIGINT or SIGTERM."""
    return run_node(PlannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
