# SPDX-License-Identifier: Apache-2.0
"""The request in a record → what was asked, as people say it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from microhand_planner.core.pose import Pose

_SCALARS = (str, int, float)
# Told by the plan, by other names; and what is in it for programs.
_ELSEWHERE = ('object', 'words', 'unit', 'run_name')


def requested(request: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return name and value of what the plan does not tell.

    Parameters
    ----------
    request : Mapping[str, Any]
        As it was sent, SI units.
    """
    rows = []
    if words := request.get('words'):
        rows.append(('turned by', str(words)))
    unit_m = request.get('unit')
    if isinstance(unit_m, float) and unit_m > 0.0:
        rows.append(('unit of the mesh', f'{unit_m * 1e6:g} µm'))
    if request.get('start_tips'):
        rows.append(('start', 'held by the fingers already'))
    rows += [
        (str(key).replace('_', ' '), str(value))
        for key, value in request.items()
        if key not in _ELSEWHERE and isinstance(value, _SCALARS)
    ]
    return rows


def pose_text(pose: Pose) -> str:
    """Return a pose as people read it: angles of ZYZ, and the place unless it is the origin."""
    turn = pose.rotation
    if turn.magnitude() < 1e-9:
        text = 'not turned'
    else:
        text = 'ZYZ {:.4g}° {:.4g}° {:.4g}°'.format(*turn.as_euler('ZYZ', degrees=True))
    x, y, z = pose.position_um
    return text if x == y == z == 0.0 else f'{text}, at {x:g} {y:g} {z:g} µm'
