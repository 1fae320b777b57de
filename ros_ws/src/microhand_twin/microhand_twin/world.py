# SPDX-License-Identifier: Apache-2.0
"""The world of the twin: three fingers on springs and an object, as a model of MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import InvalidParameter
from microhand_planner.core.parameters import ContactLaw, check_number
from microhand_planner.core.part import Part
from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import FloatArray, readonly
from microhand_twin.appearance import LIGHTS_XML, VISUAL_XML
from microhand_twin.numerics import ADHESION_REACH_UM, LENGTH_UNIT_UM, Numerics
from microhand_twin.object_shape import Ellipsoid, ellipsoid_of
from microhand_twin.smooth_surface import smooth_surface
from microhand_twin.surface_table import surface_table

AXES = FINGERS * 3

_SETTINGS = """
  <option gravity="0 0 0" timestep="{time_step}" integrator="implicitfast" cone="elliptic"
          impratio="100" solver="Newton" iterations="100" tolerance="1e-12" ccd_tolerance="1e-9"/>
  <default>
    <geom condim="4" friction="{friction} {torsion} 0" solref="0.01 1"
          solimp="0.99 0.999 0.001 0.5 2"/>
  </default>"""


@dataclass(frozen=True, eq=False)
class World:
    """A model of MuJoCo, and what it was made from.

    Parameters
    ----------
    model : mujoco.MjModel
        Object first, then fingers 1, 2, 3; lengths in units of 10 µm.
    part : Part
        The object.
    law : ContactLaw
        How tips and object touch. The largest force is not part of the physics.
    finger_radius_um : float
        Radius of the tips [µm].
    stiffness_uN_per_um : (3,) float
        Springs between a finger's command and its tip, the same in all directions [µN/µm].
    numerics : Numerics
        Units and settings of the engine.
    smooth : bool
        True: collisions need `surface_collision.smooth_contacts`.
    """

    model: mujoco.MjModel
    part: Part
    law: ContactLaw
    finger_radius_um: float
    stiffness_uN_per_um: FloatArray
    numerics: Numerics
    smooth: bool


def build_world(
    part: Part,
    *,
    law: ContactLaw | None = None,
    finger_radius_um: float = 4.5,
    stiffness_uN_per_um: float | Sequence[float] = 100.0,
    numerics: Numerics | None = None,
) -> World:
    """Build the world of an object and three fingers.

    A finger is a sphere that follows its command through a spring in each direction, damped
    critically relative to the commanded velocity: it lags behind no steady motion. Contacts are
    adhesive Coulomb contacts: a pull of `law.stick_uN` presses tip and object together as
    long as they are within 5 nm.

    Parameters
    ----------
    part : Part
        The object. An ellipsoid is MuJoCo's own; tips roll on others' smooth surfaces.
    law : ContactLaw
        True friction and pull-off force; by default the planner's defaults.
    finger_radius_um : float
        Radius of the tips [µm].
    stiffness_uN_per_um : float or (3,) floats
        Stiffness of the fingers [µN/µm = N/m].
    numerics : Numerics
        Units and settings of the engine.

    Raises
    ------
    InvalidNumber, InvalidParameter
        A radius or stiffness that is not a positive number, or not three of them.
    """
    law = law or ContactLaw()
    numerics = numerics or Numerics()
    check_number('finger-radius', finger_radius_um, low=0.01, high=1e4)
    stiffness = np.asarray(stiffness_uN_per_um, dtype=np.float64)
    if stiffness.shape not in ((), (FINGERS,)):
        raise InvalidParameter('stiffness', stiffness.tolist(), f'one number, or {FINGERS}')
    stiffness = np.broadcast_to(stiffness, (FINGERS,))
    for value in stiffness:
        check_number('stiffness', float(value), low=0.1, high=1e4)
    fingers_xml = ''.join(_finger_xml(i, finger_radius_um, numerics) for i in range(FINGERS))
    servos_xml = ''.join(_servos_xml(i, stiffness[i], numerics) for i in range(FINGERS))
    adhesion_xml = ''.join(
        f'<adhesion body="finger{i}" gain="{law.stick_uN}" ctrlrange="0 1"/>'
        for i in range(FINGERS)
    )
    settings = _SETTINGS.format(
        time_step=numerics.time_step,
        friction=law.friction,
        torsion=numerics.torsion_um / LENGTH_UNIT_UM,
    )
    ellipsoid = ellipsoid_of(part)
    geom_xml = _ellipsoid_xml(ellipsoid) if ellipsoid else _carrier_xml(part)
    spec = mujoco.MjSpec.from_string(
        f'<mujoco model={quoteattr(part.name)}>{settings}{VISUAL_XML}'
        f'<worldbody>{LIGHTS_XML}{_object_xml(geom_xml, part, numerics)}{fingers_xml}</worldbody>'
        f'<actuator>{servos_xml}{adhesion_xml}</actuator></mujoco>'
    )
    if ellipsoid is None:
        table = surface_table(smooth_surface(part), finger_radius_um, LENGTH_UNIT_UM)
        spec.add_numeric(name='surface', data=table, size=len(table))
        spec.add_mesh(
            name='object',
            uservert=(part.vertices_um / LENGTH_UNIT_UM).ravel(),
            userface=part.faces.ravel(),
        )
    model = spec.compile()
    return World(
        model, part, law, finger_radius_um, readonly(stiffness), numerics, ellipsoid is None
    )


def _object_xml(geom_xml: str, part: Part, numerics: Numerics) -> str:
    """Return the object's body: it moves freely, and turns as evenly as a ball."""
    radius_um = float(np.linalg.norm(part.extents_um)) / np.sqrt(12.0)
    inertia = numerics.object_mass * 0.4 * (radius_um / LENGTH_UNIT_UM) ** 2
    return (
        '<body name="object"><freejoint/>'
        f'<inertial pos="0 0 0" mass="{numerics.object_mass}" '
        f'diaginertia="{inertia} {inertia} {inertia}"/>{geom_xml}</body>'
    )


