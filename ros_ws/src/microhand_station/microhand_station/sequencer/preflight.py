# SPDX-License-Identifier: Apache-2.0
"""A plan, the stages and the twin → motions that may begin; or why not, before anything moves."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from microhand_msgs_py.msg import Plan as PlanMsg

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.force_check import check_forces
from microhand_planner.core.motions import Motion, motions
from microhand_planner.core.plan import Plan
from microhand_planner.core.plan_check import check_plan
from microhand_planner.core.pose import FloatArray
from microhand_planner.core.trajectory import Trajectory, time_steps
from microhand_planner.core.travel import AXES, StageLimits, check_travel
from microhand_planner.ros.conversions import plan_from_msg
from microhand_station.config import StationConfig
from microhand_station.sequencer.approach_path import way_to_start
from microhand_station.sequencer.contact_reference import NO_CONTACT
from microhand_station.sequencer.recorder_link import RECORDER_MISSING
from microhand_station.sequencer.run_control import RunControl
from microhand_station.sequencer.stage_link import StageLink
from microhand_station.sequencer.stage_watch import STAGE_MISSING, check_ready
from microhand_station.sequencer.states import NOT_ALLOWED
from microhand_station.sequencer.streamer import LOOK_S

ANSWER_S = 5.0
"""Longest wait for a driver, the twin or the recorder to be found, and to answer [s]."""
READY_S = 0.5
"""Longest wait for stages that are there to hold [s]."""


@dataclass(frozen=True)
class Cleared:
    """What may be executed.

    Parameters
    ----------
    plan : Plan
        Checked.
    approach : Trajectory or None
        From where the fingers stand to where the plan begins; None: they are there.
    motions : tuple of Motion
        Of the plan.
    limits : tuple of 3 StageLimits
        Of the stages.
    """

    plan: Plan
    approach: Trajectory | None
    motions: tuple[Motion, ...]
    limits: tuple[StageLimits, ...]

    @property
    def planned_s(self) -> float:
        """How long the plan takes [s]."""
        return sum(motion.trajectory.duration_s for motion in self.motions)


class Preflight:
    """Checks everything that can be known before anything moves.

    Parameters
    ----------
    stages : sequence of 3 StageLink
        Fingers 1, 2, 3.
    config : StationConfig
        How fast, how stiff, and whether to record.
    control : RunControl
        Orders of the caller.
    """

    def __init__(
        self, stages: Sequence[StageLink], config: StationConfig, control: RunControl
    ) -> None:
        self._stages = stages
        self._config = config
        self._control = control

    def clear(self, message: PlanMsg) -> Cleared:
        """Check a plan, and the stages that shall execute it.

        Raises
        ------
        MicrohandError
            The first thing that is wrong.
        """
        plan = plan_from_msg(message)
        check_plan(plan)
        check_forces(plan)
        self._wait_for(self._check_heard, ANSWER_S)
        self._wait_for(self._check_ready, READY_S)
        for stage in self._stages:
            stage.expect()
        limits = tuple(stage.limits(ANSWER_S) for stage in self._stages)
        slowest_um_s = min(stage.max_velocity_um_s for stage in limits)
        config = self._config
        approach = self._approach(plan, slowest_um_s)
        pieces = motions(
            plan,
            config.motion.pace(slowest_um_s),
            config.stiffness_uN_per_um,
            config.touch,
        )
        for trajectory in [approach, *(motion.trajectory for motion in pieces)]:
            if trajectory is not None:
                check_travel(
                    trajectory.tip_um, trajectory.velocity_um_s, limits, trajectory.period_s
                )
        self._wait_for(lambda: self._check_listeners(pieces), ANSWER_S)
        self._wait_for_recorder()
        return Cleared(plan, approach, pieces, limits)

    def _approach(self, plan: Plan, slowest_um_s: float) -> Trajectory | None:
        """Return the way from where the fingers stand to where the plan begins."""
        standing_um = np.stack([stage.command_um() for stage in self._stages])
        begin_um = plan.steps[0].tip_um[0]
        holding = np.array(plan.steps[0].in_contact)
        _check_holding(holding, standing_um - begin_um, self._config.tolerances.start_um)
        way = way_to_start(np.where(holding[:, None], begin_um, standing_um), plan)
        if not way:
            return None
        approach = time_steps(way, self._config.motion.transit_pace(slowest_um_s))
        # fingers that hold the object go on pressing it meanwhile
        tip_um = np.where(holding[:, None], standing_um, approach.tip_um)
        return replace(approach, tip_um=tip_um)

    def _check_heard(self) -> None:
        """Raise unless every stage has reported at least once."""
        for finger, stage in enumerate(self._stages, start=1):
            if stage.report is None:
                raise RunFailed(f'finger {finger}: its stage driver is not there', STAGE_MISSING)

    def _check_ready(self) -> None:
        """Raise unless every stage holds."""
        check_ready([stage.report for stage in self._stages], time.monotonic())

    def _check_listeners(self, pieces: Sequence[Motion]) -> None:
        """Raise unless setpoints and contacts will reach the drivers."""
        guarded = np.any([motion.guarded for motion in pieces], axis=0)
        for finger, stage in enumerate(self._stages, start=1):
            if 'stage_driver' not in stage.listeners():
                raise RunFailed(
                    f'finger {finger}: its stage driver does not listen', STAGE_MISSING
                )
            if guarded[finger - 1] and not self._config.twin.enabled:
                if not stage.has_contact_sensor():
                    raise RunFailed(
                        f'finger {finger}: nobody reports its contacts, and there is no twin',
                        NO_CONTACT,
                    )

    def _wait_for_recorder(self) -> None:
        """Return when setpoints will reach the recorder, or need not."""

        def check() -> None:
            if any('recorder' not in stage.listeners() for stage in self._stages):
                raise RunFailed('the recorder is not there', RECORDER_MISSING)

        if self._config.recording.required:
            try:
                self._wait_for(check, ANSWER_S)
            except RunFailed as error:
                if error.code != RECORDER_MISSING or not self._config.recording.goes_on:
                    raise

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


def _check_holding(holding: FloatArray, away_um: FloatArray, allowed_um: float) -> None:
    """Check that fingers that shall hold the object from the beginning can be doing so."""
    for finger in np.flatnonzero(holding):
        axis = int(np.argmax(np.abs(away_um[finger])))
        if abs(away_um[finger, axis]) > allowed_um:
            raise RunFailed(
                f'finger {finger + 1}, {AXES[axis]}: {abs(away_um[finger, axis]):.2f} µm from '
                f'where the plan has it hold the object, allowed {allowed_um:g} µm',
                NOT_ALLOWED,
            )
