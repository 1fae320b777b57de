# SPDX-License-Identifier: Apache-2.0
"""Timed trajectories: at rest at both ends, through the waypoints, within speed and travel."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Ruckig
from ruckig import Trajectory as Profile
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import (
    InvalidNumber,
    InvalidParameter,
    InvalidPlan,
    TravelExceeded,
)
from microhand_planner.core.plan import Step, StepKind
from microhand_planner.core.trajectory import Pace, time_steps
from microhand_planner.core.travel import StageLimits, check_travel
from microhand_planner.core.waypoint_curve import curve_through

PACE = Pace(roll_rate_rad_s=math.radians(90.0), travel_um_s=300.0, axis_um_s=250.0)
NOWHERE = np.full((1, 3), np.nan)


def make_step(kind, tip_um, rotation=None, angle_rad=0.0):
    """Make a step from tips (n, 3, 3) and, if the object turns, its n orientations."""
    n = len(tip_um)
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    if rotation is not None:
        quaternion = rotation.as_quat()[:, [3, 0, 1, 2]]
    return Step(
        kind=kind,
        rotation=0,
        finger=0,
        angle_rad=angle_rad,
        in_contact=(False, False, False),
        object_position_um=np.zeros((n, 3)),
        object_quaternion_wxyz=quaternion,
        tip_um=tip_um,
        normal=np.broadcast_to(NOWHERE, (n, 3, 3)),
    )


def roll(angle_deg, radius_um=20.0):
    """Turn the object about z in steps of one degree, with three tips on a circle."""
    theta = np.radians(np.arange(angle_deg + 1.0))
    phases = theta[:, None] + np.radians([0.0, 120.0, 240.0])
    tip = radius_um * np.stack([np.cos(phases), np.sin(phases), 0 * phases], axis=-1)
    turn = Rotation.from_rotvec(theta[:, None] * [0.0, 0.0, 1.0])
    return make_step(StepKind.ROLL, tip, turn, math.radians(angle_deg))


def travel(*corners_um, after=None):
    """Move finger 1 along a polyline, from the end of the step before; the other two stand."""
    tip = np.zeros((len(corners_um), 3, 3))
    tip[:, 0] = corners_um
    tip[:, 1, 0], tip[:, 2, 0] = 40.0, -40.0
    if after is not None:
        tip += after.tip_um[-1] - tip[0]
    return make_step(StepKind.PLACE, tip)


def distance_to_polyline(points, line):
    """Return the distance of each point (n, 3) to the polyline through `line` (m, 3)."""
    a, b = line[:-1][None], line[1:][None]
    length2 = np.maximum(np.sum((b - a) ** 2, axis=-1), 1e-30)
    along = np.clip(np.sum((points[:, None] - a) * (b - a), axis=-1) / length2, 0.0, 1.0)
    return np.linalg.norm(points[:, None] - (a + along[..., None] * (b - a)), axis=-1).min(axis=1)


def test_every_step_begins_and_ends_at_rest_at_its_own_waypoints():
    """At a step's end all velocities are zero and the tips are at its last waypoint exactly."""
    first = roll(40)
    second = make_step(StepKind.TRANSLATE, first.tip_um[-1] + np.array([0, 8.0])[:, None, None])
    timed = time_steps([first, second], PACE)
    ends = [0, *timed.step_end]
    np.testing.assert_array_equal(timed.velocity_um_s[ends], 0.0)
    waypoints = np.stack([first.tip_um[0], first.tip_um[-1], second.tip_um[-1]])
    np.testing.assert_allclose(timed.tip_um[ends], waypoints, atol=1e-12)
    assert timed.step_of[0] == 0
    assert [timed.step_of[end] for end in timed.step_end] == [0, 1]
    assert len(timed) == timed.step_end[-1] + 1


