# SPDX-License-Identifier: Apache-2.0
"""Plan to timed setpoints: where every tip is, and how fast, at each tick of the stream."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from ruckig import InputParameter, Ruckig
from ruckig import Trajectory as Profile
from scipy.spatial.transform import Rotation, Slerp

from microhand_planner.core.errors import InvalidPlan
from microhand_planner.core.parameters import check_number
from microhand_planner.core.plan import Step
from microhand_planner.core.pose import FloatArray, readonly
from microhand_planner.core.waypoint_curve import corners, curve_through

Timed = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Setpoints: tips, velocities, object positions and quaternions."""

JOIN_TOLERANCE_UM = 1e-4
"""Steps whose tips differ by more than this where they meet are not one motion [µm]."""


_SAME_PERIOD = 1e-9


@dataclass(frozen=True)
class Pace:
    """How fast a plan is executed.

    Parameters
    ----------
    roll_rate_rad_s : float
        Largest rate at which the object is turned [rad/s].
    travel_um_s : float
        Largest speed of a tip, over all axes [µm/s].
    axis_um_s : float
        Largest velocity of one axis: what every stage can do [µm/s].
    acceleration_um_s2, jerk_um_s3 : float
        Largest acceleration of the fastest tip along its path, and largest jerk.
    period_s : float
        Time between two setpoints [s].
    """

    roll_rate_rad_s: float = math.radians(90.0)
    travel_um_s: float = 400.0
    axis_um_s: float = 500.0
    acceleration_um_s2: float = 5e3
    jerk_um_s3: float = 2.5e5
    period_s: float = 0.002

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('roll_rate', self.roll_rate_rad_s, low=0.0, high=100.0, low_open=True)
        check_number('travel_speed', self.travel_um_s, low=0.0, high=1e6, low_open=True)
        check_number('axis_velocity', self.axis_um_s, low=0.0, high=1e6, low_open=True)
        check_number('acceleration', self.acceleration_um_s2, low=0.0, high=1e9, low_open=True)
        check_number('jerk', self.jerk_um_s3, low=0.0, high=1e12, low_open=True)
        check_number('period', self.period_s, low=1e-4, high=0.1)


