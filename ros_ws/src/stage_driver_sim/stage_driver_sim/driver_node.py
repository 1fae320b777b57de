# SPDX-License-Identifier: Apache-2.0
"""The node of one stage: converts messages and services to calls of the control loop, and back.

Managed: ``configure`` reads the parameters and powers the stage up, ``activate`` closes its servo
and starts the control loop, ``deactivate`` brings it to rest and ends the loop.
"""

from __future__ import annotations

import gc
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial, wraps
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from microhand_msgs_py.msg import ErrorCode, RunEvent, SetpointChunk, StageState, TipContact
from microhand_msgs_py.srv import Command, GetStageLimits, SetServo
from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from microhand_node import qos
from microhand_node.inbox import Inbox
from microhand_node.lean_node import LeanNode
from microhand_node.life_sign import give_life_sign
from microhand_node.run_node import run_node
from microhand_node.steady_thread import SteadyThread
from stage_driver_sim.control_loop import ControlLoop, LoopTiming
from stage_driver_sim.controller import StageController
from stage_driver_sim.conversions import (
    ClockMap,
    chunk_from_message,
    contact_from_message,
    event_message,
    fill_limits,
    state_message,
)
from stage_driver_sim.diagnostics import stage_status
from stage_driver_sim.driver_parameters import (
    DriverParameters,
    declare_parameters,
    read_fault,
    read_parameters,
)
from stage_driver_sim.errors import StageError
from stage_driver_sim.faults import FaultyStage
from stage_driver_sim.realtime import run_first
from stage_driver_sim.remote_stage import RemoteStage
from stage_driver_sim.stage_choice import power_up

DIAGNOSTICS_PERIOD_S = 1.0
SWITCH_INTERVAL_S = 0.0001
"""How long other threads may keep the interpreter from the control loop; Python allows 5 ms."""

Response = TypeVar('Response', Command.Response, SetServo.Response)

TransitionCallback = Callable[['StageDriverNode', LifecycleState], TransitionCallbackReturn]