def test_velocity_is_the_derivative_of_position():
    """Central differences of the positions give the velocities to second order."""
    turn = roll(60)
    timed = time_steps([turn, travel((0, 0, 0), (30, 5, 0), (30, 40, 0), after=turn)], PACE)
    difference = (timed.tip_um[2:] - timed.tip_um[:-2]) / (2 * timed.period_s)
    inside = np.diff(timed.step_of)[1:] == 0
    inside &= np.diff(timed.step_of)[:-1] == 0
    error = np.abs(difference - timed.velocity_um_s[1:-1])[inside]
    assert error.max() < 0.01 * np.abs(timed.velocity_um_s).max()


def test_positions_and_velocities_are_continuous():
    """Between two setpoints nothing jumps: steps of both are bounded by the motion's own scale."""
    turn = roll(90)
    timed = time_steps([turn, travel((20, 0, 0), (50, 0, 0), (50, 30, 0), after=turn)], PACE)
    jump = np.linalg.norm(np.diff(timed.tip_um[: timed.step_end[0] + 1], axis=0), axis=-1)
    assert jump.max() <= PACE.roll_rate_rad_s * 20.0 * timed.period_s * 1.001
    acceleration = np.linalg.norm(np.diff(timed.velocity_um_s, axis=0), axis=-1) / timed.period_s
    along = PACE.acceleration_um_s2
    inward = 20.0 * PACE.roll_rate_rad_s**2
    assert acceleration.max() <= math.hypot(along, inward) * 1.001


corners_um = st.lists(st.tuples(*3 * [st.floats(-50.0, 50.0)]), min_size=2, max_size=8)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(corners_um, st.floats(50.0, 1000.0), st.floats(1e3, 1e5), st.floats(1e4, 1e7))
def test_acceleration_and_jerk_stay_within_the_pace_on_any_polyline(
    corners, travel_um_s, acceleration_um_s2, jerk_um_s3
):
    """Differences of the sampled velocities are the judge; corners are no exception.

    A difference over one period is a mean over it, which no peak within it can be below.
    """
    pace = Pace(
        travel_um_s=travel_um_s,
        axis_um_s=1000.0,
        acceleration_um_s2=acceleration_um_s2,
        jerk_um_s3=jerk_um_s3,
        period_s=0.001,
    )
    timed = time_steps([travel(*corners)], pace)
    acceleration = np.diff(timed.velocity_um_s[:, 0], axis=0) / pace.period_s
    assert np.linalg.norm(acceleration, axis=1).max() <= acceleration_um_s2 * (1 + 1e-6)
    jerk = np.diff(acceleration, axis=0) / pace.period_s
    # where the path turns while at rest, the jerks of braking and of starting add up
    assert np.linalg.norm(jerk, axis=1).max(initial=0.0) <= 2 * jerk_um_s3 * (1 + 1e-6)
    np.testing.assert_array_equal(timed.velocity_um_s[[0, -1]], 0.0)


def test_a_straight_line_has_the_seven_phases_of_limited_jerk():
    """100 µm at 400 µm/s, 5 mm/s² and 250 mm/s³: the times follow by hand.

    Jerk for 20 ms reaches 5 mm/s², which is held for 60 ms to reach 400 µm/s after 100 ms and
    20 µm; braking is the mirror image, so that 60 µm are left for full speed: 0.15 s.
    """
    pace = Pace(travel_um_s=400.0, axis_um_s=500.0, acceleration_um_s2=5e3, jerk_um_s3=2.5e5)
    timed = time_steps([travel((0, 0, 0), (60, 0, 0), (100, 0, 0))], pace)
    assert timed.duration_s == pytest.approx(0.35)
    at = {t: i for i, t in enumerate(np.round(np.arange(len(timed)) * pace.period_s, 6))}
    tip, speed = timed.tip_um[:, 0, 0], timed.velocity_um_s[:, 0, 0]
    assert speed[at[0.02]] == pytest.approx(2.5e5 * 0.02**2 / 2)
    assert tip[at[0.02]] == pytest.approx(2.5e5 * 0.02**3 / 6)
    assert speed[at[0.05]] == pytest.approx(50.0 + 5e3 * 0.03)
    assert (tip[at[0.1]], speed[at[0.1]]) == (pytest.approx(20.0), pytest.approx(400.0))
    assert (tip[at[0.25]], speed[at[0.25]]) == (pytest.approx(80.0), pytest.approx(400.0))
    assert speed == pytest.approx(speed[::-1], abs=1e-6)


