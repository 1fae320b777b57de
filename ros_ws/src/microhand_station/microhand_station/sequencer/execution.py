# SPDX-License-Identifier: Apache-2.0
"""One run, from a plan to stages on target: check, record, go to the start, stream."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from microhand_msgs_py.msg import Plan as PlanMsg

from microhand_planner.core.errors import MicrohandError, RunFailed
from microhand_planner.core.force_check import check_forces
from microhand_planner.core.plan import FINGERS, Plan, Step
from microhand_planner.core.plan_check import check_plan
from microhand_planner.core.trajectory import Pace, Trajectory, time_steps
from microhand_planner.core.travel import StageLimits, check_travel
from microhand_planner.ros.conversions import plan_from_msg
from microhand_station.config import StationConfig
from microhand_station.sequencer.approach_path import way_to_start
from microhand_station.sequencer.progress import Progress, ProgressTeller
from microhand_station.sequencer.recorder_link import RECORDER_MISSING, RecorderLink
from microhand_station.sequencer.run_control import RunControl
from microhand_station.sequencer.stage_link import StageLink
from microhand_station.sequencer.stage_watch import STAGE_MISSING, check_ready
from microhand_station.sequencer.states import Event
from microhand_station.sequencer.streamer import LOOK_S, Streamer

ANSWER_S = 5.0
"""Longest wait for a driver or the recorder to be found, and to answer [s]."""
READY_S = 0.5
"""Longest wait for stages that are there to hold [s]."""
CLOSE_RECORD_S = 10.0
"""Longest wait for the recorder to finish its file [s]."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Parameters
    ----------
    code : int
        See ErrorCode; 0: every setpoint was sent, and the stages are on target.
    message : str
        What went wrong; empty on success.
    record_file : str
        Path of the record; empty: not recorded.
    setpoints_sent : int
        To each finger.
    duration_s : float
        Of the motion [s].
    """

    code: int
    message: str
    record_file: str
    setpoints_sent: int
    duration_s: float


class Execution:
    """Executes one plan, in the thread that calls `run`.

    Parameters
    ----------
    stages : sequence of 3 StageLink
        Fingers 1, 2, 3.
    recorder : RecorderLink
        Used if `config` asks for a record.
    config : StationConfig
        How fast, and whether to record.
    control : RunControl
        State, and orders of the caller. The state is STARTING.
    now_ns : callable
        ROS time [ns].
    on_progress : callable
        Told several times a second.
    on_event : callable
        Told what is worth remembering, with an error code or 0.
    """

    def __init__(
        self,
        stages: Sequence[StageLink],
        recorder: RecorderLink,
        config: StationConfig,
        control: RunControl,
        now_ns: Callable[[], int],
        on_progress: Callable[[Progress], None],
        on_event: Callable[[str, int], None],
    ) -> None:
        self._stages = stages
        self._recorder = recorder
        self._config = config
        self._control = control
        self._on_progress = on_progress
        self._on_event = on_event
        self._streamer = Streamer(stages, control, now_ns)
        self._record_file = ''
        self._duration_s = 0.0

    def run(self, message: PlanMsg, name: str) -> Outcome:
        """Execute a plan; every failure is in the outcome."""
        code, text = 0, ''
        try:
            self._execute(message, name)
        except MicrohandError as error:
            code, text = error.code, str(error)
        except Exception as error:
            code, text = MicrohandError.code, f'unforeseen: {type(error).__name__}: {error}'
        if code:
            self._on_event(f'run ended: {text}', code)
        if self._record_file:
            sent = [self._streamer.setpoints_sent] * FINGERS
            incomplete = self._recorder.stop(sent, CLOSE_RECORD_S)
            if incomplete and not code:
                code, text = RECORDER_MISSING, incomplete
        return Outcome(
            code, text, self._record_file, self._streamer.setpoints_sent, self._duration_s
        )

    def _execute(self, message: PlanMsg, name: str) -> None:
        """Check everything, then move."""
        plan = plan_from_msg(message)
        check_plan(plan)
        check_forces(plan)
        self._wait_for(self._check_heard, ANSWER_S)
        self._wait_for(lambda: check_ready(self._streamer.reports(), time.monotonic()), READY_S)
        limits = [stage.limits(ANSWER_S) for stage in self._stages]
        approach, trajectory = self._timed(plan, limits)
        self._wait_for(self._check_listeners, ANSWER_S)
        if self._config.record:
            metadata = {'station': self._config.to_dict(), 'planned_s': trajectory.duration_s}
            self._record_file = self._recorder.start(name, metadata, message, ANSWER_S)
        self._control.check_orders()
        self._control.fire(Event.BEGIN)
        began_s = time.monotonic()
        try:
            self._move(plan, approach, trajectory)
        finally:
            self._duration_s = time.monotonic() - began_s

    def _move(self, plan: Plan, approach: Trajectory | None, trajectory: Trajectory) -> None:
        """Go to where the plan begins, and execute it."""
        teller = ProgressTeller(
            plan, trajectory, self._on_progress, lambda text: self._on_event(text, 0)
        )
        if approach is not None:
            self._on_event('on the way to where the plan begins', 0)
            self._streamer.stream(approach, lambda _: None)
        self._streamer.stream(trajectory, teller.tell)
        self._on_event('plan executed, stages on target', 0)

    def _timed(
        self, plan: Plan, limits: Sequence[StageLimits]
    ) -> tuple[Trajectory | None, Trajectory]:
        """Return the setpoints to the start of the plan, and those of the plan, both checked."""
        tips = np.stack(
            [
                stage.to_station(report.command_um)
                for stage, report in zip(limits, self._streamer.reports(), strict=True)
                if report is not None
            ]
        )
        slowest_um_s = min(stage.max_velocity_um_s for stage in limits)
        motion = self._config.motion
        way = way_to_start(tips, plan)
        approach = _checked(way, motion.transit_pace(slowest_um_s), limits) if way else None
        return approach, _checked(plan.steps, motion.pace(slowest_um_s), limits)

    def _check_heard(self) -> None:
        """Raise unless every stage has reported at least once."""
        for finger, report in enumerate(self._streamer.reports(), start=1):
            if report is None:
                raise RunFailed(f'finger {finger}: its stage driver is not there', STAGE_MISSING)

    def _check_listeners(self) -> None:
        """Raise unless every setpoint will reach its driver, and the recorder."""
        for finger, stage in enumerate(self._stages, start=1):
            listeners = stage.listeners()
            if 'stage_driver' not in listeners:
                raise RunFailed(
                    f'finger {finger}: its stage driver does not listen', STAGE_MISSING
                )
            if self._config.record and 'recorder' not in listeners:
                raise RunFailed('the recorder is not there', RECORDER_MISSING)

    def _wait_for(self, check: Callable[[], None], deadline_s: float) -> None:
        """Return when `check` passes; raise what it says when the time is over."""
        give_up_s = time.monotonic() + deadline_s
        while True:
            self._control.check_orders()
            try:
                check()
            except RunFailed:
                if time.monotonic() > give_up_s:
                    raise
            else:
                return
            self._control.wait(time.monotonic() + LOOK_S)


def _checked(steps: Sequence[Step], pace: Pace, limits: Sequence[StageLimits]) -> Trajectory:
    """Return the setpoints of steps that the stages can do."""
    trajectory = time_steps(steps, pace)
    check_travel(trajectory.tip_um, trajectory.velocity_um_s, limits)
    return trajectory
