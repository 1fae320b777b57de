# SPDX-License-Identifier: Apache-2.0
"""The path of a tip's centre around a section, measured in phase: where a tip can be.

A tip of radius r that rolls without slip while the object turns by dθ moves its contact by
ds = −dθ / (κ + 1/r) ([Kumar2021] Eq. 8, with signed κ). On the offset curve, the path of the
tip's centre, that is dσ = (1 + rκ) ds = −r dθ whatever κ is. So with the *phase* x = σ/r, rolling
by θ maps x to x − θ exactly: along edges, about corners and through wide hollows alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from microhand_planner.core.arc_chain import ArcChain
from microhand_planner.core.blocked_phases import blocked_intervals
from microhand_planner.core.errors import InadmissibleContact
from microhand_planner.core.outer_arcs import outer_arcs
from microhand_planner.core.parameters import check_number
from microhand_planner.core.part import Part
from microhand_planner.core.section import Plane, Section, frozen_array
from microhand_planner.core.tip_clearance import distance_to_part

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

PENETRATION_SHARE = 0.001
"""Share of its radius by which a tip may overlap the mesh, beyond what facets explain."""
LARGEST_TURN_RAD = 0.2
"""No arc of the table turns further, so that each crosses the X axis once at most."""
KINK_RAD = 1e-6
"""A larger jump of the normal while the centre stays in place is a kink."""


@dataclass(frozen=True)
class ContactPoints:
    """What a tip meets at some phases; one row per phase, plane coordinates.

    Parameters
    ----------
    phase_rad : (k,) array
        As asked for [rad].
    centre_um, contact_um, normal : (k, 2) arrays
        Tip centre [µm], contact point [µm], outward unit normal of the object.
    admissible : (k,) array of bool
        False where a tip must not stand.
    """

    phase_rad: FloatArray
    centre_um: FloatArray
    contact_um: FloatArray
    normal: FloatArray
    admissible: BoolArray


@dataclass(frozen=True)
class OffsetCurve:
    """Everywhere the tip's centre can run around a section, as a table of arcs over phase.

    Phase 0 is where the centre crosses the +X axis; phases grow counter-clockwise and repeat
    after `length_rad`. Arc i covers the phases from ``phase_rad[i]`` to ``phase_rad[i + 1]``.

    Parameters
    ----------
    plane : Plane
        Where the curve lies.
    finger_radius_um : float
        Radius of the tip [µm].
    arcs : ArcChain
        The k reachable arcs of the outline, in the order of their phases.
    phase_rad : (k + 1,) array
        Phase at the start of each arc, and last the phase of a full turn [rad].
    phase_of_joint_j : float
        Phase where the centre crosses the −X axis [rad].
    kinks_rad : (m,) array
        Phases at which the tip touches two places; it cannot roll across [rad].
    blocked_rad : (b, 2) array
        Intervals of phase in which no tip may stand, ascending, within a turn [rad].
    unreachable_share : float
        Share of the outline's length that the tip cannot touch.
    """

    plane: Plane
    finger_radius_um: float
    arcs: ArcChain
    phase_rad: FloatArray
    phase_of_joint_j: float
    kinks_rad: FloatArray
    blocked_rad: FloatArray
    unreachable_share: float

    @property
    def length_rad(self) -> float:
        """One turn in phase, T [rad]; (P + 2πr)/r for a convex section of perimeter P."""
        return float(self.phase_rad[-1])

    @property
    def inadmissible_share(self) -> float:
        """Share of the phases at which no tip may stand."""
        return float(np.diff(self.blocked_rad, axis=1).sum()) / self.length_rad

    def at(self, phase_rad: FloatArray | float) -> ContactPoints:
        """Look up contacts at any phases (k,) [rad], exactly; periodic."""
        phase = np.atleast_1d(np.asarray(phase_rad, dtype=np.float64))
        row, fraction = self.locate(phase)
        contact_um, normal = self.arcs.points(row, fraction)
        centre_um = contact_um + self.finger_radius_um * normal
        admissible = _obstacles_met(self.blocked_rad, self.length_rad, phase, phase) == 0
        return ContactPoints(phase, centre_um, contact_um, normal, admissible)

    def locate(self, phase_rad: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the arc, and the fraction of it, at which each phase (k,) lies."""
        within = np.mod(phase_rad, self.length_rad)
        row = np.searchsorted(self.phase_rad, within, side='right') - 1
        row = np.clip(row, 0, len(self.arcs) - 1)
        start = self.phase_rad[row]
        return row, (within - start) / (self.phase_rad[row + 1] - start)

    def rolls_freely(self, from_rad: FloatArray | float, to_rad: FloatArray | float) -> BoolArray:
        """Tell whether a tip can roll straight from one phase to another.

        Parameters
        ----------
        from_rad, to_rad : (k,) arrays or float
            Both ends [rad], unwrapped: from 0 to `length_rad` is once around.

        Returns
        -------
        (k,) array of bool
            True if neither a kink nor a blocked phase lies between, ends included.
        """
        kinks = np.column_stack([self.kinks_rad, self.kinks_rad])
        obstacles = np.vstack([self.blocked_rad, kinks])
        low, high = np.minimum(from_rad, to_rad), np.maximum(from_rad, to_rad)
        return _obstacles_met(obstacles, self.length_rad, low, high) == 0


