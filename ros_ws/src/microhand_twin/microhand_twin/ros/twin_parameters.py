# SPDX-License-Identifier: Apache-2.0
"""Parameters of the twin node: what the station is like, and what is taken to be true."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from microhand_node.parameter_spec import ParameterSpec, declare_specs
from microhand_planner.core.parameters import ContactLaw
from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import FloatArray
from microhand_planner.ros.conversions import UN_PER_N, um_from_m

AS_PLANNED = -1.0
"""Of friction and pull-off force: what the plan assumes is true."""

SPECS = (
    ParameterSpec(
        'friction', AS_PLANNED, AS_PLANNED, 2.0, '1', "true Coulomb coefficient; < 0: the plan's"
    ),
    ParameterSpec(
        'pull_off_force',
        AS_PLANNED,
        AS_PLANNED,
        1e-3,
        'N',
        "true force that detaches a tip, 0: nothing sticks; < 0: the plan's",
    ),
    *(
        spec
        for finger in range(1, FINGERS + 1)
        for spec in (
            ParameterSpec(
                f'finger_{finger}.base',
                [-1e-4, -1e-4, -1e-4],
                -0.1,
                0.1,
                'm',
                'tip in the station frame when the stage is at zero',
            ),
            ParameterSpec(
                f'finger_{finger}.stiffness', 20.0, 0.1, 1e4, 'N/m', 'between stage and tip'
            ),
        )
    ),
    ParameterSpec('state_rate', 50.0, 1.0, 200.0, 'Hz', 'at which `object_state` is published'),
    ParameterSpec(
        'display_rate', 10.0, 0.1, 100.0, 'Hz', 'at which transforms and markers are published'
    ),
    ParameterSpec(
        'display_scale', 1e4, 1.0, 1e6, '1', 'how much larger markers are than the real things'
    ),
)


@dataclass(frozen=True, eq=False)
class TwinParameters:
    """The parameters of a twin, in the units of the core.

    Parameters
    ----------
    friction, pull_off_uN : float
        True values; < 0: as planned.
    base_um : (3, 3) float
        Tips when the stages are at zero, station frame [µm].
    stiffness_uN_per_um : (3,) float
        Of the fingers.
    state_period_s, display_period_s : float
        Between two messages [s].
    display_scale : float
        Size of markers over that of the real things.
    frame, frame_prefix : str
        Station frame, and what the names of the other frames begin with.
    catalogue : str
        Folder of objects; empty: the built-in one.
    """

    friction: float
    pull_off_uN: float
    base_um: FloatArray
    stiffness_uN_per_um: FloatArray
    state_period_s: float
    display_period_s: float
    display_scale: float
    frame: str
    frame_prefix: str
    catalogue: str

    def true_law(self, planned: ContactLaw) -> ContactLaw:
        """Return how tips and object touch in truth, when a plan assumes `planned`."""
        law = planned
        if self.friction >= 0.0:
            law = dataclasses.replace(law, friction=self.friction)
        if self.pull_off_uN >= 0.0:
            adhesion = self.pull_off_uN > 0.0
            law = dataclasses.replace(law, pull_off_uN=self.pull_off_uN, adhesion=adhesion)
        return law


def declare_parameters(node: Node) -> None:
    """Declare every parameter and refuse values that are not allowed, now and later.

    Raises
    ------
    rclpy.exceptions.ParameterException
        An override is not allowed.
    """
    declare_specs(node, SPECS, 'read when an object is loaded')
    for name, default, description in (
        ('frame', 'station', 'name of the station frame'),
        ('frame_prefix', '', 'what the names of the other frames begin with'),
        ('catalogue', '', 'folder of meshes with their descriptions; empty: the built-in one'),
    ):
        node.declare_parameter(name, default, ParameterDescriptor(description=description))


def read_parameters(node: Node) -> TwinParameters:
    """Return the present values."""

    def value(name: str) -> float:
        return float(node.get_parameter(name).value)

    fingers = range(1, FINGERS + 1)
    bases = [node.get_parameter(f'finger_{finger}.base').value for finger in fingers]
    return TwinParameters(
        friction=value('friction'),
        pull_off_uN=value('pull_off_force') * UN_PER_N,
        base_um=um_from_m(np.array(bases, dtype=np.float64)),
        stiffness_uN_per_um=np.array([value(f'finger_{finger}.stiffness') for finger in fingers]),
        state_period_s=1.0 / value('state_rate'),
        display_period_s=1.0 / value('display_rate'),
        display_scale=value('display_scale'),
        frame=node.get_parameter('frame').value,
        frame_prefix=node.get_parameter('frame_prefix').value,
        catalogue=node.get_parameter('catalogue').value,
    )