def _logged(transition: TransitionCallback) -> TransitionCallback:
    """Log what breaks a transition: rclpy turns every exception into a bare ERROR."""

    @wraps(transition)
    def logged(node: StageDriverNode, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(node, state)
        except Exception:
            node.get_logger().fatal(traceback.format_exc())
            raise

    return logged


class StageDriverNode(LeanNode, LifecycleNode):
    """Driver of one stage.

    Parameters
    ----------
    node_options
        Passed on to `LifecycleNode`, e.g. ``context``.
    """

    def __init__(self, **node_options: Any) -> None:
        super().__init__('stage_driver', **node_options)
        give_life_sign(self)
        declare_parameters(self)
        self._configured: DriverParameters | None = None
        self._stage: FaultyStage | RemoteStage | None = None
        self._loop: ControlLoop | None = None
        self._clock_map = ClockMap(0)
        self._reporter: SteadyThread | None = None
        self._scheduling = ''
        self._state = self.create_lifecycle_publisher(StageState, 'state', qos.STATE)
        self._events = self.create_publisher(RunEvent, 'events', qos.EVENTS)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', qos.DIAGNOSTICS)
        self._inbox = Inbox(self)
        self._inbox.subscribe(SetpointChunk, 'setpoints', self._on_chunk, qos.SETPOINTS)
        self._inbox.subscribe(TipContact, 'contact', self._on_contact, qos.CONTACT)
        for name, action in (
            ('stop', StageController.stop),
            ('home', StageController.home),
            ('reset', StageController.reset),
        ):
            self.create_service(Command, f'~/{name}', partial(self._on_command, action))
        self.create_service(SetServo, '~/set_servo', self._on_set_servo)
        self.create_service(GetStageLimits, '~/get_limits', self._on_get_limits)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics)
        self.add_on_set_parameters_callback(self._check_fault)
        self.add_post_set_parameters_callback(self._on_parameters_set)
        # rclpy lets a transition that does not exist in the present state end the process.
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    @_logged
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters and power the stage up."""
        if self.get_clock().ros_time_is_active:  # a stage moves in real time
            self.get_logger().error('use_sim_time is true; allowed: false')
            return TransitionCallbackReturn.FAILURE
        try:
            fault = read_fault(self)
            self._configured = read_parameters(self)
            self._stage = _power_up(self._configured)
        except StageError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        if isinstance(self._stage, FaultyStage):
            self._stage.set_fault(fault, time.monotonic())
        return super().on_configure(state)

    @_logged
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the servo where the stage stands and start the control loop."""
        if self._configured is None or self._stage is None:
            return TransitionCallbackReturn.FAILURE
        self._clock_map = ClockMap(self.get_clock().now().nanoseconds - time.monotonic_ns())
        try:
            controller = StageController(
                self._stage,
                name=f'finger_{self._configured.finger}',
                settings=self._configured.settings,
                now_s=time.monotonic(),
            )
        except StageError as error:
            self.get_logger().error(f'the stage cannot be taken over: {error}')
            return TransitionCallbackReturn.FAILURE
        self._inbox.empty()  # what was sent to an inactive driver is not for an active one
        self._loop = ControlLoop(
            controller, period_s=self._configured.control_period_s, look_for_work=self._inbox.empty
        )
        report = partial(self._report, self._loop, f'finger_{self._configured.finger}_base')
        self._reporter = SteadyThread(
            report, period_s=self._configured.state_period_s, name='reporter'
        )
        activated = super().on_activate(state)
        self._loop.start()
        self._reporter.start()
        self._scheduling = self._schedule(self._loop, self._configured.realtime_priority)
        return activated

    @_logged
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the stage to rest and end the control loop; the servo keeps holding."""
        self._end_loop()
        return super().on_deactivate(state)

    @_logged
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the stage."""
        self._power_down()
        return super().on_cleanup(state)

    @_logged
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the stage to rest and let go of it."""
        self._end_loop()
        self._power_down()
        return super().on_shutdown(state)

    @_logged
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a transition that broke: let go of the stage, ready to be configured again."""
        self._end_loop()
        self._power_down()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Bring the stage to rest, let go of it as it stands, then destroy the node."""
        self._end_loop()
        if self._stage is not None:
            self._stage.close()
        super().destroy_node()

    def _schedule(self, loop: ControlLoop, priority: int) -> str:
        """Have the loop run before others, and return how it is scheduled."""
        if priority == 0:
            return 'ordinary'
        refused = run_first(loop.thread_id, priority)
        if not refused:
            return f'FIFO {priority}'
        self.get_logger().warning(
            f'no real-time priority, setpoints may be late on a busy machine: {refused}; '
            'realtime_priority 0 does not ask for it'
        )
        return f'ordinary: {refused}'

    def _end_loop(self) -> None:
        if self._loop is not None and self._reporter is not None:
            self._loop.stop()
            self._reporter.stop()
        self._loop = self._reporter = None

    def _power_down(self) -> None:
        if self._stage is not None:
            try:
                self._stage.set_servo(False, time.monotonic())
            except StageError as error:
                self.get_logger().warning(f'the servo could not be switched off: {error}')
            self._stage.close()
        self._stage = None
        self._configured = None

    def _check_fault(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse to let a stage go wrong that is not simulated."""
        driver = self.get_parameter('driver').value
        for parameter in parameters:
            if parameter.name == 'fault' and parameter.value != 'none' and driver != 'simulated':
                reason = f'fault is {parameter.value!r}; allowed with driver {driver}: none'
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _on_parameters_set(self, parameters: list[Parameter]) -> None:
        """Let the stage do wrong what it shall."""
        stage = self._stage
        if not isinstance(stage, FaultyStage):
            return
        if any(parameter.name.startswith('fault') for parameter in parameters):
            fault = read_fault(self)
            if self._loop is None:
                stage.set_fault(fault, time.monotonic())
            else:
                self._loop.tell(lambda _, now_s: stage.set_fault(fault, now_s))

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            return self._change_state(request, response)
        except RuntimeError as error:
            self.get_logger().error(f'transition {request.transition.id} refused: {error}')
            response.success = False
            return response

    def _on_chunk(self, message: SetpointChunk) -> None:
        if self._loop is None:
            self.get_logger().warning('not active: setpoints ignored', throttle_duration_sec=1.0)
            return
        try:
            chunk = chunk_from_message(message, self._clock_map)
        except StageError as error:
            refusal = error
            self._loop.tell(lambda controller, now_s: controller.refuse(refusal, now_s))
        else:
            self._loop.tell(lambda controller, now_s: controller.accept(chunk, now_s))

    def _on_contact(self, message: TipContact) -> None:
        if self._loop is not None:
            report = contact_from_message(message, self._clock_map)
            self._loop.tell(lambda controller, _: controller.note_contact(report))

    def _on_command(
        self,
        action: Callable[[StageController, float], None],
        request: Command.Request,
        response: Command.Response,
    ) -> Command.Response:
        return self._ask(action, response)

    def _on_set_servo(
        self, request: SetServo.Request, response: SetServo.Response
    ) -> SetServo.Response:
        return self._ask(
            lambda controller, now_s: controller.set_servo(request.enabled, now_s), response
        )

    def _on_get_limits(
        self, request: GetStageLimits.Request, response: GetStageLimits.Response
    ) -> GetStageLimits.Response:
        if self._stage is None:
            response.error_code = ErrorCode.STAGE_MISSING
            response.error_msg = f'{self.get_fully_qualified_name()} is not configured'
            return response
        return fill_limits(response, self._stage.limits, self._stage.hardware_id)

    def _ask(
        self, action: Callable[[StageController, float], None], response: Response
    ) -> Response:
        """Have the control loop do `action`; report what came of it in `response`."""
        if self._loop is None:
            response.error_code = ErrorCode.STAGE_MISSING
            response.error_msg = f'{self.get_fully_qualified_name()} is not active'
            return response
        try:
            self._loop.ask(action)
        except StageError as error:
            response.error_code = error.code
            response.error_msg = str(error)
        return response

    def _report(self, loop: ControlLoop, frame_id: str) -> None:
        """Publish state and events; called by the thread of the reporter."""
        self._state.publish(state_message(loop.snapshot(), self._clock_map, frame_id))
        for event in loop.take_events():
            if event.code != ErrorCode.SUCCESS:
                self.get_logger().error(event.text)
            self._events.publish(
                event_message(event, self._clock_map, self.get_fully_qualified_name())
            )

    def _publish_diagnostics(self) -> None:
        loop = self._loop
        if loop is None:
            self._inbox.empty()
        status = stage_status(
            self.get_fully_qualified_name(),
            '' if self._stage is None else self._stage.hardware_id,
            None if loop is None else loop.snapshot(),
            LoopTiming() if loop is None else loop.take_timing(),
            self._scheduling,
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def _power_up(parameters: DriverParameters) -> FaultyStage | RemoteStage:
    """Return the stage that the parameters describe."""
    return power_up(parameters, time.monotonic())


def main() -> None:
    """Run the driver as a process."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.freeze()  # what is imported stays: looking through it would stop the control loop
    sys.exit(run_node(StageDriverNode))
