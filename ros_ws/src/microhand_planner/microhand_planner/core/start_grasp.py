# SPDX-License-Identifier: Apache-2.0
"""The grasp that a plan begins with, found from where the tips are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from microhand_planner.core.errors import InadmissibleContact, InvalidParameter
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.pose import FARTHEST_UM, FloatArray, Pose

_TOLERANCE_UM = 0.1
_SEEDS = 720  # phases tried before the nearest is refined
_HOLDING = 2


@dataclass(frozen=True)
class StartGrasp:
    """Two fingers that hold the object.

    Parameters
    ----------
    axis : str
        ``'z'`` or ``'y'``: normal of the section plane in which they stand.
    fingers : (int, int)
        Which fingers, from 0.
    phase_rad : (float, float)
        Their contact phases [rad].
    """

    axis: str
    fingers: tuple[int, int]
    phase_rad: tuple[float, float]


def start_grasp(tip_um: FloatArray, pose: Pose, curves: Mapping[str, OffsetCurve]) -> StartGrasp:
    """Find where two tips touch the object.

    Parameters
    ----------
    tip_um : (3, 3) float
        Tip centres of fingers 1, 2, 3, station frame [µm]; NaN: the finger is free.
    pose : Pose
        Object in the station frame.
    curves : mapping
        Where tips can be around the part, for the axes ``'z'`` and ``'y'``.

    Returns
    -------
    StartGrasp
        In the XY plane if both planes fit: the tips stand on the joints.

    Raises
    ------
    InvalidParameter
        Not exactly two fingers are placed, or one is farther away than 10 cm.
    InadmissibleContact
        The tips do not touch the object in one of its section planes, within 0.1 µm.
    """
    tip_um = np.asarray(tip_um, dtype=np.float64)
    placed = [finger for finger in range(len(tip_um)) if np.all(np.isfinite(tip_um[finger]))]
    if tip_um.shape != (3, 3) or len(placed) != _HOLDING:
        raise InvalidParameter(
            'start-tips',
            tip_um.tolist(),
            'three positions, of which one is NaN: its finger is free',
        )
    if np.max(np.abs(tip_um[placed])) > FARTHEST_UM:
        raise InvalidParameter('start-tips', tip_um.tolist(), f'up to {FARTHEST_UM:g} um away')
    in_object_um = pose.rotation.inv().apply(tip_um[placed] - np.asarray(pose.position_um))
    misses_um = []
    for axis, curve in curves.items():
        found = [_nearest(curve, tip) for tip in in_object_um]
        miss_um = max(distance_um for _, distance_um in found)
        if miss_um <= _TOLERANCE_UM:
            first, second = (phase for phase, _ in found)
            return StartGrasp(axis, (placed[0], placed[1]), (first, second))
        misses_um.append(f'{miss_um:.2f} um from where tips can be in the plane normal to {axis}')
    raise InadmissibleContact(
        'start-tips',
        ', '.join(misses_um),
        f'tips that touch the object in one of its planes, within {_TOLERANCE_UM:g} um',
    )


def _nearest(curve: OffsetCurve, tip_um: FloatArray) -> tuple[float, float]:
    """Return the phase at which a tip comes nearest to a point, and the distance left [µm]."""

    def distance_um(phase_rad: FloatArray) -> FloatArray:
        centres_um = curve.plane.to_object(curve.at(phase_rad).centre_um)
        return np.asarray(np.linalg.norm(centres_um - tip_um, axis=1))

    seeds = np.asarray(
        np.linspace(0.0, curve.length_rad, _SEEDS, endpoint=False), dtype=np.float64
    )
    seed = float(seeds[np.argmin(distance_um(seeds))])
    gap_rad = curve.length_rad / _SEEDS
    best = minimize_scalar(
        lambda phase: float(distance_um(np.array([phase]))[0]),
        bounds=(seed - gap_rad, seed + gap_rad),
        method='bounded',
        options={'xatol': 1e-10},
    )
    return float(best.x % curve.length_rad), float(best.fun)
