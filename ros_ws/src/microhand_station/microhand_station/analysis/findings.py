# SPDX-License-Identifier: Apache-2.0
"""A run → the figures that say whether it held, how well, and where it was worst."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.plan import StepKind
from microhand_planner.core.pose import Pose, angle_between_rad
from microhand_station.analysis.finger_lag import setpoint_skew_s, skew_s
from microhand_station.analysis.finger_record import TrackingError
from microhand_station.analysis.gathered import Event
from microhand_station.analysis.run import Run

FloatArray = NDArray[np.float64]

_DONE = 0.999  # of the planned time
_RECORDER_MISSING = 304  # ErrorCode.RECORDER_MISSING
_OBJECT_LOST = 306  # ErrorCode.OBJECT_LOST


@dataclass(frozen=True)
class Worst:
    """An extreme value, and where it was.

    Parameters
    ----------
    value : float
        In the unit of the quantity.
    time_s : float
        Since the start of the run.
    step : int or None
        Step of the plan, from 0; None: outside the plan.
    finger : int
        1, 2 or 3; 0: not of one finger.
    """

    value: float
    time_s: float
    step: int | None
    finger: int = 0


@dataclass(frozen=True)
class StepFindings:
    """One step of the plan as it was executed. What is not known is None.

    Parameters
    ----------
    number : int
        From 0.
    kind : StepKind
        What was to happen.
    finger : int
        1, 2 or 3; 0: the step is not of one finger.
    angle_deg : float
        Rotation of the object; 0 unless it rolls.
    begin_s, duration_s : float or None
        When, and how long; None: not reached.
    grip_uN : tuple of (float, float) or None
        Smallest and largest grip that was measured.
    room_uN : float or None
        Least distance of the grip from the edges of its window; < 0: outside.
    object_error_deg : float or None
        Largest deviation of the object's orientation from the plan.
    tracking_error_um : float or None
        Largest of the three stages.
    friction_use : float or None
        Largest share of the friction in use at a contact that the plan counts on.
    skew_s : float or None
        Delay between the earliest and the latest finger.
    """

    number: int
    kind: StepKind
    finger: int
    angle_deg: float
    begin_s: float | None
    duration_s: float | None
    grip_uN: tuple[float, float] | None
    room_uN: float | None
    object_error_deg: float | None
    tracking_error_um: float | None
    friction_use: float | None
    skew_s: float | None

    @property
    def what(self) -> str:
        """What the step does, in words."""
        if self.kind is StepKind.ROLL:
            return f'roll {self.angle_deg:+.1f}°'
        return f'{self.kind.value} finger {self.finger}' if self.finger else self.kind.value


@dataclass(frozen=True)
class Findings:
    """What a run says. What is not known is None.

    Parameters
    ----------
    held : bool or None
        Whether the object was held to the end; None: nobody watched, or the run did not begin.
    complete : bool
        Whether the plan was executed to its end.
    failure : str
        What the first node to complain said; empty: none did.
    lost : Worst or None
        When and where the object was lost; the value has no meaning.
    final_error_deg, final_error_um : float or None
        Between the object at the end and its goal.
    object_error_deg, object_error_um : Worst or None
        Largest deviation from the plan on the way.
    tracking_error : mapping of int to TrackingError
        By finger.
    room_uN : Worst or None
        Where the grip came nearest to the edge of its window, or left it.
    friction_use : Worst or None
        Where most of the friction was in use.
    skew_s, setpoint_skew_s : float or None
        Largest delay between fingers within a step; between the times of their setpoints.
    underruns : int
        Times that a stage ran out of setpoints.
    missing_setpoints : int
        Of all fingers.
    steps : tuple of StepFindings
        In the order of the plan.
    """

    held: bool | None
    complete: bool
    failure: str
    lost: Worst | None
    final_error_deg: float | None
    final_error_um: float | None
    object_error_deg: Worst | None
    object_error_um: Worst | None
    tracking_error: Mapping[int, TrackingError]
    room_uN: Worst | None
    friction_use: Worst | None
    skew_s: float | None
    setpoint_skew_s: float | None
    underruns: int
    missing_setpoints: int
    steps: tuple[StepFindings, ...]


def findings(run: Run) -> Findings:
    """Work out the figures of a run; see `Findings`."""
    steps = _steps(run)
    body, lost_at_s = run.object, run.object.lost_at_s
    failures = [event.text for event in run.events if _is_failure(event)]
    told_s = [event.time_s for event in run.events if event.error_code == _OBJECT_LOST]
    if lost_at_s is None and told_s:
        # the sequencer judges, too: an object far from its plan is lost, though fingers touch it
        lost_at_s = told_s[0]
    errors = {number: one.tracking_error for number, one in run.fingers.items()}
    skews = [step.skew_s for step in steps if step.skew_s is not None]
    released = bool(len(body) and body.released.any())
    final_deg, final_um = _final_error(run)
    return Findings(
        held=lost_at_s is None if released else None,
        complete=run.share >= _DONE and not failures,
        failure=failures[0] if failures else '',
        lost=None if lost_at_s is None else Worst(math.nan, lost_at_s, _step_at(run, lost_at_s)),
        final_error_deg=final_deg,
        final_error_um=final_um,
        object_error_deg=_worst(run, run.deviation.time_s, run.deviation.angle_deg),
        object_error_um=_worst(run, run.deviation.time_s, run.deviation.distance_um),
        tracking_error={number: error for number, error in errors.items() if error is not None},
        room_uN=None
        if run.grip is None
        else _worst(run, run.grip.time_s, run.grip.room_uN, least=True),
        friction_use=_worst_friction(run),
        skew_s=max(skews, default=None),
        setpoint_skew_s=setpoint_skew_s(run.fingers),
        underruns=sum(finger.underruns for finger in run.fingers.values()),
        missing_setpoints=sum(finger.missing for finger in run.fingers.values()),
        steps=steps,
    )


def _is_failure(event: Event) -> bool:
    """Whether a run failed with this event: a record that is not whole need not end the run."""
    ended = event.text.startswith('run ended')
    return bool(event.error_code) and (event.error_code != _RECORDER_MISSING or ended)


def holding_friction(run: Run) -> FloatArray:
    """Return the friction in use by the fingers that the plan counts on, (n, 3); NaN: others.

    A finger that comes or goes slips on purpose, and says nothing about the hold.

    Parameters
    ----------
    run : Run
        With n reports of the object.
    """
    use = np.array(run.object.friction_use)
    use[~run.object.released] = np.nan
    if run.plan is None or run.progress is None or not len(use):
        return use
    counted = np.array([step.in_contact for step in run.plan.steps], dtype=bool)
    steps = [_step_at(run, time_s) for time_s in run.object.time_s]
    rows = np.array([(False,) * 3 if step is None else counted[step] for step in steps])
    return np.where(rows, use, np.nan)


def as_json(run: Run, found: Findings) -> dict[str, Any]:
    """Return the figures as plain values: the result of ``microhand analyze --json``."""
    by_finger = {str(number): error for number, error in found.tracking_error.items()}
    plan = run.plan
    return {
        'run': run.name,
        'object': None if plan is None else plan.object_name,
        'plan_hash': run.metadata.get('plan_hash'),
        'duration_s': run.duration_s,
        'complete': found.complete,
        'failure': found.failure or None,
        'held': found.held,
        'lost_at': _worst_json(found.lost, ''),
        'final_error_deg': found.final_error_deg,
        'final_error_um': found.final_error_um,
        'object_error_deg': None
        if found.object_error_deg is None
        else found.object_error_deg.value,
        'tracking_error_um': {number: error.rms_um for number, error in by_finger.items()},
        'max_tracking_error_um': {number: error.max_um for number, error in by_finger.items()},
        'worst': {
            'object_error': _worst_json(found.object_error_deg, 'deg'),
            'object_distance': _worst_json(found.object_error_um, 'um'),
            'grip_room': _worst_json(found.room_uN, 'uN'),
            'friction_use': _worst_json(found.friction_use, 'share'),
        },
        'skew_s': found.skew_s,
        'setpoint_skew_s': found.setpoint_skew_s,
        'underruns': found.underruns,
        'missing_setpoints': found.missing_setpoints,
        'steps': [
            {**vars(step), 'number': step.number + 1, 'kind': step.kind.value}
            for step in found.steps
        ],
        'events': [vars(event) for event in run.events],
        'finished': run.finished,
        'damaged_messages': run.undecodable,
        'missing': list(run.missing),
    }


def _worst_json(worst: Worst | None, unit: str) -> dict[str, Any] | None:
    if worst is None:
        return None
    place = {'time_s': worst.time_s, 'step': None if worst.step is None else worst.step + 1}
    value = {unit: worst.value} if unit else {}
    return {**value, **place, **({'finger': worst.finger} if worst.finger else {})}


def _steps(run: Run) -> tuple[StepFindings, ...]:
    if run.plan is None:
        return ()
    use = holding_friction(run)
    made = []
    for number, step in enumerate(run.plan.steps):
        span = None if run.progress is None else run.progress.span_s(number)
        grips = room = None
        if run.grip is not None:
            at = run.grip.step == number
            grips, room = run.grip.measured_uN[at], run.grip.room_uN[at]
        stages = [
            _largest(finger.state_time_s, np.where(finger.streaming, finger.off_um, np.nan), span)
            for finger in run.fingers.values()
        ]
        off = _largest(run.deviation.time_s, run.deviation.angle_deg, span)
        made.append(
            StepFindings(
                number=number,
                kind=step.kind,
                finger=step.finger,
                angle_deg=math.degrees(step.angle_rad),
                begin_s=None if span is None else span[0],
                duration_s=None if span is None else span[1] - span[0],
                grip_uN=None
                if grips is None or not np.isfinite(grips).any()
                else (float(np.nanmin(grips)), float(np.nanmax(grips))),
                room_uN=None
                if room is None or not np.isfinite(room).any()
                else float(np.nanmin(room)),
                object_error_deg=off,
                tracking_error_um=max((x for x in stages if x is not None), default=None),
                friction_use=_largest(run.object.time_s, use, span),
                skew_s=None if span is None else skew_s(run.fingers, *span),
            )
        )
    return tuple(made)


def _largest(
    time_s: FloatArray, values: FloatArray, span: tuple[float, float] | None
) -> float | None:
    """Return the largest value within a span of time; None: there is none."""
    if span is None or not len(time_s):
        return None
    inside = values[(time_s >= span[0]) & (time_s < span[1])]
    return float(np.nanmax(inside)) if np.isfinite(inside).any() else None


def _worst(
    run: Run, time_s: FloatArray, values: FloatArray, *, least: bool = False
) -> Worst | None:
    if not np.isfinite(values).any():
        return None
    at = int(np.nanargmin(values) if least else np.nanargmax(values))
    when_s = float(time_s[at])
    return Worst(float(values[at]), when_s, _step_at(run, when_s))


def _worst_friction(run: Run) -> Worst | None:
    use = holding_friction(run)
    if not np.isfinite(use).any():
        return None
    row, finger = np.unravel_index(int(np.nanargmax(use)), use.shape)
    when_s = float(run.object.time_s[row])
    return Worst(float(use[row, finger]), when_s, _step_at(run, when_s), int(finger) + 1)


def _step_at(run: Run, time_s: float) -> int | None:
    return None if run.progress is None else run.progress.step_at(time_s)


def _final_error(run: Run) -> tuple[float | None, float | None]:
    """Return how far the object is off its goal in the last report, [deg] and [µm]."""
    if run.plan is None or not len(run.object) or not run.object.released[-1]:
        return None, None
    last = Pose(run.object.position_um[-1], run.object.quaternion_wxyz[-1])
    angle_rad = angle_between_rad(last.rotation, run.plan.goal.rotation)
    off_um = np.subtract(last.position_um, run.plan.goal.position_um)
    return math.degrees(angle_rad), float(np.linalg.norm(off_um))
