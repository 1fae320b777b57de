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

SILENCE_S = 0.9
"""A twin that has not reported for longer is gone [s]; it falls silent if a stage does."""


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


@dataclass(frozen=True)
class Deviation:
    """How far the object is from where the plan has it.

    Parameters
    ----------
    stamp_ns : int
        ROS time to which it refers [ns].
    angle_rad, distance_um : float
        Turned and displaced by so much [rad], [µm].
    """

    stamp_ns: int
    angle_rad: float
    distance_um: float

    def check(self, tolerance: TwinConfig) -> None:
        """Check that it is small enough.

        Raises
        ------
        RunFailed
            OBJECT_LOST; says by how much.
        """
        turned_deg = math.degrees(self.angle_rad)
        if turned_deg > tolerance.object_tolerance_deg:
            raise RunFailed(
                f'the object is lost: turned {turned_deg:.1f}° away from where the plan has it; '
                f'allowed: {tolerance.object_tolerance_deg:g}°',
                OBJECT_LOST,
            )
        if self.distance_um > tolerance.object_tolerance_um:
            raise RunFailed(
                f'the object is lost: {self.distance_um:.2f} µm away from where the plan has it; '
                f'allowed: {tolerance.object_tolerance_um:g} µm',
                OBJECT_LOST,
            )


def deviation(report: ObjectReport, planned: Pose) -> Deviation:
    """Return how far the object is from where the plan has it at the time of the report."""
    return Deviation(
        report.stamp_ns,
        angle_between_rad(report.pose.rotation, planned.rotation),
        float(np.linalg.norm(np.subtract(report.pose.position_um, planned.position_um))),
    )