def test_a_tip_rests_at_sharp_corners_and_only_there():
    """At a right angle the tip stands for an instant; through a bend of 10° it runs on."""
    bend = math.radians(10.0)
    sharp = time_steps([travel((0, 0, 0), (30, 0, 0), (30, 30, 0))], PACE)
    blunt = time_steps(
        [travel((0, 0, 0), (30, 0, 0), (30 + 30 * math.cos(bend), 30 * math.sin(bend), 0))], PACE
    )
    corner_um = np.array([30.0, 0.0, 0.0])
    for timed, rests in ((sharp, True), (blunt, False)):
        nearest = int(np.argmin(np.linalg.norm(timed.tip_um[:, 0] - corner_um, axis=1)))
        speed_um_s = np.linalg.norm(timed.velocity_um_s[nearest, 0])
        assert (speed_um_s == 0.0) == rests
        if rests:
            assert timed.tip_um[nearest, 0] == pytest.approx(corner_um, abs=1e-12)
        else:
            assert speed_um_s > 100.0


def test_a_finger_that_starts_later_makes_the_others_wait():
    """Where one finger begins to move, those that move already rest, too: nothing jerks."""
    tip = np.zeros((3, 3, 3))
    tip[:, 0, 0] = 0.0, 20.0, 40.0
    tip[:, 1, 1] = 30.0, 30.0, 50.0
    timed = time_steps([make_step(StepKind.APPROACH, tip)], PACE)
    acceleration = np.diff(timed.velocity_um_s, axis=0) / PACE.period_s
    assert np.linalg.norm(acceleration, axis=-1).max() <= PACE.acceleration_um_s2 * (1 + 1e-6)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(10, 200_000), st.floats(1.0, 500.0), st.floats(1e2, 1e5), st.floats(1e3, 1e7))
def test_sampled_time_laws_are_those_of_ruckig(length_nm, speed, acceleration, jerk):
    """A tip on a line is where ruckig itself says, if its clock is slowed to whole periods."""
    length_um = length_nm / 1000.0
    pace = Pace(
        travel_um_s=speed,
        axis_um_s=1e3,
        acceleration_um_s2=acceleration,
        jerk_um_s3=jerk,
        period_s=0.01,
    )
    timed = time_steps([travel((0, 0, 0), (length_um, 0, 0))], pace)
    demand = InputParameter(1)
    demand.target_position = [length_um]
    demand.max_velocity, demand.max_acceleration = [speed], [acceleration]
    demand.max_jerk = [jerk]
    profile = Profile(1)
    Ruckig(1).calculate(demand, profile)
    assert profile.duration <= timed.duration_s + 1e-9
    assert timed.duration_s <= profile.duration + pace.period_s
    times_s = np.linspace(0.0, profile.duration, len(timed))
    expected = [profile.at_time(time_s)[0][0] for time_s in times_s]
    assert timed.tip_um[:, 0, 0] == pytest.approx(expected, abs=1e-9 * length_um + 1e-12)


def test_a_roll_follows_the_circle_and_turns_the_object_with_the_tips():
    """With waypoints 1° apart tips stay on the circle within 1 nm and turn with the object."""
    timed = time_steps([roll(100)], PACE)
    np.testing.assert_allclose(np.linalg.norm(timed.tip_um, axis=-1), 20.0, atol=1e-3)
    turn = Rotation.from_quat(timed.object_quaternion_wxyz[:, [1, 2, 3, 0]])
    carried = turn.apply([20.0, 0.0, 0.0])
    np.testing.assert_allclose(timed.tip_um[:, 0], carried, atol=2e-3)


