# SPDX-License-Identifier: Apache-2.0
"""How far a run is: the step being executed, and the time left."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from microhand_planner.core.motions import Motion
from microhand_planner.core.plan import Plan, Step, StepKind


@dataclass(frozen=True)
class Progress:
    """What callers are told while a run is under way.

    Parameters
    ----------
    step, steps : int
        Step being executed, from 0, and how many the plan has.
    rotation : int
        Planar rotation being executed, from 0.
    share : float
        Share of the planned time, 0 to 1.
    time_left_s : float
        Planned time left [s]; NaN: there is no plan.
    """

    step: int = 0
    steps: int = 0
    rotation: int = 0
    share: float = 0.0
    time_left_s: float = math.nan


class ProgressTeller:
    """Tells where a plan is, each time it is told which setpoint of which motion is due.

    Parameters
    ----------
    plan : Plan
        What is executed.
    motions : sequence of Motion
        Its setpoints.
    on_progress : callable
        Told every time.
    on_step : callable
        Told once per step, with a sentence for people.
    """

    def __init__(
        self,
        plan: Plan,
        motions: Sequence[Motion],
        on_progress: Callable[[Progress], None],
        on_step: Callable[[str], None],
    ) -> None:
        self._plan = plan
        self._motions = motions
        durations_s = [motion.trajectory.duration_s for motion in motions]
        self._begin_s = [0.0, *itertools.accumulate(durations_s)]
        self._on_progress = on_progress
        self._on_step = on_step
        self._step = -1

    def tell(self, motion: int, setpoint: int) -> None:
        """Tell how far the plan is when a setpoint of a motion is due."""
        trajectory = self._motions[motion].trajectory
        step = int(trajectory.step_of[setpoint])
        passed_s = self._begin_s[motion] + setpoint * trajectory.period_s
        total_s = self._begin_s[-1]
        self._on_progress(
            Progress(
                step=step,
                steps=len(self._plan.steps),
                rotation=self._plan.steps[step].rotation,
                share=min(passed_s / total_s, 1.0),
                time_left_s=max(total_s - passed_s, 0.0),
            )
        )
        for begun in range(self._step + 1, step + 1):
            what = describe_step(self._plan.steps[begun])
            self._on_step(f'step {begun + 1} of {len(self._plan.steps)}: {what}')
        self._step = max(self._step, step)


def describe_step(step: Step) -> str:
    """Say in a few words what a step does."""
    if step.kind is StepKind.ROLL:
        return f'roll by {math.degrees(step.angle_rad):.1f}°'
    return f'{step.kind.value} finger {step.finger}' if step.finger else step.kind.value