@dataclass(frozen=True)
class Trajectory:
    """n setpoints, one per period, that begin and end at rest.

    Parameters
    ----------
    period_s : float
        Time between two setpoints [s]; setpoint i is due at ``i * period_s``.
    tip_um : (n, 3, 3) float
        Tip centres of fingers 1, 2, 3, station frame [µm].
    velocity_um_s : (n, 3, 3) float
        Their time derivatives [µm/s].
    object_position_um : (n, 3) float
        Where the plan has the object origin, station frame [µm].
    object_quaternion_wxyz : (n, 4) float
        Where the plan has the object's orientation, station frame.
    step_of : (n,) int
        Step that the setpoint belongs to; the first setpoint belongs to the first step.
    step_end : (s,) int
        Index of the last setpoint of each step: all fingers are at rest there.
    """

    period_s: float
    tip_um: FloatArray
    velocity_um_s: FloatArray
    object_position_um: FloatArray
    object_quaternion_wxyz: FloatArray
    step_of: npt.NDArray[np.int64]
    step_end: npt.NDArray[np.int64]

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ('tip_um', 'velocity_um_s', 'object_position_um', 'object_quaternion_wxyz'):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        self.step_of.setflags(write=False)
        self.step_end.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of setpoints."""
        return len(self.tip_um)

    @property
    def duration_s(self) -> float:
        """Time from the first setpoint to the last [s]."""
        return (len(self) - 1) * self.period_s


@dataclass(frozen=True)
class Piece:
    """A part of a plan that runs from rest to rest.

    Parameters
    ----------
    step : int
        Step of the plan that it belongs to.
    tip_um : (n, 3, 3) float
        Waypoints of fingers 1, 2, 3, station frame [µm].
    object_position_um : (n, 3) float
        Where the plan has the object origin, station frame [µm].
    object_quaternion_wxyz : (n, 4) float
        Where the plan has the object's orientation, station frame.
    pace : Pace
        How fast.
    """

    step: int
    tip_um: FloatArray
    object_position_um: FloatArray
    object_quaternion_wxyz: FloatArray
    pace: Pace


def time_steps(steps: Sequence[Step], pace: Pace) -> Trajectory:
    """Turn the waypoints of steps into setpoints, without forces; see `time_pieces`.

    Parameters
    ----------
    steps : sequence of Step
        At least one; each begins where the one before it ended.
    pace : Pace
        Speeds that no setpoint exceeds.

    Raises
    ------
    InvalidPlan
        There is no step, or one does not begin where the one before it ended.
    """
    return time_pieces(
        [
            Piece(number, step.tip_um, step.object_position_um, step.object_quaternion_wxyz, pace)
            for number, step in enumerate(steps)
        ]
    )


def time_pieces(pieces: Sequence[Piece]) -> Trajectory:
    """Turn the waypoints of pieces into setpoints.

    Each piece runs from rest to rest, with limited jerk ([Berscheid2021]), along a C1 curve
    through its waypoints, as fast as its pace allows; at sharp corners it rests, too. The time
    from rest to rest is rounded up to whole periods, so that every piece begins and ends on a
    setpoint. All fingers, and the object, move in step.

    Parameters
    ----------
    pieces : sequence of Piece
        At least one, all of one period; each begins where the one before it ended.

    Raises
    ------
    InvalidPlan
        There is no piece, or one does not begin where the one before it ended.
    """
    if not pieces:
        raise InvalidPlan('steps', 'empty', 'at least one step')
    for before, after in itertools.pairwise(pieces):
        gap_um = float(np.abs(after.tip_um[0] - before.tip_um[-1]).max())
        if gap_um > JOIN_TOLERANCE_UM:
            raise InvalidPlan(
                f'step {after.step}',
                f'{gap_um:.4f} µm away from the end of the step before',
                'no gap',
            )
    timed = [_time_piece(piece) for piece in pieces]
    tip, velocity, position, quaternion = _joined(timed)
    counts = np.array([len(piece[0]) - (number > 0) for number, piece in enumerate(timed)])
    steps = np.array([piece.step for piece in pieces])
    ends = np.cumsum(counts) - 1
    return Trajectory(
        period_s=pieces[0].pace.period_s,
        tip_um=tip,
        velocity_um_s=velocity,
        object_position_um=position,
        object_quaternion_wxyz=quaternion,
        step_of=np.repeat(steps, counts),
        step_end=ends[np.append(steps[1:] != steps[:-1], True)],
    )


def _time_piece(piece: Piece) -> Timed:
    """Sample one piece: tips, velocities, object positions and quaternions."""
    times, orientation = _fastest_times(piece)
    # a waypoint that repeats the one before takes no time and adds nothing to the curve
    distinct = np.concatenate([[True], np.diff(times) > 0.0])
    if np.count_nonzero(distinct) < 2:
        return (
            piece.tip_um[[0, -1]],
            np.zeros((2, *piece.tip_um.shape[1:])),
            piece.object_position_um[[0, -1]],
            piece.object_quaternion_wxyz[[0, -1]],
        )
    times, orientation = times[distinct], orientation[distinct]
    tip_um, position_um = piece.tip_um[distinct], piece.object_position_um[distinct]
    rests = [0, *corners(tip_um), len(times) - 1]
    return _joined(
        _time_stretch(
            times[first : last + 1] - times[first],
            tip_um[first : last + 1],
            position_um[first : last + 1],
            orientation[first : last + 1],
            piece.pace,
        )
        for first, last in itertools.pairwise(rests)
    )


def _joined(parts: Iterable[Timed]) -> Timed:
    """Join what was sampled one after the other: the last setpoint is the first of the next."""
    tip, velocity, position, quaternion = zip(*parts, strict=True)
    return (_in_one(tip), _in_one(velocity), _in_one(position), _in_one(quaternion))


def _in_one(parts: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])


def _time_stretch(
    times_s: FloatArray,
    tip_um: FloatArray,
    position_um: FloatArray,
    orientation: Rotation,
    pace: Pace,
) -> Timed:
    """Sample a stretch without corners, as `_time_piece`."""
    curve = curve_through(times_s, tip_um)
    parameter, rate = _time_law(float(times_s[-1]), *curve.speed_bounds(), pace)
    tip, derivative = curve.at(parameter)
    x, y, z, w = Slerp(times_s, orientation)(parameter).as_quat().T
    position = np.stack([np.interp(parameter, times_s, axis) for axis in position_um.T], axis=1)
    return tip, derivative * rate[:, None, None], position, np.stack([w, x, y, z], axis=1)


def _time_law(
    length_s: float, tip_um_s: float, axis_um_s: float, pace: Pace
) -> tuple[FloatArray, FloatArray]:
    """Return the curve's parameter at each setpoint, from 0 to `length_s`, and its rate.

    At rate 1 the fastest tip runs at `tip_um_s` at most, and the fastest axis at `axis_um_s`.
    """
    law = Ruckig(1)
    demand = InputParameter(1)
    demand.target_position = [length_s]
    demand.max_velocity = [min(1.0, pace.travel_um_s / tip_um_s, pace.axis_um_s / axis_um_s)]
    demand.max_acceleration = [pace.acceleration_um_s2 / tip_um_s]
    demand.max_jerk = [pace.jerk_um_s3 / tip_um_s]
    profile = Profile(1)
    law.calculate(demand, profile)
    periods = max(1, math.ceil(profile.duration / pace.period_s - _SAME_PERIOD))
    slower = profile.duration / (periods * pace.period_s)
    parameter, rate = _sampled(profile, np.linspace(0.0, profile.duration, periods + 1))
    rate *= slower
    parameter[[0, -1]], rate[[0, -1]] = (0.0, length_s), 0.0
    return np.clip(parameter, 0.0, length_s), rate


def _sampled(profile: Profile, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity of a profile of one axis that begins at rest.

    Its seven phases have constant jerk. All setpoints at once: a call for each of them is what
    most of the time would go into.
    """
    ((phases,),) = profile.profiles
    begins_s = np.concatenate([[0.0], np.cumsum(phases.t)[:-1]])
    phase = np.searchsorted(begins_s, time_s, side='right') - 1
    jerk, acceleration, velocity, position = (
        np.array(values)[phase] for values in (phases.j, phases.a, phases.v, phases.p)
    )
    t = time_s - begins_s[phase]
    return (
        position + t * (velocity + t * (acceleration / 2.0 + t * jerk / 6.0)),
        velocity + t * (acceleration + t * jerk / 2.0),
    )


def _fastest_times(piece: Piece) -> tuple[FloatArray, Rotation]:
    """Return when each waypoint could be reached at full speed all along, and the orientations.

    Used as the curve's parameter, this makes a roll turn the object evenly and a travel
    move the fastest finger evenly.
    """
    orientation = Rotation.from_quat(piece.object_quaternion_wxyz[:, [1, 2, 3, 0]])
    turn_s = (orientation[:-1].inv() * orientation[1:]).magnitude() / piece.pace.roll_rate_rad_s
    chord_um = np.linalg.norm(np.diff(piece.tip_um, axis=0), axis=-1).max(axis=1)
    fastest = np.maximum(turn_s, chord_um / piece.pace.travel_um_s)
    # below a nanosecond it is rounding, not motion
    fastest[fastest < 1e-9] = 0.0
    return np.concatenate([[0.0], np.cumsum(fastest)]), orientation
