# SPDX-License-Identifier: Apache-2.0
"""Plan to timed setpoints: where every tip is, and how fast, at each tick of the stream."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from microhand_planner.core.errors import InvalidPlan
from microhand_planner.core.parameters import check_number
from microhand_planner.core.plan import Step
from microhand_planner.core.pose import FloatArray, readonly
from microhand_planner.core.waypoint_curve import curve_through

PEAK_OF_MINIMUM_JERK = 1.875
"""Largest speed of the minimum-jerk time law over its mean speed ([Flash1985])."""

JOIN_TOLERANCE_UM = 1e-4
"""Steps whose tips differ by more than this where they meet are not one motion [µm]."""


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
    period_s : float
        Time between two setpoints [s].
    """

    roll_rate_rad_s: float = math.radians(90.0)
    travel_um_s: float = 400.0
    axis_um_s: float = 500.0
    period_s: float = 0.002

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('roll_rate', self.roll_rate_rad_s, low=0.0, high=100.0, low_open=True)
        check_number('travel_speed', self.travel_um_s, low=0.0, high=1e6, low_open=True)
        check_number('axis_velocity', self.axis_um_s, low=0.0, high=1e6, low_open=True)
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


def time_steps(steps: Sequence[Step], pace: Pace) -> Trajectory:
    """Turn the waypoints of a plan's steps into setpoints.

    Each step runs from rest to rest under the minimum-jerk time law, along a C1 curve through
    its waypoints, as fast as `pace` allows: its duration is rounded up to whole periods, so that
    every step begins and ends on a setpoint. All fingers, and the object, move in step.

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
    if not steps:
        raise InvalidPlan('steps', 'empty', 'at least one step')
    for number, (before, after) in enumerate(itertools.pairwise(steps), start=1):
        gap_um = float(np.abs(after.tip_um[0] - before.tip_um[-1]).max())
        if gap_um > JOIN_TOLERANCE_UM:
            raise InvalidPlan(
                f'step {number}', f'{gap_um:.4f} µm away from the end of the step before', 'no gap'
            )
    pieces = [_time_step(step, pace) for step in steps]
    # the last setpoint of a step is the first of the next one
    kept = [piece if i == 0 else tuple(a[1:] for a in piece) for i, piece in enumerate(pieces)]
    tip, velocity, position, quaternion = (
        np.concatenate(parts) for parts in zip(*kept, strict=True)
    )
    counts = np.array([len(piece[0]) for piece in kept])
    return Trajectory(
        period_s=pace.period_s,
        tip_um=tip,
        velocity_um_s=velocity,
        object_position_um=position,
        object_quaternion_wxyz=quaternion,
        step_of=np.repeat(np.arange(len(steps)), counts),
        step_end=np.cumsum(counts) - 1,
    )


def minimum_jerk(progress: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the minimum-jerk law and its derivative at `progress` in [0, 1] ([Flash1985]).

    Examples
    --------
    >>> import numpy as np
    >>> [float(value[0]) for value in minimum_jerk(np.array([0.5]))]
    [0.5, 1.875]
    """
    x = progress
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * x**2 * (1.0 - x) ** 2


def _time_step(step: Step, pace: Pace) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Sample one step: tips, velocities, object positions and quaternions."""
    times, orientation = _fastest_times(step, pace)
    # a waypoint that repeats the one before takes no time and adds nothing to the curve
    distinct = np.concatenate([[True], np.diff(times) > 0.0])
    if np.count_nonzero(distinct) < 2:
        return (
            step.tip_um[[0, -1]],
            np.zeros((2, *step.tip_um.shape[1:])),
            step.object_position_um[[0, -1]],
            step.object_quaternion_wxyz[[0, -1]],
        )
    times = times[distinct]
    curve = curve_through(times, step.tip_um[distinct])
    tip_um_s, axis_um_s = curve.speed_bounds()
    slower = max(1.0, tip_um_s / pace.travel_um_s, axis_um_s / pace.axis_um_s)
    periods = max(1, math.ceil(PEAK_OF_MINIMUM_JERK * slower * times[-1] / pace.period_s))
    share, share_rate = minimum_jerk(np.arange(periods + 1) / periods)
    parameter = share * times[-1]
    tip, derivative = curve.at(parameter)
    velocity = derivative * (share_rate * times[-1] / (periods * pace.period_s))[:, None, None]
    x, y, z, w = Slerp(times, orientation[distinct])(parameter).as_quat().T
    position = np.stack(
        [np.interp(parameter, times, axis) for axis in step.object_position_um[distinct].T], axis=1
    )
    return tip, velocity, position, np.stack([w, x, y, z], axis=1)


def _fastest_times(step: Step, pace: Pace) -> tuple[FloatArray, Rotation]:
    """Return when each waypoint could be reached at full speed all along, and the orientations.

    Used as the curve's parameter, this makes a roll turn the object evenly and a travel
    move the fastest finger evenly.
    """
    orientation = Rotation.from_quat(step.object_quaternion_wxyz[:, [1, 2, 3, 0]])
    turn_s = (orientation[:-1].inv() * orientation[1:]).magnitude() / pace.roll_rate_rad_s
    chord_um = np.linalg.norm(np.diff(step.tip_um, axis=0), axis=-1).max(axis=1)
    fastest = np.maximum(turn_s, chord_um / pace.travel_um_s)
    # below a nanosecond it is rounding, not motion
    fastest[fastest < 1e-9] = 0.0
    return np.concatenate([[0.0], np.cumsum(fastest)]), orientation
