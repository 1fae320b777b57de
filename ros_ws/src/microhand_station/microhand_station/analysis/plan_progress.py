# SPDX-License-Identifier: Apache-2.0
"""Commands of the stages → where in the plan the run was at each time.

The record says only ten times a second which step was under way, and nothing about the planned
pose. But the commands are the plan: contact centres plus force over stiffness. So the place in the
plan is where the commanded tips are on the planned path, never going back, and never ahead faster
than the commands move: a path may cross itself when an object is rolled once around.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from microhand_planner.core.plan import FINGERS, Plan, Step, StepKind

FloatArray = NDArray[np.float64]

# How much farther than the commands the place in the plan may move from one time to the next:
# the path is known by waypoints, and fingers are led onto it after each contact.
_AHEAD_FACTOR = 2.0
_AHEAD_UM = 0.2
_SHORTEST_UM2 = 1e-18


@dataclass(frozen=True)
class PlanProgress:
    """Where in the plan a run was.

    Attributes
    ----------
    time_s : (n,) array
        Times since the start of the run, from when the plan began.
    place : (n,) array
        Place among the waypoints of all steps in a row, from 0.
    step : (n,) array of int
        Step under way, from 0.
    position_um : (n, 3) array
        Where the plan has the origin of the object, station frame.
    quaternion_wxyz : (n, 4) array
        Where the plan has its orientation, station frame.
    force_uN : (n, 3, 3) array
        Planned force of each finger on the object, station frame.
    """

    time_s: FloatArray
    place: FloatArray
    step: NDArray[np.int64]
    position_um: FloatArray
    quaternion_wxyz: FloatArray
    force_uN: FloatArray

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for value in vars(self).values():
            value.setflags(write=False)

    def span_s(self, step: int) -> tuple[float, float] | None:
        """Return when a step began and ended [s]; None: it was not reached."""
        at = np.flatnonzero(self.step == step)
        if not len(at):
            return None
        end = min(at[-1] + 1, len(self.time_s) - 1)
        return float(self.time_s[at[0]]), float(self.time_s[end])

    def step_at(self, time_s: float) -> int | None:
        """Return the step under way at a time; None: before the plan began."""
        before = int(np.searchsorted(self.time_s, time_s, side='right'))
        return int(self.step[before - 1]) if before else None


@dataclass(frozen=True)
class _Path:
    """The waypoints of all steps in a row.

    Attributes
    ----------
    tips_um : (w, 9) array
        Commanded tips.
    step : (w,) array of int
        Step of each waypoint.
    length_um : (w,) array
        Along the path, from its beginning.
    """

    tips_um: FloatArray
    step: NDArray[np.int64]
    length_um: FloatArray

    @classmethod
    def of(cls, plan: Plan, stiffness_uN_per_um: FloatArray) -> _Path:
        compliance = 1.0 / stiffness_uN_per_um[:, None]
        tips_um = np.concatenate(
            [(step.tip_um + step.force_uN * compliance).reshape(-1, 9) for step in plan.steps]
        )
        parts_um = np.linalg.norm(np.diff(tips_um, axis=0), axis=1)
        counts = [len(step) for step in plan.steps]
        return cls(
            tips_um,
            np.repeat(np.arange(len(plan.steps)), counts),
            np.concatenate([[0.0], np.cumsum(parts_um)]),
        )

    def nearest(
        self, tips_um: FloatArray, begin: float, steps: tuple[int, int], ahead_um: float
    ) -> float:
        """Return the place nearest to tips, in waypoints, not before `begin` nor far ahead.

        Parameters
        ----------
        tips_um : (9,) array
            Commanded tips.
        begin : float
            Earliest place.
        steps : (int, int)
            First and last step that it may be in.
        ahead_um : float
            Largest length of path from the earliest place.
        """
        first = int(np.searchsorted(self.step, steps[0]))
        last = int(np.searchsorted(self.step, steps[1], side='right')) - 1
        begin = min(max(begin, float(first)), float(last))
        here = int(begin)
        here_um = float(np.interp(begin, np.arange(len(self.step)), self.length_um))
        reach = int(np.searchsorted(self.length_um, here_um + ahead_um, side='right'))
        final = min(max(reach, here + 1), last)
        if final == here:
            return begin
        starts = self.tips_um[here:final]
        ways = self.tips_um[here + 1 : final + 1] - starts
        length2 = np.maximum(np.einsum('ij,ij->i', ways, ways), _SHORTEST_UM2)
        shares = np.clip(np.einsum('ij,ij->i', tips_um - starts, ways) / length2, 0.0, 1.0)
        shares[0] = max(shares[0], begin - here)
        off = starts + shares[:, None] * ways - tips_um
        best = int(np.argmin(np.einsum('ij,ij->i', off, off)))
        return here + best + float(shares[best])


def plan_progress(
    plan: Plan,
    stiffness_uN_per_um: FloatArray,
    time_s: FloatArray,
    command_um: FloatArray,
    told_s: FloatArray,
    told_step: NDArray[np.int64],
    touches: Sequence[tuple[float, int, FloatArray]] = (),
) -> PlanProgress:
    """Find where in the plan the commands were.

    Parameters
    ----------
    plan : Plan
        With at least one step.
    stiffness_uN_per_um : (3,) array
        Of the fingers.
    time_s : (n,) array
        Times since the start of the run, from when the plan began.
    command_um : (n, 3, 3) array
        Commanded tips of fingers 1, 2, 3 at those times, station frame.
    told_s, told_step : (m,) array
        Times at which the sequencer said in which step it was, and that step.
    touches : sequence of (float, int, (3,) array)
        Time, finger (1, 2, 3) and tip of each contact that ended a guarded motion: where a finger
        met the object, less where the plan has it meet, is in its commands until it leaves.
    """
    path = _Path.of(plan, stiffness_uN_per_um)
    last_step = len(plan.steps) - 1
    low = np.clip(_told(time_s, told_s, told_step, side='before'), 0, last_step)
    high = np.clip(_told(time_s, told_s, told_step, side='after'), 0, last_step)
    moved_um = np.linalg.norm(np.diff(command_um.reshape(-1, 9), axis=0, prepend=0.0), axis=1)
    moved_um[:1] = 0.0
    offset_um = np.zeros((FINGERS, 3))
    waiting = sorted(touches, key=lambda touch: touch[0])
    place, places = 0.0, np.zeros(len(time_s))
    for i, now_s in enumerate(time_s):
        step = plan.steps[int(path.step[int(place)])]
        while waiting and waiting[0][0] <= now_s:
            _, finger, met_um = waiting.pop(0)
            offset_um[finger - 1] = met_um - _planned_contact(plan, int(low[i]), finger)
        offset_um[_away(step)] = 0.0
        tips_um = (command_um[i] - offset_um).ravel()
        allowed = int(low[i]), max(int(low[i]), int(high[i]))
        ahead_um = _AHEAD_FACTOR * float(moved_um[i]) + _AHEAD_UM
        place = places[i] = max(place, path.nearest(tips_um, place, allowed, ahead_um))
    return _at(plan, path, time_s, places)


def _told(
    time_s: FloatArray, told_s: FloatArray, told_step: NDArray[np.int64], *, side: str
) -> NDArray[np.int64]:
    """Return the step told last before each time, or first after it."""
    if not len(told_s):
        # nobody said: any step may be
        return np.full(len(time_s), 0 if side == 'before' else np.iinfo(np.int64).max)
    if side == 'before':
        return told_step[np.clip(np.searchsorted(told_s, time_s) - 1, 0, len(told_s) - 1)]
    return told_step[np.clip(np.searchsorted(told_s, time_s), 0, len(told_s) - 1)]


def _away(step: Step) -> list[int]:
    """Return the fingers, from 0, that are off the object in a step, neither coming nor going."""
    if step.kind is StepKind.APPROACH:
        return []
    return [
        finger
        for finger in range(FINGERS)
        if not step.in_contact[finger] and finger != step.finger - 1
    ]


def _planned_contact(plan: Plan, step: int, finger: int) -> FloatArray:
    """Return the tip at which the plan has a finger meet the object, in or next after a step."""
    for later in plan.steps[step:]:
        if later.in_contact[finger - 1]:
            return np.asarray(later.tip_um[0, finger - 1])
    return np.asarray(plan.steps[-1].tip_um[-1, finger - 1])


def _at(plan: Plan, path: _Path, time_s: FloatArray, places: FloatArray) -> PlanProgress:
    """Return what the plan has at places between waypoints."""
    before = np.minimum(places.astype(int), max(len(path.step) - 2, 0))
    share = (places - before)[:, None]
    position = np.concatenate([step.object_position_um for step in plan.steps])
    quaternion = np.concatenate([step.object_quaternion_wxyz for step in plan.steps])
    force = np.concatenate([step.force_uN for step in plan.steps])
    start = Rotation.from_quat(quaternion[before][:, [1, 2, 3, 0]])
    turn = (start.inv() * Rotation.from_quat(quaternion[before + 1][:, [1, 2, 3, 0]])).as_rotvec()
    xyzw = (start * Rotation.from_rotvec(share * turn)).as_quat()
    return PlanProgress(
        time_s=np.array(time_s),
        place=places,
        step=path.step[np.minimum(np.ceil(places).astype(int), len(path.step) - 1)],
        position_um=position[before] + share * (position[before + 1] - position[before]),
        quaternion_wxyz=xyzw[:, [3, 0, 1, 2]],
        force_uN=force[before] + share[:, :, None] * (force[before + 1] - force[before]),
    )