def _ellipsoid_xml(ellipsoid: Ellipsoid) -> str:
    """Return an exact ellipsoid."""
    x, y, z, w = Rotation.from_matrix(ellipsoid.axes).as_quat()
    return (
        f'<geom name="object" type="ellipsoid" pos="{_units(ellipsoid.centre_um)}" '
        f'quat="{w} {x} {y} {z}" size="{_units(ellipsoid.semi_axes_um)}" '
        'material="object" contype="2" conaffinity="1"/>'
    )


def _carrier_xml(part: Part) -> str:
    """Return a box that stands for the smooth surface in collisions, and the mesh to look at.

    The box has to hold the surface, which stands out of the mesh by less than 1 % of its size.
    """
    size_um = np.abs(part.vertices_um).max(axis=0) + 0.01 * part.extents_um
    return (
        f'<geom name="object" type="box" size="{_units(size_um)}" group="3" '
        'contype="2" conaffinity="1"/>'
        '<geom name="object_mesh" type="mesh" mesh="object" material="object" '
        'contype="0" conaffinity="0"/>'
    )


def _finger_xml(finger: int, radius_um: float, numerics: Numerics) -> str:
    """Return a finger: a sphere that slides along x, y and z."""
    joints = ''.join(
        f'<joint name="finger{finger}{axis}" type="slide" axis="{direction}"/>'
        for axis, direction in (('x', '1 0 0'), ('y', '0 1 0'), ('z', '0 0 1'))
    )
    reach = ADHESION_REACH_UM / LENGTH_UNIT_UM
    return (
        f'<body name="finger{finger}">{joints}'
        f'<geom name="tip{finger}" type="sphere" size="{radius_um / LENGTH_UNIT_UM}" '
        f'mass="{numerics.tip_mass}" material="tip{finger + 1}" '
        f'contype="1" conaffinity="2" gap="{reach}"/></body>'
    )


def _servos_xml(finger: int, stiffness_uN_per_um: float, numerics: Numerics) -> str:
    """Return spring and damper of a finger's axes, both driven by the commanded velocity.

    The spring's activation is the commanded position: MuJoCo integrates it, so that commands move
    evenly between two setpoints and not in jumps, which stiff fingers would turn into blows.
    """
    spring = stiffness_uN_per_um * LENGTH_UNIT_UM
    damper = 2.0 * np.sqrt(spring * numerics.tip_mass)
    return ''.join(
        f'<general joint="finger{finger}{axis}" dyntype="integrator" gainprm="{spring}" '
        f'biastype="affine" biasprm="0 {-spring} 0"/>'
        f'<general joint="finger{finger}{axis}" gainprm="{damper}" '
        f'biastype="affine" biasprm="0 0 {-damper}"/>'
        for axis in 'xyz'
    )


def _units(lengths_um: FloatArray) -> str:
    """Return lengths as text, in MuJoCo's unit."""
    return ' '.join(f'{length:.12g}' for length in np.ravel(lengths_um) / LENGTH_UNIT_UM)
