# SPDX-License-Identifier: Apache-2.0
"""From grasps to motions: the steps of a plan, as waypoints in the station frame."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation

from microhand_planner.core.parameters import Finger
from microhand_planner.core.plan import FINGERS, Step, StepKind
from microhand_planner.core.planned_rotation import PlannedRotation
from microhand_planner.core.pose import FloatArray, Pose
from microhand_planner.core.search_state import ABSENT
from microhand_planner.core.transfer import Blocked, way_around, way_out

_ROLL_SPACING_RAD = math.radians(1.0)
_CARRY_SPACING_UM = 1.0


class _Hand:
    """Object and fingers while the steps are being made: where they are after the last one."""

    def __init__(
        self, pose: Pose, finger: Finger, waiting_radius_um: float, blocked: Blocked
    ) -> None:
        self.origin_um = np.asarray(pose.position_um)
        self.attitude = pose.rotation
        # relative to the object's origin, station axes
        self.tip_um: FloatArray = np.zeros((FINGERS, 3))
        self.normal: FloatArray = np.full((FINGERS, 3), np.nan)
        self.finger = finger
        self.waiting_radius_um = waiting_radius_um
        self.blocked = blocked

    def in_contact(self) -> tuple[bool, bool, bool]:
        """Return which fingers touch the object."""
        touching = np.isfinite(self.normal[:, 0])
        return bool(touching[0]), bool(touching[1]), bool(touching[2])

    def way_out_um(
        self, finger: int, tip_um: FloatArray, normal: FloatArray, plane_normal: FloatArray
    ) -> FloatArray:
        """Return a finger's way from a contact to the waiting sphere, station axes."""
        holding = [other for other in range(FINGERS) if self.in_contact()[other]]
        others_um = self.tip_um[[other for other in holding if other != finger]]
        to_object = self.attitude.inv()
        way_um = way_out(
            to_object.apply(tip_um),
            to_object.apply(normal),
            plane_normal,
            to_object.apply(others_um) if len(others_um) else np.zeros((0, 3)),
            self.waiting_radius_um,
            self.finger,
            self.blocked,
        )
        return np.asarray(self.attitude.apply(way_um))

    def moved(
        self,
        kind: StepKind,
        rotation: int,
        tips_um: FloatArray,
        *,
        finger: int = 0,
        angle_rad: float = 0.0,
        attitudes: Rotation | None = None,
        normals: FloatArray | None = None,
        origins_um: FloatArray | None = None,
    ) -> Step:
        """Return a step along waypoints (n, 3, 3), and stand at its end."""
        n = len(tips_um)
        if attitudes is None:
            attitudes = Rotation.concatenate([self.attitude] * n)
        if normals is None:
            normals = np.repeat(self.normal[None], n, axis=0)
        if origins_um is None:
            origins_um = np.repeat(self.origin_um[None], n, axis=0)
        x, y, z, w = attitudes.as_quat().T
        step = Step(
            kind=kind,
            rotation=rotation,
            finger=finger,
            angle_rad=angle_rad,
            in_contact=self.in_contact(),
            object_position_um=origins_um,
            object_quaternion_wxyz=np.column_stack([w, x, y, z]),
            tip_um=tips_um + origins_um[:, None, :],
            normal=normals,
        )
        self.tip_um = tips_um[-1]
        self.normal = normals[-1]
        self.origin_um = origins_um[-1]
        self.attitude = attitudes[-1]
        return step


def finger_motions(
    sequence: Sequence[PlannedRotation],
    start: Pose,
    goal: Pose,
    finger: Finger,
    waiting_radius_um: float,
    blocked: Blocked,
    *,
    held: bool = False,
) -> tuple[Step, ...]:
    """Turn the chosen grasps into the motions of three fingers.

    Parameters
    ----------
    sequence : sequence of PlannedRotation
        In order; fingers continue from one to the next.
    start, goal : Pose
        Object in the station frame.
    finger : Finger
        Tips.
    waiting_radius_um : float
        See `transfer.waiting_radius_um`.
    blocked : callable
        Whether a tip touches the object at any of the given centres, object frame.
    held : bool
        True: the fingers of the first grasp hold the object already, and do not approach it.

    Returns
    -------
    tuple of Step
        Each begins where the one before ended.

    Raises
    ------
    InadmissibleContact
        A finger has no free way to or from a contact.
    """
    hand = _Hand(start, finger, waiting_radius_um, blocked)
    approach = _first_grasp(hand, sequence[0])
    steps = [] if held else [approach]
    for index, planned in enumerate(sequence):
        steps.extend(_rotation(hand, index, planned))
    steps.extend(_carried(hand, len(sequence) - 1, goal))
    return tuple(steps)


