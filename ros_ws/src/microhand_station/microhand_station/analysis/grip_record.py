# SPDX-License-Identifier: Apache-2.0
"""Forces that were felt, beside the plan → how firmly two fingers held, in which window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.plan import Plan
from microhand_station.analysis.grip_window import grip_windows_uN
from microhand_station.analysis.object_record import ObjectRecord
from microhand_station.analysis.plan_progress import PlanProgress
from microhand_station.analysis.table import Table

FloatArray = NDArray[np.float64]

_PAIR = 2


@dataclass(frozen=True)
class GripRecord:
    """Grip of the two fingers that hold the object. Times since the start of the run.

    A grip is the force along the line between the two contacts, > 0 pressing; NaN where the plan
    has not exactly two fingers in contact, or forces are not known.

    Attributes
    ----------
    time_s : (n,) array
        Times of the reports of the object, while the plan was executed.
    step : (n,) array of int
        Step under way.
    measured_uN, planned_uN : (n,) array
        As reported, and as planned.
    low_uN, high_uN : (n,) array
        Window in which the margin of the step is kept; NaN: none was planned.
    """

    time_s: FloatArray
    step: NDArray[np.int64]
    measured_uN: FloatArray
    planned_uN: FloatArray
    low_uN: FloatArray
    high_uN: FloatArray

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for value in vars(self).values():
            value.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of times."""
        return len(self.time_s)

    @property
    def room_uN(self) -> FloatArray:
        """Distance of the measured grip from the nearer edge of its window, (n,); < 0: outside."""
        return np.fmin(self.measured_uN - self.low_uN, self.high_uN - self.measured_uN)

    @property
    def table(self) -> Table:
        """The grips as a table."""
        return Table(dict(vars(self)))


def grip_record(plan: Plan, progress: PlanProgress, found: ObjectRecord) -> GripRecord:
    """Return the grips at the reports of the object that fall into the execution of the plan.

    Parameters
    ----------
    plan : Plan
        What was executed.
    progress : PlanProgress
        Where in the plan the run was.
    found : ObjectRecord
        Contacts and forces.
    """
    if not len(progress.time_s):
        none = np.zeros(0)
        return GripRecord(none, np.zeros(0, np.int64), none, none, none, none)
    kept = np.flatnonzero(
        (found.time_s >= progress.time_s[0]) & (found.time_s <= progress.time_s[-1])
    )
    time_s = found.time_s[kept]
    at = np.clip(np.searchsorted(progress.time_s, time_s), 0, len(progress.time_s) - 1)
    step = progress.step[at]
    touching = np.array([one.in_contact for one in plan.steps])[step]
    pair = touching.sum(axis=1) == _PAIR
    first, second = np.argmax(touching, axis=1), 2 - np.argmax(touching[:, ::-1], axis=1)
    row = np.arange(len(time_s))
    contact_um, force_uN = found.contact_um[kept], found.force_uN[kept]
    line = contact_um[row, second] - contact_um[row, first]
    length_um = np.linalg.norm(line, axis=1, keepdims=True)
    line = np.divide(line, length_um, out=np.full_like(line, np.nan), where=length_um > 0.0)
    planned_uN = np.linalg.norm(progress.force_uN[at, first], axis=1)
    # planned forces lie on the line of the contacts; two fingers can also pull
    planned_uN *= np.sign(np.einsum('ij,ij->i', progress.force_uN[at, first], np.nan_to_num(line)))
    squeeze = force_uN[row, first] - force_uN[row, second]
    measured_uN = 0.5 * np.einsum('ij,ij->i', squeeze, line)
    windows_uN = grip_windows_uN(plan)
    place, waypoint = progress.place[at], np.arange(len(windows_uN))
    # at the end of a step its window still holds: NaN of the next one must not reach back
    low_uN, high_uN = (
        np.where(
            place == np.floor(place),
            column[place.astype(int)],
            np.interp(place, waypoint, column),
        )
        for column in windows_uN.T
    )
    return GripRecord(
        time_s=time_s,
        step=step,
        measured_uN=np.where(pair, measured_uN, np.nan),
        planned_uN=np.where(pair, planned_uN, np.nan),
        low_uN=np.where(pair, low_uN, np.nan),
        high_uN=np.where(pair, high_uN, np.nan),
    )
