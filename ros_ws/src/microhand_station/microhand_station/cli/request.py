# SPDX-License-Identifier: Apache-2.0
"""The options that say what to plan, shared by `plan` and `demo`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import click
from scipy.spatial.transform import Rotation

from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.errors import BadRequest, InvalidNumber
from microhand_planner.core.parameters import (
    ContactLaw,
    Finger,
    GripRules,
    Mode,
    SearchOptions,
    firmest_first,
)
from microhand_planner.core.pose import Pose

UNITS_UM = {'nm': 1e-3, 'um': 1.0, 'mm': 1e3, 'm': 1e6}

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


@dataclass(frozen=True)
class Request:
    """What is to be planned.

    Parameters
    ----------
    object_name : str
        Mesh file or catalogue name.
    unit_um : float or None
        Length of one unit of the mesh [µm]; None: the catalogue's, or 1 µm.
    goal : Pose
        Where the object shall be; it starts at the station's origin.
    words : str
        The rotation as it was asked for.
    rotations : tuple of PlanarRotation or None
        What the goal is to be made of; None: the planner chooses.
    finger, law, options, rules
        What the planner is told.
    """

    object_name: str
    unit_um: float | None
    goal: Pose
    words: str
    rotations: tuple[PlanarRotation, ...] | None
    finger: Finger
    law: ContactLaw
    options: SearchOptions
    rules: tuple[GripRules, ...]


_CLEARANCE_UM = {Mode.ROBUST.value: 0.5, Mode.PAPER.value: 0.0}

_OPTIONS = (
    click.option(
        '--unit',
        type=click.Choice(list(UNITS_UM)),
        help="Unit of the mesh file.  [default: the catalogue's, or um]",
    ),
    click.option(
        '--euler-zyz',
        nargs=3,
        type=float,
        metavar='A B C',
        help='Rotation Rz(A) Ry(B) Rz(C) in the object frame, degrees.',
    ),
    click.option(
        '--quaternion',
        nargs=4,
        type=float,
        metavar='W X Y Z',
        help='The same as a quaternion; w first.',
    ),
    click.option(
        '--translation-um',
        nargs=3,
        type=float,
        default=(0.0, 0.0, 0.0),
        metavar='X Y Z',
        help='Translation in the station frame, µm.  [default: 0 0 0]',
    ),
    click.option(
        '--mode',
        type=click.Choice([mode.value for mode in Mode]),
        default=Mode.ROBUST.value,
        show_default=True,
        help='robust: exact contacts, any angle, the cheapest of all decompositions; '
        'paper: the lattice of Kumar et al. 2021, and the angles of --euler-zyz as given.',
    ),
    click.option(
        '--step-deg',
        type=float,
        default=20.0,
        show_default=True,
        help='Largest rotation between two chances to regrasp: smaller finds more plans, later.',
    ),
    click.option(
        '--friction',
        type=float,
        default=0.3,
        show_default=True,
        help='Coulomb coefficient that the plan assumes.',
    ),
    click.option(
        '--pull-off-uN',
        'pull_off_un',
        type=float,
        default=1.5,
        show_default=True,
        help='Force that detaches a tip, µN, as the plan assumes.',
    ),
    click.option('--no-adhesion', is_flag=True, help='Plan as if nothing stuck.'),
    click.option(
        '--max-force-uN',
        'max_force_un',
        type=float,
        default=30.0,
        show_default=True,
        help='Largest normal force of a tip, µN.',
    ),
    click.option(
        '--finger-radius-um',
        type=float,
        default=4.5,
        show_default=True,
        help='Radius of the spherical tips, µm.',
    ),
    click.option(
        '--clearance-um',
        type=float,
        help='Free distance kept between tips, µm.  [default: 0.5; 0 in paper mode]',
    ),
    click.option(
        '--margin',
        type=float,
        default=GripRules.margin_factor,
        show_default=True,
        help='Share of the friction that removals are planned with; 1: no reserve.',
    ),
    click.option(
        '--roll-margin',
        type=float,
        default=GripRules.roll_factor,
        show_default=True,
        help='Share of the friction that rolling grips are planned with.',
    ),
    click.option(
        '--least-margin-uN',
        'least_margin_un',
        type=float,
        default=GripRules.least_margin_uN,
        show_default=True,
        help='Distance to slipping that a removal keeps, µN.',
    ),
    click.option(
        '--grip-uN',
        'grip_un',
        type=float,
        default=GripRules.nominal_grip_uN,
        show_default=True,
        help='Grip while rolling, where the contacts allow as much, µN.',
    ),
    click.option(
        '--grip-tolerance-uN',
        'grip_tolerance_un',
        type=float,
        help='A grip may be off by as much, and keeps its margin, µN.  '
        '[default: 1.5; 0.5 if no plan forgives as much]',
    ),
    click.option(
        '--time-limit', type=float, metavar='S', help='Give up searching after S seconds.'
    ),
)


def request_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options to a command; `request_from` reads their values."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def request_from(
    object_name: str,
    *,
    unit: str | None,
    euler_zyz: Triple | None,
    quaternion: Quadruple | None,
    translation_um: Triple,
    mode: str,
    step_deg: float,
    friction: float,
    pull_off_un: float,
    no_adhesion: bool,
    max_force_un: float,
    finger_radius_um: float,
    clearance_um: float | None,
    margin: float,
    roll_margin: float,
    least_margin_un: float,
    grip_un: float,
    grip_tolerance_un: float | None,
    time_limit: float | None,
) -> Request:
    """Return the request that the options describe.

    Raises
    ------
    BadRequest
        Names the option, its value and what is allowed.
    """
    if euler_zyz is not None and quaternion is not None:
        raise BadRequest('quaternion', 'given beside euler-zyz', 'one of the two')
    if quaternion is None:
        angles_deg = euler_zyz or (0.0, 0.0, 0.0)
        if not all(math.isfinite(angle) for angle in angles_deg):
            raise InvalidNumber('euler-zyz', angles_deg, 'three finite numbers')
        goal = Pose.of(translation_um, Rotation.from_euler('ZYZ', angles_deg, degrees=True))
        words = 'ZYZ {:g}° {:g}° {:g}°'.format(*angles_deg)
    else:
        goal = Pose(translation_um, quaternion)
        words = 'quaternion {:g} {:g} {:g} {:g}'.format(*quaternion)
    rules = GripRules(margin, roll_margin, least_margin_un, grip_un)
    return Request(
        object_name=object_name,
        unit_um=None if unit is None else UNITS_UM[unit],
        goal=goal,
        words=words,
        rotations=_as_given(euler_zyz) if mode == Mode.PAPER.value and euler_zyz else None,
        finger=Finger(
            finger_radius_um, _CLEARANCE_UM[mode] if clearance_um is None else clearance_um
        ),
        law=ContactLaw(friction, pull_off_un, max_force_un, adhesion=not no_adhesion),
        options=SearchOptions(math.radians(step_deg), Mode(mode), time_limit),
        rules=firmest_first(rules)
        if grip_tolerance_un is None
        else (replace(rules, grip_tolerance_uN=grip_tolerance_un),),
    )


def _as_given(euler_zyz_deg: Triple) -> tuple[PlanarRotation, ...]:
    """Return the rotations that the angles stand for, without those by zero."""
    return tuple(
        PlanarRotation(axis, math.radians(angle_deg))
        for axis, angle_deg in zip('zyz', euler_zyz_deg, strict=True)
        if angle_deg != 0.0
    )