def _obstacles_met(
    obstacles_rad: FloatArray, turn_rad: float, low_rad: FloatArray, high_rad: FloatArray
) -> NDArray[np.intp]:
    """Count the intervals of phase, repeated every turn, that touch [low, high]."""
    if len(obstacles_rad) == 0:
        return np.zeros(np.broadcast(low_rad, high_rad).size, dtype=np.intp)
    starts, ends = np.sort(obstacles_rad[:, 0]), np.sort(obstacles_rad[:, 1])
    turns_low, within_low = np.divmod(np.atleast_1d(low_rad), turn_rad)
    turns_high, within_high = np.divmod(np.atleast_1d(high_rad), turn_rad)
    begun = np.searchsorted(starts, within_high, side='right')
    over = np.searchsorted(ends, within_low, side='left')
    turns = np.rint(turns_high - turns_low).astype(np.intp)
    return np.asarray(begun - over + turns * len(starts))


def offset_curve(
    section: Section,
    finger_radius_um: float,
    part: Part | None = None,
    max_out_of_plane_sin: float = 0.02,
) -> OffsetCurve:
    """Build the path of a tip's centre around a section.

    Where a hollow is narrower than the tip, or the tip would touch two places at once, the path
    turns from one side to the other at a kink, and the outline in between is unreachable. A
    cavity whose mouth is too narrow in the plane counts as unreachable.

    Phases are blocked where the surface leans out of the plane by more than a tolerance and, with
    `part`, where the tip goes deeper than 0.001 r plus twice the facet gap into the solid
    anywhere: above or below the plane, or in a piece that is not part of the outline. (Such a
    piece cannot swallow the tip unnoticed: between the tip's centre in it and the contact outside
    it lies its surface.)

    Parameters
    ----------
    section : Section
        The outline.
    finger_radius_um : float
        Radius of the tip [µm].
    part : Part, optional
        The solid, to look for contacts out of the plane.
    max_out_of_plane_sin : float
        Largest sine of the angle between surface normal and plane.

    Raises
    ------
    InvalidNumber, InvalidParameter
        A number is outside its range.
    InadmissibleContact
        The path does not cross the X axis on both sides of the origin.

    Examples
    --------
    >>> from microhand_planner.core.analytic_sections import ellipse_section
    >>> from microhand_planner.core.section import XY_PLANE
    >>> curve = offset_curve(ellipse_section(10.0, 10.0, XY_PLANE), 5.0)
    >>> round(curve.length_rad / np.pi, 9), curve.at(0.0).centre_um.round(6).tolist()
    (6.0, [[15.0, 0.0]])
    """
    radius = check_number('finger-radius', finger_radius_um, low=0.01, high=1e4)
    check_number('max-out-of-plane-sin', max_out_of_plane_sin, low=0.0, high=1.0)
    arcs = section.arcs.split(LARGEST_TURN_RAD)
    if not section.is_convex:
        arcs = outer_arcs(arcs, radius)
    arcs, joint_j_um = _start_at_joint_i(arcs, radius, section.plane)
    path_um = np.concatenate([[0.0], np.cumsum(arcs.offset_length_um(radius))])
    end_angle = arcs.normal_angle_rad + arcs.turn_rad
    jump = np.sin(0.5 * (np.roll(arcs.normal_angle_rad, -1) - end_angle))
    kinks_um = np.sort(path_um[1:][np.abs(jump) > KINK_RAD] % path_um[-1])
    touched = float(arcs.arc_length_um.sum()) / section.perimeter_um
    curve = OffsetCurve(
        plane=section.plane,
        finger_radius_um=radius,
        arcs=arcs,
        phase_rad=frozen_array(path_um / radius),
        phase_of_joint_j=joint_j_um / radius,
        kinks_rad=frozen_array(kinks_um / radius),
        blocked_rad=frozen_array(np.zeros((0, 2))),
        unreachable_share=max(0.0, 1.0 - touched),
    )
    deepest_um = PENETRATION_SHARE * radius + 2.0 * section.facet_gap_um

    def is_blocked(phase_rad: FloatArray) -> BoolArray:
        row, fraction = curve.locate(phase_rad)
        lean = arcs.out_of_plane_sin[row] + fraction * arcs.out_of_plane_rise[row]
        blocked = lean > max_out_of_plane_sin
        centre_um = curve.at(phase_rad).centre_um
        if part is not None:
            in_object_um = section.plane.to_object(centre_um)
            blocked |= distance_to_part(in_object_um, part, radius) < radius - deepest_um
        return np.asarray(blocked)

    blocked_rad = blocked_intervals(is_blocked, curve.length_rad)
    return replace(curve, blocked_rad=frozen_array(blocked_rad))


