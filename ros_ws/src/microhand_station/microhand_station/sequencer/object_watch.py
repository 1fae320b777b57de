# SPDX-License-Identifier: Apache-2.0
"""What the twin reports about the object, judged: is it held, and where the plan has it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import Pose, angle_between_rad
from microhand_station.contact_config import TwinConfig

OBJECT_LOST = 306
TWIN_MISSING = 309

SILENCE_S = 0.5
"""A twin that has not reported for longer is gone [s]."""


@dataclass(frozen=True)
class ObjectReport:
    """The last state of the object.

    Parameters
    ----------
    arrived_s : float
        When it arrived, on the sequencer's steady clock [s].
    stamp_ns : int
        ROS time to which it refers [ns].
    pose : Pose
        Of the object, station frame.
    held, released : bool
        Not lost so far; no longer fixed where it was put.
    lost_because : str
        Empty while it is held.
    """

    arrived_s: float
    stamp_ns: int
    pose: Pose
    held: bool
    released: bool
    lost_because: str


def check_held(report: ObjectReport | None, now_s: float) -> None:
    """Check that the twin reports, and that the object is not lost.

    Parameters
    ----------
    report : ObjectReport or None
        The last one; None: nothing arrived yet.
    now_s : float
        On the clock of the report [s].

    Raises
    ------
    RunFailed
        TWIN_MISSING or OBJECT_LOST.
    """
    if report is None:
        raise RunFailed('the twin is silent', TWIN_MISSING)
    silent_s = now_s - report.arrived_s
    if silent_s > SILENCE_S:
        raise RunFailed(
            f'the twin has been silent for {silent_s:.2f} s; allowed: up to {SILENCE_S:g} s',
            TWIN_MISSING,
        )
    if not report.held:
        raise RunFailed(f'the object is lost: {report.lost_because}', OBJECT_LOST)


def check_on_plan(report: ObjectReport, planned: Pose, tolerance: TwinConfig) -> None:
    """Check that the object is where the plan has it.

    Parameters
    ----------
    report : ObjectReport
        The last one.
    planned : Pose
        Of the object at the time of the report.
    tolerance : TwinConfig
        How far it may be off.

    Raises
    ------
    RunFailed
        OBJECT_LOST; says by how much.
    """
    off_deg = math.degrees(angle_between_rad(report.pose.rotation, planned.rotation))
    off_um = float(np.linalg.norm(np.subtract(report.pose.position_um, planned.position_um)))
    for off, allowed, how in (
        (off_deg, tolerance.object_tolerance_deg, f'turned by {off_deg:.1f}° off'),
        (off_um, tolerance.object_tolerance_um, f'{off_um:.2f} µm off'),
    ):
        if off > allowed:
            unit = '°' if how.startswith('turned') else ' µm'
            raise RunFailed(
                f'the object is lost: {how} where the plan has it; allowed: {allowed:g}{unit}',
                OBJECT_LOST,
            )
