# SPDX-License-Identifier: Apache-2.0
"""How MuJoCo is set up for micro-newtons: its units, its time step and its contacts.

MuJoCo has no units, but it has constants that suit metres and newtons. So it is given 10 µm for
one unit of length and 1 µN for one of force; nothing else in the project sees these. The unit of
time is free: gravity is nothing here, and forces of inertia must be nothing, so time only says
how fast a command moves through a world whose masses are numbers of order one. With 10 ms the
fingers settle in 0.3 ms, far faster than any command, and a second of motion is 20 000 steps.
"""

from __future__ import annotations

from dataclasses import dataclass

from microhand_planner.core.parameters import check_number

LENGTH_UNIT_UM = 10.0
"""One unit of length in MuJoCo [µm]; one unit of force is 1 µN."""

ADHESION_REACH_UM = 0.005
"""How far from the surface a tip feels the pull of adhesion [µm].

Without a reach, a contact that slips flickers open, and removals that cannot hold look held.
"""


@dataclass(frozen=True)
class Numerics:
    """Settings of the engine that are not physics.

    Parameters
    ----------
    time_unit_s : float
        What one unit of time in MuJoCo stands for [s].
    time_step : float
        Step of the integration [units of time].
    tip_mass, object_mass : float
        Masses of a tip and of the object [units of mass]. They are chosen, not measured: what
        holds at rest does not depend on them, and the motions are too slow for inertia.
    torsion_um : float
        Torque that a contact transmits about its normal, over friction-free normal force
        [µN·µm/µN]: about the radius of an elastic contact of a 4.5 µm tip times its friction.
    """

    time_unit_s: float = 0.01
    time_step: float = 0.005
    tip_mass: float = 1.0
    object_mass: float = 2.0
    torsion_um: float = 0.01

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('time_unit', self.time_unit_s, low=1e-6, high=1.0)
        check_number('time_step', self.time_step, low=1e-4, high=0.005)
        check_number('tip_mass', self.tip_mass, low=1e-3, high=1e3)
        check_number('object_mass', self.object_mass, low=1e-3, high=1e3)
        check_number('torsion', self.torsion_um, low=0.0, high=10.0)

    @property
    def step_s(self) -> float:
        """What one step of the integration stands for [s]."""
        return self.time_step * self.time_unit_s
