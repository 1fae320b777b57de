# SPDX-License-Identifier: Apache-2.0
"""A plan: what the fingers and the object do, step by step, and what it costs."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from microhand_planner.core.errors import InvalidPlan
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.pose import FARTHEST_UM, LENGTH_DIGITS, FloatArray, Pose

FINGERS = 3
FORMAT_VERSION = '1.0'


class StepKind(Enum):
    """What happens in a step."""

    APPROACH = 'approach'
    """Free fingers travel to where the plan begins, and touch the object for the first grasp."""
    ROLL = 'roll'
    """The fingers in contact roll the object about an axis."""
    PLACE = 'place'
    """A free finger travels to the object and touches it."""
    REMOVE = 'remove'
    """A finger detaches and retreats."""
    TRANSLATE = 'translate'
    """All fingers carry the object along."""


@dataclass(frozen=True)
class Step:
    """One step: n waypoints that object and fingers pass through together.

    Parameters
    ----------
    kind : StepKind
        What happens.
    rotation : int
        Index of the planar rotation that the step belongs to.
    finger : int
        1, 2 or 3; 0: the step is not of one finger.
    angle_rad : float
        Signed rotation of the object in this step; 0 unless the kind is ROLL [rad].
    in_contact : tuple of 3 bool
        Fingers that touch the object during the whole step.
    object_position_um : (n, 3) float
        Object origin, station frame [µm].
    object_quaternion_wxyz : (n, 4) float
        Object orientation, station frame.
    tip_um : (n, 3, 3) float
        Tip centres of fingers 1, 2, 3, station frame [µm].
    normal : (n, 3, 3) float
        Outward surface normals at the contacts, station frame; NaN: not in contact.

    Raises
    ------
    InvalidPlan
        Shapes that do not fit together, fewer than two waypoints, or numbers that are not finite
        or beyond 10 cm.
    """

    kind: StepKind
    rotation: int
    finger: int
    angle_rad: float
    in_contact: tuple[bool, bool, bool]
    object_position_um: FloatArray
    object_quaternion_wxyz: FloatArray
    tip_um: FloatArray
    normal: FloatArray

    def __post_init__(self) -> None:
        """Check shapes and numbers, freeze the arrays."""
        n = len(self.tip_um)
        shapes = {
            'object_position_um': (n, 3),
            'object_quaternion_wxyz': (n, 4),
            'tip_um': (n, FINGERS, 3),
            'normal': (n, FINGERS, 3),
        }
        for name, shape in shapes.items():
            array = np.array(getattr(self, name), dtype=np.float64)
            if name.endswith('_um'):
                array = np.round(array, LENGTH_DIGITS)
            array.setflags(write=False)
            if n < 2 or array.shape != shape:
                raise InvalidPlan(name, f'of shape {array.shape}', f'shape {shape}, n >= 2')
            expected = np.isfinite(array[:, self.in_contact, :] if name == 'normal' else array)
            if not np.all(expected):
                raise InvalidPlan(name, 'not finite', 'finite numbers')
            if np.any(np.abs(array) > FARTHEST_UM):
                raise InvalidPlan(name, 'too large', f'numbers up to {FARTHEST_UM:g}')
            object.__setattr__(self, name, array)
        if not np.isfinite(self.angle_rad):
            raise InvalidPlan('angle', self.angle_rad, 'a finite number')
        if self.finger not in range(FINGERS + 1):
            raise InvalidPlan('finger', self.finger, '0, 1, 2 or 3')

    def __len__(self) -> int:
        """Return the number of waypoints."""
        return len(self.tip_um)


@dataclass(frozen=True)
class RotationReport:
    """How one planar rotation was found, as in [Kumar2021] Table 4.

    Parameters
    ----------
    axis : str
        ``'z'`` or ``'y'``, of the object frame.
    angle_deg, cost_deg : float
        Signed angle, and cost by [Kumar2021] Eq. 11 and 12 [deg].
    reconfigurations : int
        Placements + removals.
    expanded : int
        States that the search expanded.
    time_s : float
        Wall time of the search [s]; not part of the plan's hash.
    """

    axis: str
    angle_deg: float
    cost_deg: float
    reconfigurations: int
    expanded: int
    time_s: float


@dataclass(frozen=True)
class Plan:
    """A reorientation, ready for execution.

    Parameters
    ----------
    object_name, object_sha256 : str
        The part that it was made for.
    start, goal : Pose
        Object in the station frame, before and after.
    finger, law, options : Finger, ContactLaw, SearchOptions
        What the planner assumed.
    steps : tuple of Step
        In the order of execution; each begins where the one before ended.
    rotations : tuple of RotationReport
        One per planar rotation.
    """

    object_name: str
    object_sha256: str
    start: Pose
    goal: Pose
    finger: Finger
    law: ContactLaw
    options: SearchOptions
    steps: tuple[Step, ...]
    rotations: tuple[RotationReport, ...]

    @property
    def cost_deg(self) -> float:
        """Sum of the rotations' costs [deg]."""
        return sum(rotation.cost_deg for rotation in self.rotations)

    @property
    def reconfigurations(self) -> int:
        """Sum over the rotations; the initial grasp is not counted."""
        return sum(rotation.reconfigurations for rotation in self.rotations)

    @property
    def reached(self) -> Pose:
        """Pose of the object after the last step; the start if there is none."""
        if not self.steps:
            return self.start
        last = self.steps[-1]
        return Pose(last.object_position_um[-1], last.object_quaternion_wxyz[-1])
