# SPDX-License-Identifier: Apache-2.0
"""Records of three fingers and a plan → where in the plan the run was, and the object's error."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from microhand_planner.core.plan import FINGERS, Plan
from microhand_station.analysis.finger_record import FingerRecord
from microhand_station.analysis.object_record import Deviation, ObjectRecord
from microhand_station.analysis.plan_progress import PlanProgress, plan_progress
from microhand_station.analysis.run_note import RunNote

FloatArray = NDArray[np.float64]

_AT_START_UM = 0.5
"""The plan begins when all tips are commanded to within this of its first waypoint [µm]."""


def tip_commands(
    fingers: Mapping[int, FingerRecord], base_um: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return when and where the tips were commanded: (n,) [s] and (n, 3, 3) [µm], station frame.

    At the times of finger 1's states; the others are interpolated.

    Parameters
    ----------
    fingers : mapping
        All three fingers.
    base_um : (3, 3) array
        Of the stages.
    """
    time_s = np.maximum.accumulate(fingers[1].state_time_s)
    columns = [
        np.interp(time_s, np.maximum.accumulate(finger.state_time_s), finger.commanded_um[:, axis])
        + base_um[number - 1, axis]
        for number, finger in sorted(fingers.items())
        for axis in range(3)
    ]
    return time_s, np.stack(columns, axis=1).reshape(-1, FINGERS, 3)


def progress_of(
    plan: Plan | None,
    note: RunNote,
    fingers: Mapping[int, FingerRecord],
    told_s: FloatArray,
    told_step: NDArray[np.int64],
) -> PlanProgress | None:
    """Return where in the plan the run was; None: it never began, or something is missing.

    Parameters
    ----------
    plan : Plan or None
        What was to be done.
    note : RunNote
        Where the stages are, and how stiff the fingers.
    fingers : mapping
        What was recorded of them.
    told_s, told_step : (m,) array
        When the sequencer said in which step it was, and that step.
    """
    complete = len(fingers) == FINGERS and all(len(f.state_time_s) for f in fingers.values())
    if plan is None or not plan.steps or not complete:
        return None
    if note.base_um is None or note.stiffness_uN_per_um is None:
        return None
    time_s, command_um = tip_commands(fingers, note.base_um)
    first = plan.steps[0]
    start_um = first.tip_um[0] + first.force_uN[0] / note.stiffness_uN_per_um[:, None]
    at_start = np.abs(command_um - start_um).max(axis=(1, 2)) < _AT_START_UM
    if not at_start.any():
        return None
    # the stages may have stood there long before
    begin = int(np.argmax(at_start))
    left = np.flatnonzero(~at_start[begin:])
    begin += max(0, int(left[0]) - 1) if len(left) else 0
    touches = [
        (float(when_s), number, at_um + note.base_um[number - 1])
        for number, finger in fingers.items()
        for when_s, at_um in zip(finger.touched_time_s, finger.touched_um, strict=True)
        if when_s >= time_s[begin]
    ]
    return plan_progress(
        plan,
        note.stiffness_uN_per_um,
        time_s[begin:],
        command_um[begin:],
        told_s,
        told_step,
        touches,
    )


def planned_at(place: PlanProgress, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the plan has the object: positions (n, 3) [µm], quaternions (n, 4) wxyz.

    Parameters
    ----------
    place : PlanProgress
        Where in the plan the run was, at least at one time.
    time_s : (n,) array
        Times; outside those of `place` its first or last pose.
    """
    position_um = np.stack(
        [np.interp(time_s, place.time_s, place.position_um[:, axis]) for axis in range(3)], axis=1
    )
    count = len(place.time_s)
    before = np.clip(np.searchsorted(place.time_s, time_s, side='right') - 1, 0, count - 1)
    after = np.minimum(before + 1, count - 1)
    gap_s = np.maximum(place.time_s[after] - place.time_s[before], 1e-12)
    share = np.clip((time_s - place.time_s[before]) / gap_s, 0.0, 1.0)[:, None]
    orientation = Rotation.from_quat(place.quaternion_wxyz[:, [1, 2, 3, 0]])
    turn = (orientation[before].inv() * orientation[after]).as_rotvec()
    xyzw = (orientation[before] * Rotation.from_rotvec(share * turn)).as_quat()
    return position_um, xyzw[:, [3, 0, 1, 2]]


def from_commands(place: PlanProgress, body: ObjectRecord) -> Deviation:
    """Return how far the object was from where the plan has it, by the commands of the stages."""
    kept = (body.time_s >= place.time_s[0]) & (body.time_s <= place.time_s[-1])
    if not kept.any():
        return Deviation(np.zeros(0), np.zeros(0), np.zeros(0))
    position_um, wxyz = planned_at(place, body.time_s[kept])
    found = Rotation.from_quat(body.quaternion_wxyz[kept][:, [1, 2, 3, 0]])
    angle_rad = (Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).inv() * found).magnitude()
    return Deviation(
        time_s=body.time_s[kept],
        angle_deg=np.degrees(angle_rad),
        distance_um=np.linalg.norm(body.position_um[kept] - position_um, axis=1),
        source='commands',
    )