def test_a_roll_takes_its_peak_rate_and_no_more():
    """The fastest turn between two setpoints is the nominal rate, within one percent."""
    timed = time_steps([roll(90)], PACE)
    turn = Rotation.from_quat(timed.object_quaternion_wxyz[:, [1, 2, 3, 0]])
    rate = (turn[:-1].inv() * turn[1:]).magnitude().max() / timed.period_s
    assert 0.99 * PACE.roll_rate_rad_s < rate <= PACE.roll_rate_rad_s * (1 + 1e-9)


def test_a_travel_passes_its_corners_and_stays_on_its_chords():
    """A tip stops at a right-angled corner and does not leave the chords, so cuts nothing."""
    corners = np.array([(0.0, 0, 0), (30, 0, 0), (30, 20, 0), (10, 20, 15)])
    timed = time_steps([travel(*corners)], PACE)
    path = timed.tip_um[:, 0]
    assert distance_to_polyline(path, corners).max() < 1e-9
    assert distance_to_polyline(corners, path).max() < 1e-3
    np.testing.assert_array_equal(timed.tip_um[:, 1], np.tile([40.0, 0, 0], (len(timed), 1)))


def test_a_gap_between_steps_is_refused():
    """A step that begins elsewhere would make the tips jump."""
    with pytest.raises(InvalidPlan, match=r'step 1 is 3\.0000 µm away'):
        time_steps([travel((0, 0, 0), (5, 0, 0)), travel((8, 0, 0), (9, 0, 0))], PACE)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(*3 * [st.floats(-50.0, 50.0)]), min_size=2, max_size=12),
    st.floats(10.0, 1000.0),
    st.floats(10.0, 1000.0),
)
def test_no_setpoint_is_faster_than_the_limits(corners, travel_um_s, axis_um_s):
    """Whatever the waypoints, tip speed and axis velocity stay within the pace everywhere."""
    pace = Pace(travel_um_s=travel_um_s, axis_um_s=axis_um_s)
    timed = time_steps([travel(*corners)], pace)
    speed = np.linalg.norm(timed.velocity_um_s, axis=-1).max()
    assert speed <= travel_um_s * (1 + 1e-9)
    assert np.abs(timed.velocity_um_s).max() <= axis_um_s * (1 + 1e-9)
    chord_um_s = np.abs(np.diff(timed.tip_um, axis=0)).max(initial=0.0) / timed.period_s
    assert chord_um_s <= axis_um_s * (1 + 1e-6)


def test_a_smooth_curve_bends_no_further_than_it_says():
    """Between waypoints on an arc the curve stays within L sin(a/2) of the chord."""
    theta = np.radians(np.arange(0.0, 91.0, 10.0))
    arc = 30.0 * np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1)
    curve = curve_through(theta, arc[:, None])
    points, _ = curve.at(np.linspace(0.0, theta[-1], 2000))
    chord = np.linalg.norm(arc[1] - arc[0])
    assert distance_to_polyline(points[:, 0], arc).max() <= chord * math.sin(math.radians(5.0))
    # and it is nearer to the arc than the chords are
    sagitta = 30.0 * (1 - math.cos(math.radians(5.0)))
    inner = points[200:-200, 0]
    assert np.abs(np.linalg.norm(inner, axis=1) - 30.0).max() < 0.05 * sagitta


def test_a_step_without_motion_holds():
    """Equal waypoints make two equal setpoints at rest, and the plan goes on after them."""
    still = travel((5, 0, 0), (5, 0, 0), (5, 0, 0))
    timed = time_steps([still, travel((5, 0, 0), (9, 0, 0))], PACE)
    assert timed.step_end[0] == 1
    np.testing.assert_array_equal(timed.tip_um[0], timed.tip_um[1])
    assert timed.tip_um[-1, 0, 0] == pytest.approx(9.0)


def test_a_plan_without_steps_is_refused():
    """There is nothing to time in an empty plan."""
    with pytest.raises(InvalidPlan, match='at least one step'):
        time_steps([], PACE)


