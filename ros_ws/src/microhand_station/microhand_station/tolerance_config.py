# SPDX-License-Identifier: Apache-2.0
"""How far stages may be from where they are commanded to be before a run ends."""

from __future__ import annotations

from dataclasses import dataclass

from microhand_planner.core.parameters import check_number


@dataclass(frozen=True)
class ToleranceConfig:
    """What is allowed at the start of a plan, on its way and at the end of each motion.

    All are per finger and axis.

    Parameters
    ----------
    start_um : float
        A finger that shall hold the object from the beginning may be so far from there [µm].
    path_um : float
        A stage may be so far from its setpoint, besides `lag_s` [µm].
    lag_s : float
        A stage may be late by so much: `path_um` grows by this time its measured speed [s].
    path_dwell_s : float
        A stage that is farther away for so long ends the run [s].
    goal_um : float
        At the end of a motion a stage may stay so far from its last setpoint [µm].
    settle_s : float
        It gets so long to come within its driver's window, or this tolerance [s].
    """

    start_um: float = 2.0
    path_um: float = 0.5
    lag_s: float = 0.05
    path_dwell_s: float = 0.1
    goal_um: float = 0.05
    settle_s: float = 2.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('start_um', self.start_um, low=0.001, high=100.0)
        check_number('path_um', self.path_um, low=0.001, high=1000.0)
        check_number('lag_s', self.lag_s, low=0.0, high=1.0)
        check_number('path_dwell_s', self.path_dwell_s, low=0.0, high=10.0)
        check_number('goal_um', self.goal_um, low=0.001, high=100.0)
        check_number('settle_s', self.settle_s, low=0.1, high=60.0)
