# SPDX-License-Identifier: Apache-2.0
"""Trajectory to stages: setpoints sent ahead of time, watched until every stage is on target."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import Pose
from microhand_planner.core.trajectory import Trajectory
from microhand_station.sequencer.path_watch import PathWatch, check_goal
from microhand_station.sequencer.run_control import CANCELLED, RunControl
from microhand_station.sequencer.setpoint_stream import SetpointStream
from microhand_station.sequencer.stage_link import NS_PER_S, StageLink
from microhand_station.sequencer.stage_watch import (
    SILENCE_S,
    STAGE_FAULT,
    STAGE_MISSING,
    Mode,
    StageReport,
    check_alive,
    finished,
    what_is_missing,
)
from microhand_station.sequencer.states import EMERGENCY_STOP, Event
from microhand_station.tolerance_config import ToleranceConfig

LEAD_S = 0.4
"""Setpoints are sent this long before they are due [s]."""
RAMP_S = 0.15
"""How long the fingers take to a standstill when a run is broken off [s]."""
STOP_S = 0.3
"""Longest time for stages to stop at once, because one of them is missing [s]."""
LOOK_S = 0.02
"""How often the stages are looked at while nothing has to be sent [s]."""

PlannedAt = Callable[[int], Pose | None]
"""Returns where the plan has the object at a ROS time [ns]; None: nothing is said about then."""


class Streamer:
    """Sends trajectories to the three stages, one stream at a time.

    Parameters
    ----------
    stages : sequence of 3 StageLink
        Fingers 1, 2, 3.
    control : RunControl
        Orders of the caller, and news of the stages.
    tolerance : ToleranceConfig
        How far stages may be from their setpoints.
    now_ns : callable
        ROS time [ns].
    check_others : callable
        Raises RunFailed if the object is not where it should be, or if one of those who watch
        the run is gone.
    """

    def __init__(
        self,
        stages: Sequence[StageLink],
        control: RunControl,
        tolerance: ToleranceConfig,
        now_ns: Callable[[], int],
        check_others: Callable[[PlannedAt], None],
    ) -> None:
        self._stages = stages
        self._control = control
        self._tolerance = tolerance
        self._path = PathWatch(tolerance)
        self._now_ns = now_ns
        self._check_others = check_others
        self.setpoints_sent = 0
        """To each finger, over all streams."""

    def reports(self) -> list[StageReport | None]:
        """Return the last report of each stage."""
        return [stage.report for stage in self._stages]

    def stream(
        self,
        trajectory: Trajectory,
        tell: Callable[[int], None],
        guarded: Sequence[bool] = (False, False, False),
    ) -> None:
        """Stream a trajectory to its end, and pause where the caller wants it.

        Parameters
        ----------
        trajectory : Trajectory
            Begins where the stages stand.
        tell : callable
            Told which setpoint of the trajectory is due, several times a second.
        guarded : sequence of 3 bool
            Fingers that stop at contact.

        Raises
        ------
        RunFailed
            A cancel, an emergency stop, a stage that failed, or an object that is lost. The
            stages have been brought to rest on the path, except after an emergency stop or when
            a stage is missing: then all have been stopped at once.
        """
        begin = 0
        while begin < len(trajectory) - 1:
            self._pause()
            stream = SetpointStream(trajectory, begin)
            self._send(stream, trajectory, tell, guarded)
            begin = stream.position

    def _pause(self) -> None:
        """Stand as long as the caller wants it."""
        if not self._control.pause_wanted:
            return
        self._control.fire(Event.PAUSE)
        while self._control.pause_wanted:
            broken = self._why_to_stop(lambda _: None)
            if broken is not None:
                raise broken
            self._control.wait(time.monotonic() + LOOK_S)
        self._control.fire(Event.RESUME)

    def _send(
        self,
        stream: SetpointStream,
        trajectory: Trajectory,
        tell: Callable[[int], None],
        guarded: Sequence[bool],
    ) -> None:
        """Send a stream ahead of time; a cancel or a fault turns its rest into a ramp."""
        period_s = trajectory.period_s
        number = 1 + max(report.stream for report in self.reports() if report is not None)
        begin_s = time.monotonic() + LEAD_S
        begin_ns = self._now_ns() + round((begin_s - time.monotonic()) * NS_PER_S)
        broken: RunFailed | None = None

        def tell_due() -> None:
            tell(stream.due(int((time.monotonic() - begin_s) / period_s)))

        def planned_at(time_ns: int) -> Pose | None:
            if time_ns < begin_ns:
                return None
            periods = round((time_ns - begin_ns) / (period_s * NS_PER_S))
            return pose_at(trajectory, stream.due(periods))

        while not stream.finished:
            if broken is None:
                broken = self._why_to_stop(planned_at)
                if broken is not None:
                    self._raise_if_urgent(broken)
                    stream.ramp_down(RAMP_S)
                    self._control.fire(Event.STOP)
                elif self._control.pause_wanted:
                    stream.pause()
            tell_due()
            now_s = time.monotonic()
            due_s = begin_s + stream.sent * period_s - LEAD_S
            if now_s < due_s:
                self._control.wait(min(due_s, now_s + LOOK_S))
                continue
            chunk = stream.next_chunk()
            for stage, stops in zip(self._stages, guarded, strict=True):
                stage.send(chunk, number, begin_ns, period_s, bool(stops))
            self.setpoints_sent += len(chunk.tip_um)
        end_s = begin_s + stream.sent * period_s
        why_to_stop = partial(self._why_to_stop, planned_at)
        self._settle(number, stream.sent, end_s, broken, tell_due, why_to_stop)
        tell(stream.position)

    def _settle(
        self,
        number: int,
        setpoints: int,
        end_s: float,
        broken: RunFailed | None,
        tell_due: Callable[[], None],
        why_to_stop: Callable[[], RunFailed | None],
    ) -> None:
        """Wait until every stage has the stream and holds on target, and raise what broke it."""
        while not finished(self.reports(), number, setpoints):
            tell_due()
            failed = why_to_stop()
            self._raise_if_urgent(failed)
            now_s = time.monotonic()
            # stages that are well get the time to come to rest
            if now_s > end_s and failed is not None and failed.code != CANCELLED:
                raise broken or failed
            if now_s > end_s + self._tolerance.settle_s:
                if broken is None:
                    self._check_settled(number, setpoints)
                break
            self._control.wait(now_s + LOOK_S)
        if broken is not None:
            raise broken

    def _raise_if_urgent(self, broken: RunFailed | None) -> None:
        """Raise what does not wait for a ramp; if a stage is missing, stop those that are left."""
        if broken is None or broken.code not in (EMERGENCY_STOP, STAGE_MISSING):
            return
        if broken.code == STAGE_MISSING:
            for stage in self._stages:
                stage.ask_to_stop()
            stopped = (Mode.STOPPED, Mode.FAULT)
            give_up_s = time.monotonic() + STOP_S
            while time.monotonic() < give_up_s:
                now_s = time.monotonic()
                if all(report.mode in stopped for report in self._still_there(now_s)):
                    break
                self._control.wait(now_s + LOOK_S)
        raise broken

    def _still_there(self, now_s: float) -> list[StageReport]:
        """Return the reports of the stages whose drivers neither ended nor fell silent."""
        alive = [stage.report for stage in self._stages if not stage.has_ended]
        return [report for report in alive if report and now_s - report.arrived_s < SILENCE_S]

    def _check_settled(self, number: int, setpoints: int) -> None:
        """Raise unless every stage has the stream, and holds as near its end as is tolerated."""
        missing = what_is_missing(self.reports(), number, setpoints)
        if missing:
            settle_s = self._tolerance.settle_s
            raise RunFailed(f'{missing}, {settle_s:g} s after the stream', STAGE_FAULT)
        check_goal(self.reports(), self._tolerance)

    def _why_to_stop(self, planned_at: PlannedAt) -> RunFailed | None:
        """Return what speaks against going on, if anything does."""
        try:
            self._control.check_orders()
            self._check_ended()
            check_alive(self.reports(), time.monotonic())
            self._path.check(self.reports())
            self._check_others(planned_at)
        except RunFailed as error:
            return error
        return None

    def _check_ended(self) -> None:
        """Raise if a driver has ended: known long before its silence is noticed."""
        for finger, stage in enumerate(self._stages, start=1):
            if stage.has_ended:
                raise RunFailed(f'finger {finger}: its stage driver has ended', STAGE_MISSING)


def pose_at(trajectory: Trajectory, setpoint: int) -> Pose:
    """Return where the plan has the object at a setpoint."""
    return Pose(
        trajectory.object_position_um[setpoint], trajectory.object_quaternion_wxyz[setpoint]
    )