def _contacts(
    hand: _Hand, planned: PlannedRotation, state: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return tip centres and normals (3, 3) of a state, station axes; NaN for free fingers."""
    tip_um = np.full((FINGERS, 3), np.nan)
    normal = np.full((FINGERS, 3), np.nan)
    *tracks, orientation = state
    placed = [finger for finger in range(FINGERS) if tracks[finger] != ABSENT]
    samples = [planned.lattice.sample_of[tracks[finger], orientation] for finger in placed]
    plane = planned.curve.plane
    tip_um[placed] = hand.attitude.apply(plane.to_object(planned.lattice.centre_um[samples]))
    normal[placed] = hand.attitude.apply(plane.to_object(planned.lattice.normal[samples]))
    return tip_um, normal


def _first_grasp(hand: _Hand, planned: PlannedRotation) -> Step:
    """Close the first grasp: its fingers come in together, the third one waits aside."""
    tip_um, normal = _contacts(hand, planned, planned.states[0])
    closing = [finger for finger in range(FINGERS) if np.isfinite(tip_um[finger, 0])]
    ways: dict[int, FloatArray] = {
        finger: hand.way_out_um(
            finger, tip_um[finger], normal[finger], planned.curve.plane.normal
        )[::-1]
        for finger in closing
    }
    n = max(len(way) for way in ways.values())
    aside_um = _aside(hand, [way[0] for way in ways.values()])
    tips_um = np.array(np.broadcast_to(aside_um, (n, FINGERS, 3)))
    for finger, way_um in ways.items():
        share = interp1d(np.linspace(0.0, 1.0, len(way_um)), way_um, axis=0)
        tips_um[:, finger] = share(np.linspace(0.0, 1.0, n))
    step = hand.moved(StepKind.APPROACH, 0, tips_um)
    hand.normal = normal
    return step


def _aside(hand: _Hand, taken_um: Sequence[FloatArray]) -> FloatArray:
    """Return the end of a station axis on the waiting sphere that is farthest from others."""
    directions = np.vstack([np.eye(3), -np.eye(3)])
    nearest = np.max(directions @ np.array(taken_um).T, axis=1)
    return np.asarray(hand.waiting_radius_um * directions[np.argmin(np.round(nearest, 6))])


def _rotation(hand: _Hand, index: int, planned: PlannedRotation) -> Iterator[Step]:
    """Make the steps of one planar rotation: rolls in one piece, and regrasps."""
    states = planned.states
    turns = np.sign(np.diff(states[:, 3]))
    for turn, group in itertools.groupby(range(len(turns)), key=lambda edge: turns[edge]):
        edges = list(group)
        if turn:
            yield _roll(hand, index, planned, edges[0], edges[-1] + 1)
        else:
            for edge in edges:
                yield from _regrasp(hand, index, planned, states[edge], states[edge + 1])


def _roll(hand: _Hand, index: int, planned: PlannedRotation, first: int, last: int) -> Step:
    """Roll with the placed fingers from one state to another: exact at every waypoint."""
    lattice, curve = planned.lattice, planned.curve
    state = planned.states[first]
    from_rad = float(lattice.theta_rad[state[3]])
    to_rad = float(lattice.theta_rad[planned.states[last, 3]])
    angle_rad = to_rad - from_rad
    angles = np.linspace(0.0, angle_rad, math.ceil(abs(angle_rad) / _ROLL_SPACING_RAD) + 1)
    attitudes = hand.attitude * Rotation.from_rotvec(np.outer(angles, curve.plane.normal))
    tips_um = np.repeat(hand.tip_um[None], len(angles), axis=0)
    normals = np.repeat(hand.normal[None], len(angles), axis=0)
    for finger in range(FINGERS):
        if state[finger] == ABSENT:
            continue
        phase_rad = lattice.phase_rad[lattice.sample_of[state[finger], state[3]]]
        points = curve.at(phase_rad - angles * lattice.phase_per_angle)
        tips_um[:, finger] = attitudes.apply(curve.plane.to_object(points.centre_um))
        normals[:, finger] = attitudes.apply(curve.plane.to_object(points.normal))
    # the two sections of a mesh meet on the joints within its facets' accuracy, not better
    tips_um[0] = hand.tip_um
    return hand.moved(
        StepKind.ROLL, index, tips_um, angle_rad=angle_rad, attitudes=attitudes, normals=normals
    )


def _regrasp(
    hand: _Hand,
    index: int,
    planned: PlannedRotation,
    before: Sequence[int],
    after: Sequence[int],
) -> Iterator[Step]:
    """Place the fingers that are new in a grasp, then remove those that left it."""
    plane_normal = planned.curve.plane.normal
    tip_um, normal = _contacts(hand, planned, after)
    for finger in range(FINGERS):
        if before[finger] == ABSENT and after[finger] != ABSENT:
            inward_um = hand.way_out_um(finger, tip_um[finger], normal[finger], plane_normal)[::-1]
            way_um = np.vstack([way_around(hand.tip_um[finger], inward_um[0])[:-1], inward_um])
            yield _one_moves(hand, StepKind.PLACE, index, finger, way_um)
            hand.normal = hand.normal.copy()
            hand.normal[finger] = normal[finger]
    for finger in range(FINGERS):
        if before[finger] != ABSENT and after[finger] == ABSENT:
            way_um = hand.way_out_um(
                finger, hand.tip_um[finger], hand.normal[finger], plane_normal
            )
            hand.normal = hand.normal.copy()
            hand.normal[finger] = np.nan
            yield _one_moves(hand, StepKind.REMOVE, index, finger, way_um)


def _one_moves(hand: _Hand, kind: StepKind, index: int, finger: int, way_um: FloatArray) -> Step:
    """Move one finger along a way, the others stand."""
    tips_um = np.repeat(hand.tip_um[None], len(way_um), axis=0)
    tips_um[:, finger] = way_um
    return hand.moved(kind, index, tips_um, finger=finger + 1)


def _carried(hand: _Hand, index: int, goal: Pose) -> Iterator[Step]:
    """Carry the object to its goal position: all fingers translate with it."""
    way_um = np.asarray(goal.position_um) - hand.origin_um
    distance_um = float(np.linalg.norm(way_um))
    if distance_um == 0.0:
        return
    share = np.linspace(0.0, 1.0, math.ceil(distance_um / _CARRY_SPACING_UM) + 1)
    tips_um = np.repeat(hand.tip_um[None], len(share), axis=0)
    origins_um = hand.origin_um + share[:, None] * way_um
    yield hand.moved(StepKind.TRANSLATE, index, tips_um, origins_um=origins_um)
