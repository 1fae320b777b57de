# SPDX-License-Identifier: Apache-2.0
"""Do the stages go where they are commanded: judged by their reports, axis by axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.travel import AXES
from microhand_station.sequencer.stage_watch import Mode, StageReport
from microhand_station.tolerance_config import ToleranceConfig

PATH_TOLERANCE = 307
GOAL_TOLERANCE = 311

FOLLOWING = (Mode.HOLDING, Mode.STREAMING)


class PathWatch:
    """Notices stages that are away from their setpoints for too long, moving or not.

    A single report proves nothing: a driver that was kept waiting by a busy machine commands at
    once where its stream is now, and its stage is there some milliseconds later.

    Parameters
    ----------
    tolerance : ToleranceConfig
        What is allowed.
    """

    def __init__(self, tolerance: ToleranceConfig) -> None:
        self._tolerance = tolerance
        self._away_since_s: dict[int, float] = {}

    def check(self, reports: Sequence[StageReport | None]) -> None:
        """Take in the last reports.

        Parameters
        ----------
        reports : sequence of 3 StageReport or None
            Of fingers 1, 2, 3; None: nothing arrived yet.

        Raises
        ------
        RunFailed
            PATH_TOLERANCE: says finger, axis, how far, for how long, and what is allowed.
        """
        limits = self._tolerance
        for finger, report in enumerate(reports, start=1):
            if report is None or report.mode not in FOLLOWING:
                self._away_since_s.pop(finger, None)
                continue
            away_um = np.abs(report.position_um - report.command_um)
            allowed_um = limits.path_um + limits.lag_s * np.abs(report.velocity_um_s)
            axis = int(np.argmax(away_um - allowed_um))
            if away_um[axis] <= allowed_um[axis]:
                self._away_since_s.pop(finger, None)
                continue
            since_s = self._away_since_s.setdefault(finger, report.arrived_s)
            if report.arrived_s - since_s >= limits.path_dwell_s:
                raise RunFailed(
                    f'finger {finger}, {AXES[axis]}: {away_um[axis]:.2f} µm from its setpoint for '
                    f'{limits.path_dwell_s:g} s, allowed {allowed_um[axis]:.2g} µm',
                    PATH_TOLERANCE,
                )


def check_goal(reports: Sequence[StageReport | None], tolerance: ToleranceConfig) -> None:
    """Check where stages are that hold since a stream ended, but never came quite to rest.

    Raises
    ------
    RunFailed
        GOAL_TOLERANCE: says finger, axis, how far, and what is allowed.
    """
    for finger, report in enumerate(reports, start=1):
        if report is None or report.on_target:
            continue
        away_um = np.abs(report.position_um - report.command_um)
        axis = int(np.argmax(away_um))
        if away_um[axis] > tolerance.goal_um:
            raise RunFailed(
                f'finger {finger}, {AXES[axis]}: {away_um[axis]:.2f} µm from its setpoint '
                f'{tolerance.settle_s:g} s after the last one, allowed {tolerance.goal_um:g} µm',
                GOAL_TOLERANCE,
            )
