# SPDX-License-Identifier: Apache-2.0
"""A station from Python: plan, execute, watch the progress, stop. Used by the command line."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from microhand_msgs_py.action import ExecutePlan
from microhand_msgs_py.msg import ErrorCode
from microhand_msgs_py.srv import Command, PlanRotation
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from microhand_node.lean_node import LeanNode
from microhand_node.life_sign import LifeSign
from microhand_planner.core.errors import BadRequest, RunFailed
from microhand_planner.core.parameters import (
    ROBUST_RULES,
    ContactLaw,
    Finger,
    GripRules,
    SearchOptions,
)
from microhand_planner.core.plan import Plan
from microhand_planner.core.pose import FloatArray, Pose
from microhand_planner.ros.conversions import (
    UM_PER_M,
    options_to_msg,
    plan_from_msg,
    plan_to_msg,
    point_from_um,
    pose_to_msg,
)
from microhand_station.client_answers import ExecutionResult, PlanAnswer, StationError
from microhand_station.message_note import message_note
from microhand_station.sequencer.progress import Progress
from microhand_station.service_call import GONE_S, POLL_S, call, greet

MISSING = {'planner': ErrorCode.PLANNER_MISSING, 'sequencer': ErrorCode.SEQUENCER_MISSING}
"""Error codes: the node does not answer, or ended before it did."""
COMMANDS = ('pause', 'resume', 'emergency_stop', 'reset')
"""Services of the sequencer; known from the begin, since a stop has no time to look for one."""
ANSWER_S = 5.0
"""Longest wait for an answer that needs no work [s]."""
SPIN_S = 0.05


class StationClient:
    """A connection to one station; spins in a thread of its own, so every method just waits.

    Parameters
    ----------
    namespace : str
        Of the station.
    domain_id : int or None
        ROS domain; None: that of the environment.
    name : str
        Of its node.
    arguments : sequence of str, optional
        Command line with ROS arguments: names and parameters of the node.
    pace_s : float
        Rest after each callback [s]: whoever looks at topics by DISPLAY need not hear everything.

    Examples
    --------
    ::

        with StationClient() as station:
            answer = station.plan('ellipsoid', Pose(), goal)
            station.execute(answer.plan, on_progress=lambda p: print(p.step, p.steps))
    """

    def __init__(
        self,
        namespace: str = '',
        domain_id: int | None = None,
        *,
        name: str = 'microhand_client',
        arguments: Sequence[str] = (),
        pace_s: float = 0.0,
    ) -> None:
        self._context = Context()
        rclpy.init(
            args=list(arguments),
            context=self._context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = LeanNode(name, namespace=namespace, context=self._context)
        """For what else is to be asked of the station; spun by the client."""
        self._life = {name: LifeSign(self.node, name) for name in ('planner', 'sequencer')}
        self._plan = self.node.create_client(PlanRotation, 'planner/plan_rotation')
        self._execute = ActionClient(self.node, ExecutePlan, 'sequencer/execute_plan')
        self._commands = {
            name: self.node.create_client(Command, f'sequencer/{name}') for name in COMMANDS
        }
        self._ready = {
            'planner': self._plan.service_is_ready,
            'sequencer': self._execute.server_is_ready,
        }
        self._met: dict[str, int] = {}
        self._requests: dict[str, str] = {}
        self._goal: Any = None
        self._closing = threading.Event()
        self._pace_s = pace_s
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._spinner = threading.Thread(target=self._spin, name='station client')
        self._spinner.start()

    def __enter__(self) -> StationClient:
        """Return the client itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the connection."""
        self.close()

    def close(self) -> None:
        """Leave the station; a run that is under way goes on."""
        if not self._closing.is_set():
            self._closing.set()
            self._spinner.join()
            self._executor.shutdown()
            self._execute.destroy()
            self.node.destroy_node()
            rclpy.shutdown(context=self._context)

    def wait_until_ready(self, deadline_s: float) -> None:
        """Return when planner and sequencer are there.

        Raises
        ------
        RunFailed
            One of them is not, when the time is over.
        """
        for server in ('planner', 'sequencer'):
            self._meet(server, deadline_s)

    def has_died(self, server: str) -> bool:
        """Whether `planner` or `sequencer` has ended, or died, and is not there again."""
        return self._life[server].dead

    def count_nodes(self, name: str) -> int:
        """Return how many nodes of this name, relative to the station, are to be seen."""
        full_name = f'{self.node.get_namespace().rstrip("/")}/{name}'
        return sum(
            f'{namespace.rstrip("/")}/{node}' == full_name
            for node, namespace in self.node.get_node_names_and_namespaces()
        )

    def plan(
        self,
        object_name: str,
        start: Pose,
        goal: Pose,
        *,
        unit_um: float = 0.0,
        finger: Finger | None = None,
        law: ContactLaw | None = None,
        options: SearchOptions | None = None,
        rules: GripRules | Sequence[GripRules] = ROBUST_RULES,
        start_tip_um: FloatArray | None = None,
        words: str = '',
    ) -> PlanAnswer:
        """Have a reorientation planned; nothing moves.

        Parameters
        ----------
        object_name : str
            Catalogue name, or path of a mesh file on the planner's machine.
        start, goal : Pose
            Object in the station frame.
        unit_um : float
            Length of one unit of the mesh [µm]; 0: the catalogue's, or 1 µm.
        finger, law, options, rules
            Default: those of the classes.
        start_tip_um : (3, 3) float, optional
            Tip centres of fingers that hold the object now, station frame [µm]; NaN: free.
        words : str
            The rotation as a person asked for it, for the record: angles have many names.

        Raises
        ------
        StationError
            With the planner's code and sentence.
        """
        options = options or SearchOptions()
        request = PlanRotation.Request(
            object=object_name,
            unit=unit_um / UM_PER_M,
            start_pose=pose_to_msg(start),
            goal_pose=pose_to_msg(goal),
            options=options_to_msg(finger or Finger(), law or ContactLaw(), options, rules),
            start_tips=[] if start_tip_um is None else [point_from_um(t) for t in start_tip_um],
        )
        losses = self._meet('planner', ANSWER_S)
        answer = self._result(self._plan.call_async(request), 'planner', losses)
        if answer.error_code:
            raise StationError(answer.error_msg, answer.error_code)
        noted = {**message_note(request), **({'words': words} if words else {})}
        self._requests[answer.plan.plan_hash] = json.dumps(noted)
        return PlanAnswer(plan_from_msg(answer.plan), answer.planning_time, answer.goal_error)

    def execute(
        self,
        plan: Plan,
        run_name: str = '',
        on_progress: Callable[[Progress], None] | None = None,
        *,
        object_name: str = '',
        unit_um: float = 0.0,
    ) -> ExecutionResult:
        """Execute a plan and wait until the stages are on target and the object is held.

        The record tells what the plan was made for if this client had it made.

        Parameters
        ----------
        plan : Plan
            Checked by the sequencer before anything moves.
        run_name : str
            Of the record; empty: made from the time.
        on_progress : callable, optional
            Told several times a second, in the client's own thread.
        object_name : str
            Where the twin finds the object: catalogue name, or path of a mesh file on the twin's
            machine; empty: the plan's name for it.
        unit_um : float
            Length of one unit of the mesh [µm]; 0: the catalogue's, or 1 µm.

        Raises
        ------
        StationError
            With the sequencer's code and sentence. Interrupting the call cancels the run.
        """

        def tell(message: Any) -> None:
            if on_progress is not None:
                on_progress(_progress(message.feedback))

        losses = self._meet('sequencer', ANSWER_S)
        self._wait_for_actions(ANSWER_S)
        goal = ExecutePlan.Goal(
            plan=plan_to_msg(plan), run_name=run_name, object=object_name, unit=unit_um / UM_PER_M
        )
        goal.request_json = self._requests.get(goal.plan.plan_hash, '')
        self._goal = self._ask(lambda: self._execute.send_goal_async(goal, tell), losses)
        try:
            answer = self._ask(self._goal.get_result_async, losses).result
        except KeyboardInterrupt:
            self.cancel()
            raise
        finally:
            self._goal = None
        result = ExecutionResult(
            record_file=Path(answer.record_file) if answer.record_file else None,
            setpoints_sent=int(answer.setpoints_sent[0]),
            duration_s=answer.duration,
            held=answer.held if answer.object_judged else None,
            final_error_rad=None if math.isnan(answer.final_error) else answer.final_error,
            record_error=answer.record_error,
        )
        if answer.error_code:
            raise StationError(answer.error_msg, answer.error_code, result)
        return result

    def cancel(self) -> None:
        """Let the run that this client started come to rest and hold; return when it is asked."""
        if self._goal is not None:
            self._ask(self._goal.cancel_goal_async, self._life['sequencer'].losses)

    def command(self, name: str) -> None:
        """Send a command to the sequencer: pause, resume, emergency_stop or reset.

        Raises
        ------
        BadRequest
            There is no such command.
        StationError
            The sequencer refuses.
        """
        if name not in self._commands:
            raise BadRequest('command', repr(name), ', '.join(COMMANDS))
        self._meet('sequencer', ANSWER_S)
        answer = call(
            self._commands[name],
            Command.Request(),
            deadline_s=ANSWER_S,
            who='the sequencer',
            missing_code=MISSING['sequencer'],
        )
        if answer.error_code:
            raise StationError(answer.error_msg, answer.error_code)

    def _spin(self) -> None:
        """Spin until the client is closed."""
        while not self._closing.is_set():
            self._executor.spin_once(timeout_sec=SPIN_S)
            if self._pace_s:
                self._closing.wait(self._pace_s)

    def _meet(self, server: str, deadline_s: float) -> int:
        """Return when a node is known to answer this client: how often it had died until then."""
        losses = self._life[server].losses
        if self._met.get(server) != losses:
            greet(
                self.node,
                server,
                deadline_s=deadline_s,
                who=f'the {server}',
                missing_code=MISSING[server],
            )
            self._met[server] = losses
        return losses

    def _wait_for_actions(self, deadline_s: float) -> None:
        """Return when the sequencer takes goals: an action has parts that are found one by one."""
        give_up_s = time.monotonic() + deadline_s
        while not self._execute.server_is_ready():
            if time.monotonic() > give_up_s:
                raise RunFailed('the sequencer is not there', MISSING['sequencer'])
            time.sleep(POLL_S)

    def _ask(self, send: Callable[[], Future], losses: int) -> Any:
        """Have the thread that spins send something to the sequencer; wait for the answer.

        An action client drops an answer that comes before it has noted down what it sent.
        """
        sent = self._result(self._executor.create_task(send), 'sequencer', losses)
        return self._result(sent, 'sequencer', losses)

    def _result(self, future: Future, server: str, losses: int) -> Any:
        """Wait for an answer until the node that owes it has died more than `losses` times."""
        answered = threading.Event()
        future.add_done_callback(lambda _: answered.set())
        seen_s = time.monotonic()
        while not answered.wait(SPIN_S):
            if self._closing.is_set():
                raise RunFailed(f'the connection was closed before the {server} answered')
            if self._ready[server]():
                seen_s = time.monotonic()
            if self._life[server].losses != losses or time.monotonic() > seen_s + GONE_S:
                raise RunFailed(f'the {server} ended before it answered', MISSING[server])
        return future.result()


def _progress(feedback: ExecutePlan.Feedback) -> Progress:
    """Return the progress that a feedback message tells."""
    return Progress(
        step=feedback.step,
        steps=feedback.steps,
        rotation=feedback.rotation,
        share=feedback.progress,
        time_left_s=feedback.time_left,
    )
