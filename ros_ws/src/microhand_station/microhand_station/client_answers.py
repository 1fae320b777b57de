# SPDX-License-Identifier: Apache-2.0
"""What a station answers: a plan, how an execution ended, or why not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from microhand_planner.core.errors import MicrohandError
from microhand_planner.core.plan import Plan


@dataclass(frozen=True)
class PlanAnswer:
    """A plan, and what it took.

    Parameters
    ----------
    plan : Plan
        What was asked for.
    planning_time_s : float
        In the planner [s].
    goal_error_rad : float
        Angle between the goal and the orientation that the plan reaches [rad].
    """

    plan: Plan
    planning_time_s: float
    goal_error_rad: float


@dataclass(frozen=True)
class ExecutionResult:
    """How an execution ended.

    Parameters
    ----------
    record_file : Path or None
        The record; None: not recorded.
    setpoints_sent : int
        To each finger.
    duration_s : float
        Of the motion [s].
    held : bool or None
        Whether the object was held throughout; None: nothing watched it to the end.
    final_error_rad : float or None
        Orientation error at the end [rad]; None: nothing watched the object.
    record_error : str
        What is wrong with the record, if the run went on all the same; empty: nothing.
    """

    record_file: Path | None
    setpoints_sent: int
    duration_s: float
    held: bool | None
    final_error_rad: float | None
    record_error: str = ''


class StationError(MicrohandError):
    """What a node of the station answered instead of a result.

    Parameters
    ----------
    message : str
        As the node said it.
    code : int
        See ErrorCode; its hundreds decide the exit status.
    execution : ExecutionResult, optional
        How far an execution came that failed.
    """

    def __init__(self, message: str, code: int, execution: ExecutionResult | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.exit_status = {1: 2, 2: 3}.get(code // 100, 4)
        self.execution = execution
