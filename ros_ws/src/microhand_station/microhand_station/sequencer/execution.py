# SPDX-License-Identifier: Apache-2.0
"""One run, from a plan to an object that is held at its goal: check, record, move, feel, judge."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from microhand_msgs_py.msg import Plan as PlanMsg

from microhand_planner.core.catalogue import find_mesh_file
from microhand_planner.core.errors import MicrohandError, RunFailed
from microhand_planner.core.motions import Motion
from microhand_planner.core.plan import FINGERS, Plan
from microhand_planner.core.pose import FloatArray, Pose, angle_between_rad
from microhand_planner.core.travel import check_travel
from microhand_station.config import StationConfig
from microhand_station.sequencer.contact_reference import ContactReference
from microhand_station.sequencer.object_watch import (
    OBJECT_LOST,
    TWIN_MISSING,
    Deviation,
    ObjectReport,
    check_held,
    deviation,
)
from microhand_station.sequencer.preflight import ANSWER_S, Cleared, Preflight
from microhand_station.sequencer.progress import Progress, ProgressTeller
from microhand_station.sequencer.recorder_link import RECORDER_MISSING, RecorderLink
from microhand_station.sequencer.run_control import RunControl
from microhand_station.sequencer.stage_link import StageLink
from microhand_station.sequencer.states import Event
from microhand_station.sequencer.streamer import LOOK_S, PlannedAt, Streamer
from microhand_station.sequencer.twin_link import TwinLink

CLOSE_RECORD_S = 10.0
"""Longest wait for the recorder to finish its file [s]."""
CATCH_UP_S = 10.0
"""Longest wait for the twin to see the stages stand [s]."""
STANDS_STILL_UM = 1e-3
"""A finger that is commanded to within this of where a run left it has not moved since [µm]."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Parameters
    ----------
    code : int
        See ErrorCode; 0: every setpoint was sent, the stages are on target, the object is held.
    message : str
        What went wrong; empty on success.
    record_file : str
        Path of the record; empty: not recorded.
    record_error : str
        What is wrong with the record of a run that went on all the same; empty: nothing.
    setpoints_sent : int
        To each finger.
    duration_s : float
        Of the motion [s].
    judged, held : bool
        Whether the twin saw the object to the end, and whether it was held throughout.
    final_error_rad : float
        Between the object and its goal [rad]; NaN: not judged.
    """

    code: int
    message: str
    record_file: str
    record_error: str
    setpoints_sent: int
    duration_s: float
    judged: bool = False
    held: bool = False
    final_error_rad: float = math.nan


@dataclass(frozen=True)
class Grasp:
    """How fingers hold an object after a run: the next plan can go on from there.

    Parameters
    ----------
    reference : ContactReference
        Where they touched.
    command_um : (3, 3) float
        Where they were left, station frame [µm]; NaN: unknown.
    """

    reference: ContactReference = field(default_factory=ContactReference)
    command_um: FloatArray = field(default_factory=lambda: np.full((FINGERS, 3), np.nan))


@dataclass(frozen=True)
class Order:
    """What to execute.

    Parameters
    ----------
    plan : microhand_msgs_py.msg.Plan
        As it came.
    name : str
        Of the record; empty: made from the time.
    object_name : str
        Where the twin finds the object; empty: by the plan's name for it.
    unit_m : float
        Of the object's mesh [m]; 0: the default.
    request : mapping
        What was asked for, kept in the record.
    """

    plan: PlanMsg
    name: str = ''
    object_name: str = ''
    unit_m: float = 0.0
    request: Mapping[str, Any] = field(default_factory=dict)


class Execution:
    """Executes one plan, in the thread that calls `run`.

    Parameters
    ----------
    stages : sequence of 3 StageLink
        Fingers 1, 2, 3.
    recorder : RecorderLink
        Used if `config` asks for a record.
    twin : TwinLink or None
        Stands in for the object, and judges; None: there is none.
    config : StationConfig
        How fast, how stiff, and whether to record.
    control : RunControl
        State, and orders of the caller. The state is STARTING.
    grasp : Grasp
        How the last run left the fingers.
    now_ns : callable
        ROS time [ns].
    on_progress : callable
        Told several times a second.
    on_event : callable
        Told what is worth remembering, with an error code or 0.
    on_deviation : callable
        Told how far the object is from where the plan has it, once per report of the twin.
    """

    def __init__(
        self,
        stages: Sequence[StageLink],
        recorder: RecorderLink,
        twin: TwinLink | None,
        config: StationConfig,
        control: RunControl,
        grasp: Grasp,
        now_ns: Callable[[], int],
        on_progress: Callable[[Progress], None],
        on_event: Callable[[str, int], None],
        on_deviation: Callable[[Deviation], None],
    ) -> None:
        self._stages = stages
        self._recorder = recorder
        self._twin = twin
        self._config = config
        self._control = control
        self._now_ns = now_ns
        self._on_progress = on_progress
        self._on_event = on_event
        self._on_deviation = on_deviation
        self._streamer = Streamer(stages, control, config.tolerances, now_ns, self._check)
        self._record_file = ''
        self._record_error = ''
        self._duration_s = 0.0
        self._goal: Pose | None = None
        self._judged_ns = 0
        self.grasp = grasp
        """How the fingers hold the object now."""

    def run(self, order: Order) -> Outcome:
        """Execute a plan; every failure is in the outcome."""
        code, text = 0, ''
        try:
            self._execute(order)
        except MicrohandError as error:
            code, text = error.code, str(error)
        except Exception as error:
            code, text = MicrohandError.code, f'unforeseen: {type(error).__name__}: {error}'
        if code:
            self._on_event(f'run ended: {text}', code)
        judged, held, error_rad = self._verdict(code)
        if self._record_file:
            sent = [self._streamer.setpoints_sent] * FINGERS
            incomplete = self._recorder.stop(sent, CLOSE_RECORD_S)
            if incomplete and self._config.recording.goes_on:
                self._record_error = self._record_error or incomplete
            elif incomplete and not code:
                code, text = RECORDER_MISSING, incomplete
        return Outcome(
            code,
            text,
            self._record_file,
            self._record_error,
            self._streamer.setpoints_sent,
            self._duration_s,
            judged,
            held,
            error_rad,
        )

    def _execute(self, order: Order) -> None:
        """Check everything, then move."""
        cleared = Preflight(self._stages, self._config, self._control).clear(order.plan)
        if self._twin is not None:
            self._twin.load(order.plan, order.object_name, order.unit_m, ANSWER_S)
        if self._config.recording.required:
            self._open_record(order, cleared)
        self._control.check_orders()
        self._control.fire(Event.BEGIN)
        self._goal = cleared.plan.goal
        began_s = time.monotonic()
        try:
            self._move(cleared)
        finally:
            self._duration_s = time.monotonic() - began_s

    def _open_record(self, order: Order, cleared: Cleared) -> None:
        """Have the run recorded, with all that is needed to understand it."""
        metadata = {
            'station': self._config.to_dict(),
            'request': order.request,
            'planned_s': cleared.planned_s,
        }
        mesh = find_mesh_file(order.object_name or order.plan.object_name)
        try:
            self._record_file = self._recorder.start(
                order.name,
                metadata,
                order.plan,
                '' if mesh is None else str(mesh.absolute()),
                ANSWER_S,
            )
        except RunFailed as error:
            if error.code != RECORDER_MISSING:
                raise
            self._bear(str(error))

    def _bear(self, record_error: str) -> None:
        """Go on without a record, or with a part of one, if the station is to; raise if not."""
        if not self._config.recording.goes_on:
            raise RunFailed(record_error, RECORDER_MISSING)
        if not self._record_error:
            self._record_error = record_error
            self._on_event(f'the run goes on, but {record_error}', RECORDER_MISSING)

    def _move(self, cleared: Cleared) -> None:
        """Go to where the plan begins, and execute it, motion by motion."""
        plan = cleared.plan
        teller = ProgressTeller(
            plan, cleared.motions, self._on_progress, lambda text: self._on_event(text, 0)
        )
        reference = self._known_reference(plan)
        self.grasp = Grasp()
        if cleared.approach is not None:
            self._on_event('on the way to where the plan begins', 0)
            self._streamer.stream(cleared.approach, lambda _: None)
        released = any(plan.steps[0].in_contact)
        if released:
            self._release()
        for number, motion in enumerate(cleared.motions):
            commands = reference.commands(
                motion.trajectory, self._standing_um(), self._config.touch.speed_um_s
            )
            check_travel(
                commands.tip_um, commands.velocity_um_s, cleared.limits, commands.period_s
            )
            if any(motion.guarded):
                self._let_twin_catch_up()  # what stops the fingers must not be late
            self._streamer.stream(commands, partial(teller.tell, number), motion.guarded)
            if any(motion.guarded):
                reference = self._touched(motion, reference)
                if not released:
                    self._release()
                    released = True
            reference = reference.forget(_touching_after(plan, motion))
        self._let_twin_catch_up(plan.reached)
        self.grasp = Grasp(reference, self._standing_um())
        self._on_event('plan executed, stages on target', 0)

    def _known_reference(self, plan: Plan) -> ContactReference:
        """Return where fingers touched that have held the object since the last run."""
        holding = np.array(plan.steps[0].in_contact)
        moved_um = np.abs(self._standing_um() - self.grasp.command_um)[holding]
        if not holding.any() or not np.all(moved_um < STANDS_STILL_UM):
            return ContactReference()
        return self.grasp.reference.forget(plan.steps[0].in_contact)

    def _standing_um(self) -> FloatArray:
        """Return where the fingers are commanded to be, station frame (3, 3) [µm]."""
        return np.stack([stage.command_um() for stage in self._stages])

    def _touched(self, motion: Motion, reference: ContactReference) -> ContactReference:
        """Take in where guarded fingers met the object."""
        met_um = np.stack([stage.contact_um() for stage in self._stages])
        reference = reference.learn(motion, met_um, self._config.contact.tolerance_um)
        for finger in np.flatnonzero(motion.guarded):
            off_nm = 1e3 * float(np.linalg.norm(reference.offset_um[finger]))
            self._on_event(
                f'finger {finger + 1} met the object {off_nm:.0f} nm from where it was planned', 0
            )
        return reference

    def _release(self) -> None:
        """Leave the object to the fingers."""
        if self._twin is not None:
            self._twin.release(ANSWER_S)

    def _check(self, planned_at: PlannedAt) -> None:
        """Raise unless the object is where the plan has it, and the run is being recorded."""
        self._check_object(planned_at)
        if self._recorder.fault:
            self._bear(self._recorder.fault)

    def _check_object(self, planned_at: PlannedAt) -> None:
        """Raise unless the twin reports that the object is where the plan has it."""
        if self._twin is None:
            return
        self._twin.check()
        report = self._twin.report
        check_held(report, time.monotonic())
        planned = None if report is None else planned_at(report.stamp_ns)
        if report is not None and planned is not None:
            off = deviation(report, planned)
            if off.stamp_ns > self._judged_ns:
                self._judged_ns = off.stamp_ns
                self._on_deviation(off)
            off.check(self._config.twin)

    def _let_twin_catch_up(self, planned: Pose | None = None) -> None:
        """Return when the twin has seen the stages stand, and the object where it is planned."""
        if self._twin is None:
            return
        stands_ns = self._now_ns()
        give_up_s = time.monotonic() + CATCH_UP_S
        while True:
            self._control.check_orders()
            self._check(lambda ns: planned if ns >= stands_ns else None)
            report = self._twin.report
            if report is not None and report.stamp_ns >= stands_ns:
                return
            if time.monotonic() > give_up_s:
                raise RunFailed(
                    f'the twin is more than {CATCH_UP_S:g} s behind the stages', TWIN_MISSING
                )
            self._control.wait(time.monotonic() + LOOK_S)

    def _verdict(self, code: int) -> tuple[bool, bool, float]:
        """Return whether the object was watched, is held, and how far off its goal it is [rad]."""
        report: ObjectReport | None = None if self._twin is None else self._twin.report
        if report is None or self._goal is None or code == TWIN_MISSING:
            return False, False, math.nan
        held = report.held and report.released and code != OBJECT_LOST
        return True, held, angle_between_rad(report.pose.rotation, self._goal.rotation)


def _touching_after(plan: Plan, motion: Motion) -> tuple[bool, bool, bool]:
    """Return which fingers touch the object when a motion is over."""
    step = plan.steps[int(motion.trajectory.step_of[-1])].in_contact
    first, second, third = np.logical_or(step, motion.guarded).tolist()
    return first, second, third
