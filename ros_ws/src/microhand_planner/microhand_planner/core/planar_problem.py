# SPDX-License-Identifier: Apache-2.0
"""The planar problem as the paper states it, and as `microhand planar` reads it.

Contact 1 lies at (a, 0); contacts are numbered counter-clockwise, equidistant on the offset
curve. Orientation l = 1 is the start; rolling from l to l + 1 moves every placed finger's contact
by -1. 0 stands for a finger that is not used ([Kumar2021] §3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from microhand_planner.core.errors import BadRequest, InvalidNumber, InvalidParameter
from microhand_planner.core.parameters import ContactLaw, Finger, check_number

Node = tuple[int, int, int, int]
"""The paper's ``[i j k l]``."""

_MOST_CONTACTS = 5000
_MOST_ORIENTATIONS = 4000


@dataclass(frozen=True)
class PlanarProblem:
    """A rotation in the plane of an ellipse, on the paper's lattice.

    Parameters
    ----------
    ellipse_um : (float, float)
        Semi-axes a along x, and b along y [µm].
    contacts : int
        Contact points around the section, c.
    step_deg : float
        Rotation between two orientations, Δθ [deg].
    orientations : int
        Number of orientations; there is no wrap from the last to the first.
    start, goal : Node
        Grasps of two fingers with an orientation each, ``[i j k l]``.
    finger : Finger
        Tips.
    law : ContactLaw
        Friction and adhesion.
    """

    ellipse_um: tuple[float, float]
    contacts: int
    step_deg: float
    orientations: int
    start: Node
    goal: Node
    finger: Finger = field(default_factory=Finger)
    law: ContactLaw = field(default_factory=ContactLaw)

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name, value in zip(('a', 'b'), self.ellipse_um, strict=True):
            check_number(f'ellipse_um {name}', value, low=0.1, high=1e4)
        check_number('step_deg', self.step_deg, low=0.1, high=90.0)
        check_number('contacts', self.contacts, low=4, high=_MOST_CONTACTS)
        check_number('orientations', self.orientations, low=1, high=_MOST_ORIENTATIONS)
        for name, node in (('start', self.start), ('goal', self.goal)):
            *placed, orientation = node
            if len(node) != 4 or sum(contact > 0 for contact in placed) != 2:
                raise InvalidParameter(name, list(node), '[i j k l] with two fingers placed')
            if not all(0 <= contact <= self.contacts for contact in placed):
                raise InvalidParameter(name, list(node), f'contacts from 0 to {self.contacts}')
            if not 1 <= orientation <= self.orientations:
                raise InvalidParameter(
                    name, list(node), f'an orientation from 1 to {self.orientations}'
                )


def problem_from_dict(content: object) -> PlanarProblem:
    """Return the problem that a JSON object describes.

    Parameters
    ----------
    content : object
        Parsed JSON with the keys ``ellipse_um``, ``contacts``, ``step_deg``, ``orientations``,
        ``start``, ``goal``, and, with defaults, ``finger_radius_um``, ``friction``,
        ``pull_off_uN``, ``max_force_uN``, ``adhesion``.

    Raises
    ------
    BadRequest
        A key is missing, unknown, or has an impossible value; the message names it.
    """
    if not isinstance(content, dict):
        raise BadRequest('problem', type(content).__name__, 'a JSON object')
    needed = {'ellipse_um', 'contacts', 'step_deg', 'orientations', 'start', 'goal'}
    optional = {'finger_radius_um', 'friction', 'pull_off_uN', 'max_force_uN', 'adhesion'}
    if missing := sorted(needed - content.keys()):
        raise BadRequest(missing[0], 'missing', f'one of the keys {sorted(needed)}')
    if unknown := sorted(content.keys() - needed - optional):
        raise BadRequest(unknown[0], 'unknown', f'the keys {sorted(needed | optional)}')
    a_um, b_um = _numbers(content, 'ellipse_um', 2)
    adhesion = content.get('adhesion', True)
    if not isinstance(adhesion, bool):
        raise InvalidParameter('adhesion', adhesion, 'true or false')
    law = {
        key: _numbers(content, key, 1)[0]
        for key in ('friction', 'pull_off_uN', 'max_force_uN')
        if key in content
    }
    finger = Finger()
    if 'finger_radius_um' in content:
        finger = Finger(radius_um=_numbers(content, 'finger_radius_um', 1)[0])
    return PlanarProblem(
        ellipse_um=(a_um, b_um),
        contacts=_whole(content, 'contacts', 1)[0],
        step_deg=_numbers(content, 'step_deg', 1)[0],
        orientations=_whole(content, 'orientations', 1)[0],
        start=_as_node(_whole(content, 'start', 4)),
        goal=_as_node(_whole(content, 'goal', 4)),
        finger=finger,
        law=ContactLaw(adhesion=adhesion, **law),
    )


def _numbers(content: dict[str, Any], key: str, count: int) -> list[float]:
    """Return the numbers of a key, or refuse."""
    value = content[key]
    values = value if isinstance(value, list) and count > 1 else [value]
    if len(values) != count or not all(
        isinstance(number, int | float) and not isinstance(number, bool) for number in values
    ):
        raise InvalidParameter(key, value, 'a number' if count == 1 else f'{count} numbers')
    try:
        return [float(number) for number in values]
    except OverflowError as error:
        raise InvalidNumber(key, value, 'a number that is not that large') from error


def _whole(content: dict[str, Any], key: str, count: int) -> list[int]:
    """Return the whole numbers of a key, or refuse."""
    numbers = _numbers(content, key, count)
    if not all(math.isfinite(number) and number == int(number) for number in numbers):
        what = 'a whole number' if count == 1 else f'{count} whole numbers'
        raise InvalidParameter(key, content[key], what)
    return [int(number) for number in numbers]


def _as_node(values: list[int]) -> Node:
    """Return four numbers as a node."""
    first, second, third, orientation = values
    return first, second, third, orientation
