# SPDX-License-Identifier: Apache-2.0
"""Where the free finger may go so that another one may leave: many contacts at once.

A search asks about all swaps of a grasp together. Here the verdicts of `removal.grip_window_uN`
and `preload.preload_window_uN` are formed without branches, from numbers that lie side by side, so
that the processor works on several contacts in one instruction. All functions here do the same
arithmetic, so they agree always, also in the last bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np

from microhand_planner.core.pose import FloatArray
from microhand_planner.core.rotation_lattice import BoolArray, IntArray
from microhand_planner.core.search_field import SearchField

_FLAT = 1e-12  # as in `removal.narrow`
_ONE_POINT_UM = 1e-9  # as in `removal.contact_lines`
_TOUCHING_UM = 1e-9  # as in `grasp.tips_clear`

CHUNK = 64
_LANES = 8

Numbers = tuple[float, float, float, float]


class RemovalLaw(NamedTuple):
    """What decides a removal besides the contacts; see `SearchField`, whose names these are."""

    least_um: float
    friction: float
    pull_off_uN: float
    max_force_uN: float
    planned_grip: bool
    margin_uN: float
    tolerance_uN: float


def removal_law(field: SearchField) -> RemovalLaw:
    """Return the law of a field."""
    return RemovalLaw(
        field.min_distance_um - _TOUCHING_UM,
        field.friction,
        field.pull_off_uN,
        field.max_force_uN,
        field.planned_grip,
        field.margin_uN,
        field.tolerance_uN,
    )


def contact_columns(field: SearchField, density: int) -> FloatArray:
    """Return every so many-th sample: the places where fingers may come and go.

    Returns
    -------
    (6, p) float
        Rows: x and y of the contact, the outward normal and the tip's centre, object frame in the
        plane [µm]; a centre is NaN where no finger may stand.
    """
    columns = np.zeros((6, len(field.usable) // density))
    columns[0:2] = field.contact_um[::density].T
    columns[2:4] = field.normal[::density].T
    columns[4:6] = field.centre_um[::density].T
    columns[4:6, ~field.usable[::density]] = np.nan
    return columns


@nb.njit(cache=True, error_model='numpy', _nrt=False)
def swap_verdicts(
    columns: FloatArray,
    first: int,
    stay: int,
    leave: int,
    reverse: bool,
    law: RemovalLaw,
    may: BoolArray,
) -> None:  # pragma: no cover - compiled
    """Tell where a finger may be placed, beside one that stays and another, which leaves then.

    Parameters
    ----------
    columns : (6, p) float
        See `contact_columns`.
    first : int
        The first place in question; as many follow as `may` has room for.
    stay, leave : int
        Places of the two fingers that hold.
    reverse : bool
        True: backward in time, where the finger that leaves is the one that is placed.
    law : RemovalLaw
        See there.
    may : (c,) bool
        Takes the verdicts.
    """
    x, y, nx, ny = columns[0], columns[1], columns[2], columns[3]
    stays = (x[stay], y[stay], nx[stay], ny[stay])
    leaves = (x[leave], y[leave], nx[leave], ny[leave])
    # a loop for each case: none has anything to decide
    if law.planned_grip and reverse:
        for place in range(len(may)):
            at = first + place
            may[place] = _keeps_margin(stays, leaves, (x[at], y[at], nx[at], ny[at]), law)
    elif law.planned_grip:
        for place in range(len(may)):
            at = first + place
            may[place] = _keeps_margin(stays, (x[at], y[at], nx[at], ny[at]), leaves, law)
    elif reverse:
        for place in range(len(may)):
            at = first + place
            may[place] = _balances(stays, leaves, (x[at], y[at], nx[at], ny[at]), law)
    else:
        for place in range(len(may)):
            at = first + place
            may[place] = _balances(stays, (x[at], y[at], nx[at], ny[at]), leaves, law)
    least = law.least_um * law.least_um
    x, y = columns[4], columns[5]
    for place in range(len(may)):
        at = first + place
        from_stay = (x[at] - x[stay]) ** 2 + (y[at] - y[stay]) ** 2
        from_leave = (x[at] - x[leave]) ** 2 + (y[at] - y[leave]) ** 2
        may[place] &= (from_stay >= least) & (from_leave >= least)


@nb.njit(cache=True, error_model='numpy', _nrt=False)
def swap_verdict(
    columns: FloatArray, place: int, stay: int, leave: int, reverse: bool, law: RemovalLaw
) -> bool:  # pragma: no cover - compiled
    """Return the verdict for one place; arguments as in `swap_verdicts`."""
    x, y = columns[4, place], columns[5, place]
    least = law.least_um * law.least_um
    if not (columns[4, stay] - x) ** 2 + (columns[5, stay] - y) ** 2 >= least:
        return False
    if not (columns[4, leave] - x) ** 2 + (columns[5, leave] - y) ** 2 >= least:
        return False
    keep = place
    if reverse:
        keep, leave = leave, place
    stays = (columns[0, stay], columns[1, stay], columns[2, stay], columns[3, stay])
    keeps = (columns[0, keep], columns[1, keep], columns[2, keep], columns[3, keep])
    leaves = (columns[0, leave], columns[1, leave], columns[2, leave], columns[3, leave])
    if law.planned_grip:
        return _keeps_margin(stays, keeps, leaves, law)
    return _balances(stays, keeps, leaves, law)


@nb.njit(cache=True, error_model='numpy', _nrt=False)
def gather(
    columns: FloatArray, places: IntArray, finger: int, chunk: FloatArray
) -> None:  # pragma: no cover - compiled
    """Write the numbers of a finger's places to a chunk, see `chunk_verdicts`.

    Behind them comes the last one again, so that there are whole vectors.
    """
    count = len(places)
    for step in range((count + _LANES - 1) // _LANES * _LANES):
        place = places[min(step, count - 1)]
        for row in range(6):
            chunk[(6 * finger + row) * CHUNK + step] = columns[row, place]


@nb.njit(cache=True, error_model='numpy', _nrt=False)
def chunk_verdicts(
    chunk: FloatArray,
    count: int,
    stays: int,
    leaves: int,
    reverse: bool,
    law: RemovalLaw,
    may: BoolArray,
) -> None:  # pragma: no cover - compiled
    """Tell in which steps a finger may be placed so that another one may leave.

    Parameters
    ----------
    chunk : (18 * 64,) float
        For fingers 0, 1 and 2 the six rows of `contact_columns` in up to 64 steps; finger 2 is
        the one that is placed.
    count : int
        Number of steps.
    stays, leaves : int
        0 and 1, or 1 and 0.
    reverse, law : bool, RemovalLaw
        As in `swap_verdicts`.
    may : (64,) bool
        Takes the verdicts.
    """
    keep, go = (leaves, 2) if reverse else (2, leaves)
    one, two, out = 6 * CHUNK * stays, 6 * CHUNK * keep, 6 * CHUNK * go
    lanes = (count + _LANES - 1) // _LANES * _LANES
    if law.planned_grip:
        for step in range(lanes):
            may[step] = _keeps_margin(
                _numbers(chunk, one + step),
                _numbers(chunk, two + step),
                _numbers(chunk, out + step),
                law,
            )
    else:
        for step in range(lanes):
            may[step] = _balances(
                _numbers(chunk, one + step),
                _numbers(chunk, two + step),
                _numbers(chunk, out + step),
                law,
            )
    least = law.least_um * law.least_um
    for finger in range(2):
        for step in range(lanes):
            x = chunk[(6 * finger + 4) * CHUNK + step] - chunk[16 * CHUNK + step]
            y = chunk[(6 * finger + 5) * CHUNK + step] - chunk[17 * CHUNK + step]
            may[step] &= x * x + y * y >= least


@nb.njit(cache=True, inline='always')
def _numbers(chunk: FloatArray, at: int) -> Numbers:  # pragma: no cover - compiled
    """Return contact and normal of a finger in a step."""
    return chunk[at], chunk[at + CHUNK], chunk[at + 2 * CHUNK], chunk[at + 3 * CHUNK]


@nb.njit(cache=True, inline='always')
def _balances(
    stay: Numbers, keep: Numbers, leave: Numbers, law: RemovalLaw
) -> bool:  # pragma: no cover - compiled
    """Return whether `removal.grip_window_uN` is open."""
    low, high = -math.inf, math.inf
    length, ahead, behind = _lines(stay, keep, leave, law.pull_off_uN)
    for normal, tangent, slope, slide in (ahead, behind):
        low, high = _narrow(low, high, slope, normal)
        low, high = _narrow(low, high, -slope, law.max_force_uN - normal)
        cone = law.friction * (normal + law.pull_off_uN)
        low, high = _narrow(low, high, law.friction * slope - slide, cone - tangent)
        low, high = _narrow(low, high, law.friction * slope + slide, cone + tangent)
    return (low <= high) & (length >= _ONE_POINT_UM)


@nb.njit(cache=True, inline='always')
def _keeps_margin(
    stay: Numbers, keep: Numbers, leave: Numbers, law: RemovalLaw
) -> bool:  # pragma: no cover - compiled
    """Return whether `preload.preload_window_uN` is wide enough."""
    low, high = -math.inf, math.inf
    length, ahead, behind = _lines(stay, keep, leave, law.pull_off_uN)
    for normal, tangent, slope, slide in (ahead, behind):
        for pull in (0.0, 1.0):
            cone = law.friction * (pull * normal + law.pull_off_uN) - law.margin_uN
            over = law.friction * (law.max_force_uN - pull * normal) - law.margin_uN
            adhere = pull * normal + law.pull_off_uN - law.margin_uN
            low, high = _narrow(low, high, law.friction * slope - slide, cone - pull * tangent)
            low, high = _narrow(low, high, law.friction * slope + slide, cone + pull * tangent)
            low, high = _narrow(low, high, slope, adhere)
            low, high = _narrow(low, high, -law.friction * slope, over)
    return (high - low >= 2.0 * law.tolerance_uN) & (low <= high) & (length >= _ONE_POINT_UM)


@nb.njit(cache=True, inline='always')
def _narrow(
    low: float, high: float, slope: float, offset: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Do what `removal.narrow` does, without a branch; the impossible makes `low` infinite."""
    at = -offset / slope
    low = max(low, at if slope > _FLAT else -math.inf)
    high = min(high, at if slope < -_FLAT else math.inf)
    impossible = (abs(slope) <= _FLAT) & (offset < -_FLAT)
    return (math.inf if impossible else low), high


