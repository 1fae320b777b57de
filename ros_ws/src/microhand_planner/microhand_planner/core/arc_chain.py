# SPDX-License-Identifier: Apache-2.0
"""A run of circular arcs, and the arcs that a tip's centre runs on while it rolls over them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class ArcChain:
    """A run of arcs, each given by its start; one row per arc.

    Parameters
    ----------
    contact_um : (k, 2) array
        Where the tip touches at the start of the arc, plane coordinates [µm].
    normal_angle_rad : (k,) array
        Outward normal there [rad].
    turn_rad : (k,) array
        How far the normal turns along the arc [rad]; negative in a hollow.
    arc_length_um : (k,) array
        Length of the arc on the outline [µm]; 0 at a corner.
    out_of_plane_sin, out_of_plane_rise : (k,) arrays
        Sine of the angle between surface and plane normal at the start, and its change along
        the arc.
    """

    contact_um: FloatArray
    normal_angle_rad: FloatArray
    turn_rad: FloatArray
    arc_length_um: FloatArray
    out_of_plane_sin: FloatArray
    out_of_plane_rise: FloatArray

    def __len__(self) -> int:
        """Return the number of arcs."""
        return len(self.turn_rad)

    def points(self, row: NDArray[np.intp], fraction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return contacts (q, 2) [µm] and normals (q, 2) at a fraction 0..1 of arcs `row`."""
        return _points(
            self.contact_um,
            self.normal_angle_rad,
            self.turn_rad,
            self.arc_length_um,
            row,
            fraction,
        )

    def clip(self, row: NDArray[np.intp], start: FloatArray, end: FloatArray) -> ArcChain:
        """Return the parts of arcs `row` between two fractions each."""
        contact_um, _ = self.points(row, start)
        share = end - start
        return ArcChain(
            contact_um,
            self.normal_angle_rad[row] + start * self.turn_rad[row],
            share * self.turn_rad[row],
            share * self.arc_length_um[row],
            self.out_of_plane_sin[row] + start * self.out_of_plane_rise[row],
            share * self.out_of_plane_rise[row],
        )

    def split(self, most_turn_rad: float) -> ArcChain:
        """Return the same run, in arcs that turn by no more than `most_turn_rad` each."""
        parts = np.ceil(np.abs(self.turn_rad) / most_turn_rad).astype(np.intp)
        parts = np.maximum(parts, 1)
        row = np.repeat(np.arange(len(parts)), parts)
        number = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
        return self.clip(row, number / parts[row], (number + 1) / parts[row])

    def offset_length_um(self, radius_um: float) -> FloatArray:
        """Return the path of a tip's centre over each arc, (k,) [µm], signed.

        Negative where the hollow is narrower than the tip: there the path of the centre runs
        backwards, which no tip can do.
        """
        return self.arc_length_um + radius_um * self.turn_rad


@nb.njit(cache=True)
def _points(
    contact_um: FloatArray,
    normal_angle_rad: FloatArray,
    turn_rad: FloatArray,
    arc_length_um: FloatArray,
    row: NDArray[np.intp],
    fraction: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    """See `ArcChain.points`: for a few rows, and so often that calls of numpy would cost most."""
    at_um = np.zeros((len(row), 2))
    normal = np.zeros((len(row), 2))
    for k in range(len(row)):
        arc = row[k]
        half = 0.5 * fraction[k] * turn_rad[arc]
        middle = normal_angle_rad[arc] + half
        chord_um = fraction[k] * arc_length_um[arc] * (math.sin(half) / half if half else 1.0)
        at_um[k, 0] = contact_um[arc, 0] - chord_um * math.sin(middle)
        at_um[k, 1] = contact_um[arc, 1] + chord_um * math.cos(middle)
        normal[k, 0] = math.cos(middle + half)
        normal[k, 1] = math.sin(middle + half)
    return at_um, normal
