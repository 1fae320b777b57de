# SPDX-License-Identifier: Apache-2.0
"""Plan to motions: what is streamed in one piece, and where fingers feel for the object.

Fingers are position-controlled springs: a finger of stiffness k makes the force f by being
commanded to ``contact centre + f / k``. Where it touches the object is known only so well, and a
stiff finger that is 50 nm off either never touches or shoves the object away. So it comes in
slowly along the normal, stops at contact, and takes that position as its zero-force reference.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from microhand_planner.core.errors import InvalidParameter
from microhand_planner.core.parameters import check_number
from microhand_planner.core.plan import FINGERS, Plan, Step, StepKind
from microhand_planner.core.pose import FloatArray, readonly
from microhand_planner.core.trajectory import Pace, Piece, Trajectory, time_pieces

_RETREAT_SHARE = 4.0  # of pull_off / k: so far a retreat is slow


@dataclass(frozen=True)
class Touch:
    """How fingers meet the object, leave it, and change their forces.

    Parameters
    ----------
    speed_um_s : float
        Speed of a tip that feels for contact, or detaches [µm/s].
    standoff_um : float
        It slows down this far before the contact that the plan expects [µm].
    overtravel_um : float
        It gives up this far beyond [µm].
    force_rate_uN_s : float
        How fast forces are ramped [µN/s].
    """

    speed_um_s: float = 1.0
    standoff_um: float = 0.5
    overtravel_um: float = 0.5
    force_rate_uN_s: float = 50.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('contact_speed', self.speed_um_s, low=0.0, high=1e4, low_open=True)
        check_number('standoff', self.standoff_um, low=0.01, high=100.0)
        check_number('overtravel', self.overtravel_um, low=0.01, high=100.0)
        check_number('force_rate', self.force_rate_uN_s, low=0.0, high=1e6, low_open=True)


@dataclass(frozen=True)
class Motion:
    """One stream of setpoints, from rest to rest.

    Parameters
    ----------
    trajectory : Trajectory
        Commanded tips: contact centre + force / stiffness. `step_of` counts the plan's steps.
    contact_um : (3, 3) float
        Tip centres, station frame, at which the plan expects fingers to meet the object during
        this motion [µm]; NaN: the finger is not guarded. Guarded fingers stop at contact; the
        motion would lead them beyond.
    """

    trajectory: Trajectory
    contact_um: FloatArray

    def __post_init__(self) -> None:
        """Freeze the array."""
        object.__setattr__(self, 'contact_um', readonly(self.contact_um))

    @property
    def guarded(self) -> tuple[bool, bool, bool]:
        """Which fingers stop at contact."""
        first, second, third = np.isfinite(self.contact_um[:, 0]).tolist()
        return first, second, third


def motions(
    plan: Plan,
    pace: Pace,
    stiffness_uN_per_um: Sequence[float],
    touch: Touch = Touch(),
) -> tuple[Motion, ...]:
    """Turn a plan into motions.

    Parameters
    ----------
    plan : Plan
        With at least one step.
    pace : Pace
        Speeds that no setpoint exceeds.
    stiffness_uN_per_um : sequence of 3 float
        Of fingers 1, 2, 3 [µN/µm, which is N/m].
    touch : Touch
        How fingers meet and leave the object.

    Returns
    -------
    tuple of Motion
        Each begins where the one before ended, but for fingers that were stopped by contact.

    Raises
    ------
    InvalidPlan
        There is no step, or one does not begin where the one before it ended.
    InvalidParameter
        A stiffness that is none.
    """
    stiffness = np.asarray(stiffness_uN_per_um, dtype=np.float64)
    if stiffness.shape != (FINGERS,) or not np.all((stiffness > 0.0) & np.isfinite(stiffness)):
        raise InvalidParameter('stiffness', list(stiffness_uN_per_um), 'three numbers > 0')
    compliance = 1.0 / stiffness[:, None]
    made: list[Motion] = []
    stream: list[Piece] = []
    for piece, contact_um in _pieces(plan, pace, compliance, touch):
        if contact_um is None:
            stream.append(piece)
            continue
        if stream:
            made.append(Motion(time_pieces(stream), np.full((FINGERS, 3), np.nan)))
        made.append(Motion(time_pieces([piece]), contact_um))
        stream = []
    if stream or not made:
        made.append(Motion(time_pieces(stream), np.full((FINGERS, 3), np.nan)))
    return tuple(made)


def _pieces(
    plan: Plan, pace: Pace, compliance: FloatArray, touch: Touch
) -> Iterator[tuple[Piece, FloatArray | None]]:
    """Cut steps where the speed changes; with a guarded piece come the contacts expected."""
    slow = replace(pace, travel_um_s=min(touch.speed_um_s, pace.travel_um_s))
    detached_um = _RETREAT_SHARE * plan.law.stick_uN * float(compliance.max())
    for number, step in enumerate(plan.steps):
        command_um = step.tip_um + step.force_uN * compliance
        whole = Piece(
            number, command_um, step.object_position_um, step.object_quaternion_wxyz, pace
        )
        if step.kind is StepKind.GRIP:
            rate_um_s = touch.force_rate_uN_s * float(compliance.min())
            ramp = replace(pace, travel_um_s=min(rate_um_s, pace.travel_um_s))
            yield replace(whole, pace=ramp), None
        elif step.kind is StepKind.REMOVE:
            finger = [step.finger - 1]
            near, far = _cut(whole, finger, detached_um, from_end=False)
            yield replace(near, pace=slow), None
            yield far, None
        elif fingers := _landing(plan, number, step):
            far, near = _cut(whole, fingers, touch.standoff_um, from_end=True)
            yield far, None
            contact_um = np.full((FINGERS, 3), np.nan)
            contact_um[fingers] = step.tip_um[-1, fingers]
            yield replace(_beyond(near, fingers, touch), pace=slow), contact_um
        else:
            yield whole, None


def _landing(plan: Plan, number: int, step: Step) -> list[int]:
    """Return the fingers that a step brings into contact."""
    if step.kind is StepKind.PLACE:
        return [step.finger - 1]
    if step.kind is not StepKind.APPROACH or number + 1 == len(plan.steps):
        return []
    return [finger for finger in range(FINGERS) if plan.steps[number + 1].in_contact[finger]]


def _cut(
    piece: Piece, fingers: Sequence[int], distance_um: float, *, from_end: bool
) -> tuple[Piece, Piece]:
    """Cut a piece where the last of some fingers is a distance away from one end of its way."""
    tip_um = piece.tip_um[::-1] if from_end else piece.tip_um
    length_um = np.zeros(len(tip_um))
    length_um[1:] = np.cumsum(
        np.linalg.norm(np.diff(tip_um[:, fingers], axis=0), axis=-1).min(axis=1)
    )
    at = float(np.interp(distance_um, length_um, np.arange(len(tip_um))))
    if from_end:
        at = len(tip_um) - 1 - at
    before, share = min(int(at), len(tip_um) - 2), at - min(int(at), len(tip_um) - 2)
    cut: dict[str, tuple[Any, Any]] = {}
    for name in ('tip_um', 'object_position_um', 'object_quaternion_wxyz'):
        rows = getattr(piece, name)
        middle = rows[before] + share * (rows[before + 1] - rows[before])
        cut[name] = (
            np.concatenate([rows[: before + 1], middle[None]]),
            np.concatenate([middle[None], rows[before + 1 :]]),
        )
    first, last = (
        replace(piece, **{name: rows[side] for name, rows in cut.items()}) for side in (0, 1)
    )
    return first, last


def _beyond(piece: Piece, fingers: Sequence[int], touch: Touch) -> Piece:
    """Lead fingers on beyond the end of a piece, in the direction in which they came."""
    tip_um = np.concatenate([piece.tip_um, piece.tip_um[-1:]])
    for finger in fingers:
        way = piece.tip_um[-1, finger] - piece.tip_um[0, finger]
        tip_um[-1, finger] += touch.overtravel_um * way / np.linalg.norm(way)
    return replace(
        piece,
        tip_um=tip_um,
        object_position_um=np.concatenate(
            [piece.object_position_um, piece.object_position_um[-1:]]
        ),
        object_quaternion_wxyz=np.concatenate(
            [piece.object_quaternion_wxyz, piece.object_quaternion_wxyz[-1:]]
        ),
    )