def _start_at_joint_i(arcs: ArcChain, radius_um: float, plane: Plane) -> tuple[ArcChain, float]:
    """Rotate a closed chain so that it starts where the tip's centre crosses +X.

    Of several crossings the outermost counts: from there the tip can leave along the axis.

    Returns
    -------
    arcs : ArcChain
        Starting at joint I; the arc that the axis cuts is split.
    joint_j_um : float
        Path length from joint I to where the centre crosses −X [µm].
    """
    row = np.arange(len(arcs))
    contact_um, normal = arcs.points(row, np.zeros(len(row)))
    height = (contact_um + radius_um * normal)[:, 1]
    next_height = np.roll(height, -1)
    length_um = arcs.offset_length_um(radius_um)
    path_um = np.cumsum(length_um) - length_um

    def crossing(rows: NDArray[np.intp], side: int) -> tuple[int, float]:
        """Return arc and fraction of the outermost crossing on one side of the origin."""

        def height_at(fraction: float, index: int) -> float:
            contact, direction = arcs.points(np.array([index]), np.array([fraction]))
            return float(contact[0, 1] + radius_um * direction[0, 1])

        found = []
        for index in rows.tolist():
            ends = height_at(0.0, index), height_at(1.0, index)
            if ends[0] * ends[1] < 0.0:
                fraction = float(brentq(height_at, 0.0, 1.0, args=(index,), xtol=1e-15))
            else:  # at an end, up to rounding
                fraction = float(abs(ends[1]) < abs(ends[0]))
            contact, direction = arcs.points(np.array([index]), np.array([fraction]))
            found.append((side * (contact + radius_um * direction)[0, 0], index, fraction))
        if not found or max(found)[0] <= 0.0:
            sign = '+' if side > 0 else '-'
            raise InadmissibleContact(
                'object origin',
                f'where no tip of {radius_um:g} µm radius meets the {sign}X axis in the plane'
                f' normal to {plane.axis.upper()}',
                'an origin inside the object, with the surface reachable along +X and -X',
            )
        return max(found)[1:]

    start_row, start = crossing(np.flatnonzero((height < 0.0) & (next_height >= 0.0)), 1)
    end_row, end = crossing(np.flatnonzero((height > 0.0) & (next_height <= 0.0)), -1)
    start_um = float(path_um[start_row] + start * length_um[start_row])
    joint_j_um = float(path_um[end_row] + end * length_um[end_row])
    rows = np.concatenate([np.arange(start_row, len(arcs)), np.arange(start_row + 1)])
    first, last = np.zeros(len(rows)), np.ones(len(rows))
    first[0], last[-1] = start, start
    keep = (last - first) * length_um[rows] > 1e-12 * length_um.sum()
    turned = arcs.clip(rows[keep], first[keep], last[keep])
    return turned, float((joint_j_um - start_um) % length_um.sum())
