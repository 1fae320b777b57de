# SPDX-License-Identifier: Apache-2.0
"""A plan: what the fingers and the object do, step by step, and what it costs."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from microhand_planner.core.errors import InvalidPlan
from microhand_planner.core.hold import Hold
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, SearchOptions
from microhand_planner.core.pose import FARTHEST_UM, LENGTH_DIGITS, FloatArray, Pose

FINGERS = 3
FORMAT_VERSION = '2.0'
FORCE_DIGITS = 6
"""Forces of plans are whole piconewtons, as lengths are whole picometres."""
STRONGEST_UN = 1e5
"""Forces beyond this are no forces of micro-fingers [µN]."""


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
    GRIP = 'grip'
    """The fingers in contact stand, and ramp their forces."""


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
        Tip centres of fingers 1, 2, 3 without force, station frame [µm]. A finger of stiffness
        k is commanded to ``tip + force / k``.
    normal : (n, 3, 3) float
        Outward surface normals at the contacts, station frame; NaN: not in contact.
    force_uN : (n, 3, 3) float, optional
        Force of each finger on the object, station frame [µN]; none by default.
    hold : Hold or None
        Grip and margin of a roll or a removal; None: not planned.

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
    force_uN: FloatArray = field(default_factory=lambda: np.zeros(0))
    hold: Hold | None = None

    def __post_init__(self) -> None:
        """Check shapes and numbers, freeze the arrays."""
        n = len(self.tip_um)
        shapes = {
            'object_position_um': (n, 3),
            'object_quaternion_wxyz': (n, 4),
            'tip_um': (n, FINGERS, 3),
            'normal': (n, FINGERS, 3),
            'force_uN': (n, FINGERS, 3),
        }
        if self.force_uN.size == 0:
            object.__setattr__(self, 'force_uN', np.zeros((n, FINGERS, 3)))
        for name, shape in shapes.items():
            array = np.array(getattr(self, name), dtype=np.float64)
            if name.endswith(('_um', '_uN')):
                array = np.round(array, FORCE_DIGITS if name == 'force_uN' else LENGTH_DIGITS)
            array.setflags(write=False)
            if n < 2 or array.shape != shape:
                raise InvalidPlan(name, f'of shape {array.shape}', f'shape {shape}, n >= 2')
            expected = np.isfinite(array[:, self.in_contact, :] if name == 'normal' else array)
            if not np.all(expected):
                raise InvalidPlan(name, 'not finite', 'finite numbers')
            largest = STRONGEST_UN if name == 'force_uN' else FARTHEST_UM
            if np.any(np.abs(array) > largest):
                raise InvalidPlan(name, 'too large', f'numbers up to {largest:g}')
            object.__setattr__(self, name, array)
        if not np.isfinite(self.angle_rad):
            raise InvalidPlan('angle', self.angle_rad, 'a finite number')
        if self.finger not in range(FINGERS + 1):
            raise InvalidPlan('finger', self.finger, '0, 1, 2 or 3')
        free = [finger for finger in range(FINGERS) if not self.in_contact[finger]]
        if np.any(self.force_uN[:, free] != 0.0):
            raise InvalidPlan('force_uN', 'not zero for a finger in the air', 'zero there')

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
    expanded, waiting : int
        States that the search expanded, and that were still to be visited.
    time_s : float
        Wall time of the search [s]; not part of the plan's hash.
    """

    axis: str
    angle_deg: float
    cost_deg: float
    reconfigurations: int
    expanded: int
    waiting: int
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
    rules : GripRules
        Margins that it keeps; in paper mode only the nominal grip counts.
    steps : tuple of Step
        In the order of execution; each begins where the one before ended.
    rotations : tuple of RotationReport
        One per planar rotation.

    Raises
    ------
    InvalidPlan
        A step belongs to a rotation that is not there.
    """

    object_name: str
    object_sha256: str
    start: Pose
    goal: Pose
    finger: Finger
    law: ContactLaw
    options: SearchOptions
    rules: GripRules
    steps: tuple[Step, ...]
    rotations: tuple[RotationReport, ...]

    def __post_init__(self) -> None:
        """Check that steps and rotations belong together."""
        for number, step in enumerate(self.steps):
            if not 0 <= step.rotation < max(1, len(self.rotations)):
                allowed = f'0 to {max(0, len(self.rotations) - 1)}'
                raise InvalidPlan(f'step {number}: rotation', step.rotation, allowed)

    @property
    def cost_deg(self) -> float:
        """Sum of the rotations' costs [deg]."""
        return sum(rotation.cost_deg for rotation in self.rotations)

    @property
    def reconfigurations(self) -> int:
        """Sum over the rotations; the initial grasp is not counted."""
        return sum(rotation.reconfigurations for rotation in self.rotations)

    @property
    def tightest(self) -> tuple[int, Hold] | None:
        """The step whose grip leaves the smallest margin; None: no grip was planned."""
        holds = [(i, step.hold) for i, step in enumerate(self.steps) if step.hold is not None]
        return min(holds, key=lambda one: one[1].margin_uN, default=None)

    @property
    def reached(self) -> Pose:
        """Pose of the object after the last step; the start if there is none."""
        if not self.steps:
            return self.start
        last = self.steps[-1]
        return Pose(last.object_position_um[-1], last.object_quaternion_wxyz[-1])
