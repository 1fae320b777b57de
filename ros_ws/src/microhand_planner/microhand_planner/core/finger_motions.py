# SPDX-License-Identifier: Apache-2.0
"""From grasps to motions: the steps of a plan, as waypoints in the station frame."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation

from microhand_planner.core.grip_forces import GripForces
from microhand_planner.core.hold import Hold
from microhand_planner.core.parameters import Finger
from microhand_planner.core.plan import FINGERS, Step, StepKind
from microhand_planner.core.planned_rotation import PlannedRotation
from microhand_planner.core.pose import FloatArray, Pose
from microhand_planner.core.search_state import ABSENT
from microhand_planner.core.transfer import Blocked, way_around, way_out

_ROLL_SPACING_RAD = math.radians(1.0)
_CARRY_SPACING_UM = 1.0
_SAME_FORCE_UN = 1e-6


class _Hand:
    """Object and fingers while the steps are being made: where they are after the last one."""

    def __init__(
        self,
        pose: Pose,
        finger: Finger,
        grip: GripForces,
        waiting_radius_um: float,
        blocked: Blocked,
    ) -> None:
        self.origin_um = np.asarray(pose.position_um)
        self.attitude = pose.rotation
        # relative to the object's origin, station axes
        self.tip_um: FloatArray = np.zeros((FINGERS, 3))
        self.normal: FloatArray = np.full((FINGERS, 3), np.nan)
        self.force_uN: FloatArray = np.zeros((FINGERS, 3))
        self.finger = finger
        self.grip = grip
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
        forces_uN: FloatArray | None = None,
        hold: Hold | None = None,
    ) -> Step:
        """Return a step along waypoints (n, 3, 3), and stand at its end."""
        n = len(tips_um)
        if attitudes is None:
            attitudes = Rotation.concatenate([self.attitude] * n)
        if normals is None:
            normals = np.repeat(self.normal[None], n, axis=0)
        if origins_um is None:
            origins_um = np.repeat(self.origin_um[None], n, axis=0)
        if forces_uN is None:
            forces_uN = np.repeat(self.force_uN[None], n, axis=0)
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
            force_uN=forces_uN,
            hold=hold,
        )
        self.tip_um = tips_um[-1]
        self.normal = normals[-1]
        self.force_uN = forces_uN[-1]
        self.origin_um = origins_um[-1]
        self.attitude = attitudes[-1]
        return step

    def ramped(self, rotation: int, force_uN: FloatArray) -> Iterator[Step]:
        """Make the step that brings the fingers to other forces, unless they have them."""
        if np.abs(force_uN - self.force_uN).max() > _SAME_FORCE_UN:
            tips_um = np.repeat(self.tip_um[None], 2, axis=0)
            forces_uN = np.stack([self.force_uN, force_uN])
            yield self.moved(StepKind.GRIP, rotation, tips_um, forces_uN=forces_uN)


def finger_motions(
    sequence: Sequence[PlannedRotation],
    start: Pose,
    goal: Pose,
    finger: Finger,
    grip: GripForces,
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
    grip : GripForces
        How firmly they hold.
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
    hand = _Hand(start, finger, grip, waiting_radius_um, blocked)
    approach = _first_grasp(hand, sequence[0])
    steps = [approach]
    steps.extend(hand.ramped(0, _holding_uN(hand, sequence[0], sequence[0].states[0])))
    if held:
        steps = []
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


def _in_plane(
    planned: PlannedRotation, state: Sequence[int]
) -> tuple[list[int], FloatArray, FloatArray]:
    """Return placed fingers, their contacts [µm] and normals (k, 2) in the plane, of a state."""
    *tracks, orientation = state
    placed = [finger for finger in range(FINGERS) if tracks[finger] != ABSENT]
    samples = [planned.lattice.sample_of[tracks[finger], orientation] for finger in placed]
    return placed, planned.lattice.contact_um[samples], planned.lattice.normal[samples]


def _holding_uN(hand: _Hand, planned: PlannedRotation, state: Sequence[int]) -> FloatArray:
    """Return the forces (3, 3) with which a grasp holds, station axes."""
    placed, contact_um, normal = _in_plane(planned, state)
    force_uN, _ = hand.grip.while_holding(contact_um[None], normal[None])
    return _in_station(hand, planned, placed, force_uN[0])


def _in_station(
    hand: _Hand, planned: PlannedRotation, fingers: list[int], force_uN: FloatArray
) -> FloatArray:
    """Return forces (k, 2) of some fingers in the plane as forces (3, 3), station axes."""
    forces_uN = np.zeros((FINGERS, 3))
    forces_uN[fingers] = hand.attitude.apply(planned.curve.plane.to_object(force_uN))
    return forces_uN


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
    forces_uN = np.repeat(hand.force_uN[None], len(angles), axis=0)
    placed = [finger for finger in range(FINGERS) if state[finger] != ABSENT]
    points = [
        curve.at(
            lattice.phase_rad[lattice.sample_of[state[finger], state[3]]]
            - angles * lattice.phase_per_angle
        )
        for finger in placed
    ]
    force_uN, hold = hand.grip.while_holding(
        np.stack([at.contact_um for at in points], axis=1),
        np.stack([at.normal for at in points], axis=1),
    )
    for number, finger in enumerate(placed):
        for rows, values in (
            (tips_um, points[number].centre_um),
            (normals, points[number].normal),
            (forces_uN, force_uN[:, number]),
        ):
            rows[:, finger] = attitudes.apply(curve.plane.to_object(values))
    # the two sections of a mesh meet on the joints within its facets' accuracy, not better
    tips_um[0] = hand.tip_um
    forces_uN[0] = hand.force_uN
    return hand.moved(
        StepKind.ROLL,
        index,
        tips_um,
        angle_rad=angle_rad,
        attitudes=attitudes,
        normals=normals,
        forces_uN=forces_uN,
        hold=hold,
    )


def _regrasp(
    hand: _Hand,
    index: int,
    planned: PlannedRotation,
    before: Sequence[int],
    after: Sequence[int],
) -> Iterator[Step]:
    """Place the fingers that are new in a grasp, then remove those that left it.

    The fingers that stay take over the grip before another one leaves, and hold as the roll wants
    it afterwards.
    """
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
            stays, stay_um, stay_normal = _in_plane(planned, after)
            _, leave_um, leave_normal = _in_plane(planned, _alone(before, finger))
            force_uN, hold = hand.grip.while_releasing(
                stay_um, stay_normal, leave_um[0], leave_normal[0]
            )
            yield from hand.ramped(index, _in_station(hand, planned, stays, force_uN))
            way_um = hand.way_out_um(
                finger, hand.tip_um[finger], hand.normal[finger], plane_normal
            )
            hand.normal = hand.normal.copy()
            hand.normal[finger] = np.nan
            yield _one_moves(hand, StepKind.REMOVE, index, finger, way_um, hold)
    yield from hand.ramped(index, _holding_uN(hand, planned, after))


def _alone(state: Sequence[int], finger: int) -> tuple[int, int, int, int]:
    """Return a state with one of its fingers alone."""
    first, second, third = (
        state[other] if other == finger else ABSENT for other in range(FINGERS)
    )
    return first, second, third, state[3]


def _one_moves(
    hand: _Hand,
    kind: StepKind,
    index: int,
    finger: int,
    way_um: FloatArray,
    hold: Hold | None = None,
) -> Step:
    """Move one finger along a way, the others stand."""
    tips_um = np.repeat(hand.tip_um[None], len(way_um), axis=0)
    tips_um[:, finger] = way_um
    return hand.moved(kind, index, tips_um, finger=finger + 1, hold=hold)


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