@nb.njit(cache=True, inline='always')
def _lines(
    stay: Numbers, keep: Numbers, leave: Numbers, pull_off_uN: float
) -> tuple[float, Numbers, Numbers]:  # pragma: no cover - compiled
    """Return the distance of the contacts that stay, and their `removal.contact_lines`."""
    line_x = keep[0] - stay[0]
    line_y = keep[1] - stay[1]
    length = math.sqrt(line_x * line_x + line_y * line_y)
    line_x /= length
    line_y /= length
    pull_x = pull_off_uN * leave[2]
    pull_y = pull_off_uN * leave[3]
    arm_x = leave[0] - 0.5 * (stay[0] + keep[0])
    arm_y = leave[1] - 0.5 * (stay[1] + keep[1])
    couple = (arm_x * pull_y - arm_y * pull_x) / length
    ahead = _line(1.0, line_x, line_y, pull_x, pull_y, couple, stay[2], stay[3])
    behind = _line(-1.0, line_x, line_y, pull_x, pull_y, couple, keep[2], keep[3])
    return length, ahead, behind


@nb.njit(cache=True, inline='always')
def _line(
    sign: float,
    line_x: float,
    line_y: float,
    pull_x: float,
    pull_y: float,
    couple: float,
    normal_x: float,
    normal_y: float,
) -> Numbers:  # pragma: no cover - compiled
    """Return a row of `removal.contact_lines`."""
    base_x = -0.5 * pull_x - sign * couple * line_y
    base_y = -0.5 * pull_y + sign * couple * line_x
    grip_x = sign * line_x
    grip_y = sign * line_y
    return (
        -(base_x * normal_x + base_y * normal_y),
        base_y * normal_x - base_x * normal_y,
        -(grip_x * normal_x + grip_y * normal_y),
        grip_y * normal_x - grip_x * normal_y,
    )