STAGE = StageLimits((-50.0, -50.0, -50.0), (0.0, 0.0, 0.0), (100.0, 100.0, 100.0), 500.0)


def test_travel_within_the_limits_passes():
    """A roll on a circle of 20 µm in the middle of 100 µm of travel is allowed."""
    timed = time_steps([roll(40)], PACE)
    check_travel(timed.tip_um, timed.velocity_um_s, [STAGE] * 3)


def test_travel_error_names_finger_axis_demand_and_limit():
    """Finger 1 at station y = 60 µm is at 110 µm of a stage that reaches 100 µm."""
    timed = time_steps([travel((0, 0, 0), (0, 60, 0))], PACE)
    with pytest.raises(TravelExceeded) as error:
        check_travel(timed.tip_um, timed.velocity_um_s, [STAGE] * 3)
    assert str(error.value) == (
        'finger 1 y is at 110.000 µm of its stage; allowed: 0.000 to 100.000 µm'
    )


def test_velocity_error_names_the_slow_stage():
    """A stage that is slower than the pace assumes is named with its velocity."""
    slow = StageLimits(STAGE.base_um, STAGE.lower_um, STAGE.upper_um, 100.0)
    timed = time_steps([travel((0, 0, 0), (0, 40, 0))], PACE)
    with pytest.raises(TravelExceeded, match=r'finger 1 y is moving at 2\d\d\.\d µm/s; .*100\.0'):
        check_travel(timed.tip_um, timed.velocity_um_s, [slow, STAGE, STAGE])


def test_acceleration_error_names_the_weak_stage():
    """A stage that accelerates less than the pace assumes is named; one that can, passes."""
    timed = time_steps([travel((0, 0, 0), (0, 40, 0))], PACE)
    weak, strong = (
        dataclasses.replace(STAGE, max_acceleration_um_s2=most)
        for most in (1e3, PACE.acceleration_um_s2 * (1 + 1e-6))
    )
    check_travel(timed.tip_um, timed.velocity_um_s, [strong] * 3, PACE.period_s)
    with pytest.raises(
        TravelExceeded, match=r'finger 1 y is accelerating at [45]\d{3}\.\d µm/s²; .*1000\.0 µm/s²'
    ):
        check_travel(timed.tip_um, timed.velocity_um_s, [weak, STAGE, STAGE], PACE.period_s)
    # fingers 2 and 3 stand still: a weak stage of theirs does not matter
    check_travel(timed.tip_um, timed.velocity_um_s, [strong, weak, weak], PACE.period_s)


def test_accelerations_need_to_know_the_time_between_setpoints():
    """A limit that could not be checked is an error, not a check that passes."""
    timed = time_steps([travel((0, 0, 0), (0, 40, 0))], PACE)
    limited = dataclasses.replace(STAGE, max_acceleration_um_s2=1e9)
    with pytest.raises(InvalidParameter, match='period_s is None'):
        check_travel(timed.tip_um, timed.velocity_um_s, [limited] * 3)


@pytest.mark.parametrize(
    ('changes', 'error', 'field'),
    [
        ({'base_um': (0.0, math.nan, 0.0)}, InvalidNumber, 'base_um'),
        ({'upper_um': (1.0, 2.0)}, InvalidNumber, 'upper_um'),
        ({'lower_um': (0.0, 0.0, 100.0)}, InvalidParameter, 'lower_um'),
        ({'max_velocity_um_s': 0.0}, InvalidParameter, 'max_velocity_um_s'),
        ({'max_acceleration_um_s2': -1.0}, InvalidParameter, 'max_acceleration_um_s2'),
        ({'max_acceleration_um_s2': math.nan}, InvalidParameter, 'max_acceleration_um_s2'),
    ],
)
def test_limits_that_are_none_are_refused(changes, error, field):
    """NaN, wrong shapes, an empty travel, and speeds or accelerations of zero and less."""
    with pytest.raises(error, match=f'^{field} is '):
        dataclasses.replace(STAGE, **changes)
