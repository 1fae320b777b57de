# SPDX-License-Identifier: Apache-2.0
"""The node `sequencer`: executes plans on request, and stops when told to."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from microhand_msgs_py.action import ExecutePlan, Reorient
from microhand_msgs_py.msg import ErrorCode, ObjectDeviation, Plan, RunEvent, SequencerState
from microhand_msgs_py.srv import Command, PlanRotation
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import ParameterException
from rclpy.time import Time

from microhand_node.inbox import Inbox
from microhand_node.lean_node import LeanNode
from microhand_node.life_sign import give_life_sign
from microhand_node.qos import EVENTS, LATCHED, STATE
from microhand_node.run_node import run_node
from microhand_node.steady_thread import SteadyThread
from microhand_node.workers import Workers
from microhand_planner.core.errors import (
    BadRequest,
    InvalidParameter,
    MicrohandError,
    RunFailed,
)
from microhand_planner.core.plan import FINGERS
from microhand_planner.ros.conversions import UM_PER_M
from microhand_station.config import StationConfig, read_config
from microhand_station.message_note import message_note
from microhand_station.sequencer.emergency import confirm_stop, release_stages
from microhand_station.sequencer.execution import Execution, Grasp, Order, Outcome
from microhand_station.sequencer.object_watch import Deviation
from microhand_station.sequencer.planner_link import PlannerLink
from microhand_station.sequencer.progress import Progress
from microhand_station.sequencer.recorder_link import RecorderLink
from microhand_station.sequencer.run_control import CANCELLED, RunControl
from microhand_station.sequencer.stage_link import StageLink
from microhand_station.sequencer.states import Event, State
from microhand_station.sequencer.twin_link import TwinLink

INBOX_PERIOD_S = 0.01
"""Between two looks at what stages and twin report [s]; a stage reports as often."""
TELL_PERIOD_S = 0.1
"""Feedback and state are published no more often than this, but for the last one [s]."""


class SequencerNode(LeanNode):
    """Executes plans, one at a time.

    ::

                start             begin             pause
        IDLE ----------> STARTING ------> RUNNING <-------> PAUSED
         ^                  |              |   |     resume   |
         |       stop       |     done     |   | stop         | stop
         +------------------+<-------------+   v              v
         |                                  STOPPING <--------+
         +<---- done --------------------------+
         |
         +<---- reset ---- EMERGENCY <---- emergency, from every state

    The same, with what may happen when, as code: `sequencer.states`.

    Actions ``~/execute_plan`` and ``~/reorient``; services ``~/pause``, ``~/resume``,
    ``~/emergency_stop``, ``~/reset``; topics ``~/state``, ``~/object_deviation``, ``events`` and
    ``plan``, that of the present run or of the last one. The parameter `config` is the path of the
    station file; the defaults are those of `StationConfig`.
    """

    def __init__(self, **node_options: Any) -> None:
        super().__init__('sequencer', **node_options)
        give_life_sign(self)
        self.declare_parameter(
            'config',
            '',
            ParameterDescriptor(description='path of the station file; empty: the defaults'),
        )
        self._config = self._read_config()
        self._progress = Progress()
        self._plan_hash = ''
        self._state = self.create_publisher(SequencerState, '~/state', LATCHED)
        self._plan = self.create_publisher(Plan, 'plan', LATCHED)
        self._events = self.create_publisher(RunEvent, 'events', EVENTS)
        self._deviation = self.create_publisher(ObjectDeviation, '~/object_deviation', STATE)
        self._control = RunControl(self._publish_state)
        inbox = Inbox(self)
        self._listening = SteadyThread(inbox.empty, period_s=INBOX_PERIOD_S, name='inbox')
        self._stages = [
            StageLink(self, inbox, finger, config)
            for finger, config in enumerate(self._config.fingers, start=1)
        ]
        self._recorder = RecorderLink(self)
        self._planner = PlannerLink(self)
        self._twin = TwinLink(self, inbox) if self._config.twin.enabled else None
        self._grasp = Grasp()
        self._workers: Workers[Any] = Workers(self, threads=3)
        self._running: ServerGoalHandle | None = None
        self._told_s = -math.inf
        for action, name, execute in (
            (ExecutePlan, '~/execute_plan', self._execute_plan),
            (Reorient, '~/reorient', self._reorient),
        ):
            ActionServer(self, action, name, execute, cancel_callback=self._cancel)
        for name, command in (
            ('pause', self._control.pause),
            ('resume', self._control.resume),
            ('reset', self._reset),
        ):
            # a coroutine holds its group until it is done; the answers it waits for need another
            self.create_service(
                Command,
                f'~/{name}',
                self._answer(command),
                callback_group=ReentrantCallbackGroup(),
            )
        self.create_service(
            Command,
            '~/emergency_stop',
            self._stop_everything,
            callback_group=ReentrantCallbackGroup(),
        )
        self._publish_state(State.IDLE)
        self._listening.start()

    def wind_down(self) -> bool:
        """Let a run that is under way come to rest; return whether there is one."""
        self._control.cancel()
        return self._running is not None

    def destroy_node(self) -> None:
        """End the threads, then destroy the node."""
        self._control.cancel()
        self._workers.shut_down()
        self._listening.stop()
        super().destroy_node()

    def _read_config(self) -> StationConfig:
        """Return the station that the parameter names."""
        path: str = self.get_parameter('config').value
        try:
            return read_config(Path(path)) if path else StationConfig()
        except BadRequest as error:
            raise ParameterException(str(error), ['config']) from error

    async def _execute_plan(self, goal: ServerGoalHandle) -> ExecutePlan.Result:
        """Execute the plan of a goal."""
        request = goal.request

        def work() -> ExecutePlan.Result:
            order = Order(
                request.plan, request.run_name, request.object, request.unit, _asked(request)
            )
            outcome = self._run(goal, order, _execution_feedback)
            return _fill_outcome(ExecutePlan.Result(), outcome)

        return await self._serve(goal, work, ExecutePlan.Result(final_error=math.nan))

    async def _reorient(self, goal: ServerGoalHandle) -> Reorient.Result:
        """Plan what a goal asks for, and execute it."""
        request = goal.request

        def work() -> Reorient.Result:
            began_s = time.monotonic()
            planning = Reorient.Feedback(phase=Reorient.Feedback.PLANNING, time_left=math.nan)
            goal.publish_feedback(planning)
            plan = self._planner.plan(
                PlanRotation.Request(
                    object=request.object,
                    unit=request.unit,
                    start_pose=request.start_pose,
                    goal_pose=request.goal_pose,
                    options=request.options,
                    start_tips=request.start_tips,
                ),
                self._control,
            )
            planned_s = time.monotonic() - began_s
            order = Order(
                plan, request.run_name, request.object, request.unit, message_note(request)
            )
            outcome = self._run(goal, order, _reorientation_feedback)
            result = Reorient.Result(plan=plan, planning_time=planned_s)
            return _fill_outcome(result, outcome)

        return await self._serve(goal, work, Reorient.Result(final_error=math.nan))

    async def _serve(self, goal: ServerGoalHandle, work: Callable[[], Any], result: Any) -> Any:
        """Have the work of a goal done by a worker, unless another goal is being executed."""
        try:
            self._control.fire(Event.START)
        except RunFailed as error:
            result.error_code, result.error_msg = error.code, str(error)
            goal.abort()
            return result
        self._running = goal
        try:
            result = await self._workers.submit(work)
        except MicrohandError as error:
            result.error_code, result.error_msg = error.code, str(error)
        except Exception as error:
            result.error_code = ErrorCode.INTERNAL
            result.error_msg = f'{type(error).__name__}: {error}; see the log of the sequencer'
            self.get_logger().error(result.error_msg)
        finally:
            self._control.finish()
            self._running = None
        if result.error_code == CANCELLED and goal.is_cancel_requested:
            goal.canceled()
        elif result.error_code:
            goal.abort()
        else:
            goal.succeed()
        return result

    def _run(
        self,
        goal: ServerGoalHandle,
        order: Order,
        feedback: Callable[[Progress], Any],
    ) -> Outcome:
        """Execute a plan in the present thread."""
        self._plan_hash = order.plan.plan_hash
        self._plan.publish(order.plan)

        def tell(progress: Progress) -> None:
            self._progress = progress
            at_end = progress.share >= 1.0
            if at_end or time.monotonic() - self._told_s >= TELL_PERIOD_S:
                self._told_s = time.monotonic()
                self._publish_state(self._control.state)
                goal.publish_feedback(feedback(progress))

        execution = Execution(
            self._stages,
            self._recorder,
            self._twin,
            self._config,
            self._control,
            self._grasp,
            now_ns=lambda: self.get_clock().now().nanoseconds,
            on_progress=tell,
            on_event=self._report,
            on_deviation=self._publish_deviation,
        )
        outcome = execution.run(order)
        self._grasp = execution.grasp
        self._plan_hash, self._progress = '', Progress()
        self._publish_state(self._control.state)
        return outcome

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        """Let the run of a goal end on a ramp."""
        if self._running is None or goal.goal_id != self._running.goal_id:
            return CancelResponse.REJECT
        self._control.cancel()
        return CancelResponse.ACCEPT

    def _answer(self, command: Callable[[], None]) -> Callable[..., Any]:
        """Return a service callback that has `command` done by a worker."""

        async def serve(_: Command.Request, response: Command.Response) -> Command.Response:
            try:
                await self._workers.submit(command)
            except MicrohandError as error:
                response.error_code, response.error_msg = error.code, str(error)
            return response

        return serve

    async def _stop_everything(
        self, request: Command.Request, response: Command.Response
    ) -> Command.Response:
        """Stop all stages before anything else, then latch the stop and wait for the stages."""
        asked = [stage.ask_to_stop() for stage in self._stages]

        def confirm() -> None:
            self._report('emergency stop', ErrorCode.EMERGENCY_STOP)
            confirm_stop(asked)

        self._control.fire(Event.EMERGENCY)
        return await self._answer(confirm)(request, response)

    def _reset(self) -> None:
        """Release the stages, and unlatch the emergency stop."""
        if self._running is not None:
            raise RunFailed('a run is under way', ErrorCode.NOT_ALLOWED)
        release_stages(self._stages)
        self._control.fire(Event.RESET)
        self._report('reset', ErrorCode.SUCCESS)

    def _publish_state(self, state: State) -> None:
        """Publish what the sequencer does."""
        progress = self._progress
        message = SequencerState(
            state=int(state),
            step=progress.step,
            steps=progress.steps,
            rotation=progress.rotation,
            progress=progress.share,
            time_left=progress.time_left_s,
            plan_hash=self._plan_hash,
        )
        message.header.stamp = self.get_clock().now().to_msg()
        self._state.publish(message)

    def _publish_deviation(self, off: Deviation) -> None:
        """Publish how far the object is from where the plan has it."""
        message = ObjectDeviation(angle=off.angle_rad, distance=off.distance_um / UM_PER_M)
        message.header.stamp = Time(nanoseconds=off.stamp_ns).to_msg()
        message.header.frame_id = self._config.frame
        self._deviation.publish(message)

    def _report(self, text: str, code: int) -> None:
        """Publish what is worth remembering."""
        if code:
            self.get_logger().error(text)
        event = RunEvent(source=self.get_fully_qualified_name(), error_code=code, text=text)
        event.header.stamp = self.get_clock().now().to_msg()
        self._events.publish(event)


def _asked(goal: ExecutePlan.Goal) -> dict[str, Any]:
    """Return what a plan was made for, as far as the goal tells it, and how it was sent here."""
    try:
        request = json.loads(goal.request_json or '{}')
    except ValueError as error:
        raise InvalidParameter('request_json', f'no JSON ({error})', 'a JSON object') from error
    if not isinstance(request, dict):
        raise InvalidParameter('request_json', repr(request)[:60], 'a JSON object')
    sent = {'object': goal.object, 'unit': goal.unit, 'run_name': goal.run_name}
    return {**request, **{name: value for name, value in sent.items() if value}}


def _fill_outcome(result: Any, outcome: Outcome) -> Any:
    """Fill in how a run ended."""
    result.error_code, result.error_msg = outcome.code, outcome.message
    result.record_file, result.record_error = outcome.record_file, outcome.record_error
    result.setpoints_sent = [outcome.setpoints_sent] * FINGERS
    result.duration = outcome.duration_s
    result.object_judged, result.held = outcome.judged, outcome.held
    result.final_error = outcome.final_error_rad
    return result


def _execution_feedback(progress: Progress) -> ExecutePlan.Feedback:
    """Return the feedback of an execution."""
    return ExecutePlan.Feedback(
        step=progress.step,
        steps=progress.steps,
        rotation=progress.rotation,
        progress=progress.share,
        time_left=progress.time_left_s,
    )


def _reorientation_feedback(progress: Progress) -> Reorient.Feedback:
    """Return the feedback of a reorientation that is being executed."""
    return Reorient.Feedback(
        phase=Reorient.Feedback.EXECUTING,
        step=progress.step,
        steps=progress.steps,
        rotation=progress.rotation,
        progress=progress.share,
        time_left=progress.time_left_s,
    )


def main(args: Sequence[str] | None = None) -> int:
    """Run the sequencer until SIGINT or SIGTERM; a run that is under way is brought to rest."""
    return run_node(SequencerNode, args, still_busy=SequencerNode.wind_down)


if __name__ == '__main__':
    sys.exit(main())
