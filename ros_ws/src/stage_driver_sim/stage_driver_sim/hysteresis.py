# SPDX-License-Identifier: Apache-2.0
"""Prandtl–Ishlinskii hysteresis: the width of a loop → the play operators that make it.

The displacement of a piezo is an elastic part and a sum of play operators of its voltage ``u``
([Kuhnen2003])::

    h(u) = q u + sum_i w_i z_i        z_i = max(u - r_i, min(u + r_i, z_i before))

A play operator of threshold ``r`` follows ``u`` at a distance of ``r``, like the load behind a
gear with backlash ``2 r``. With thresholds spread evenly, all loops are bounded by parabolas, as
Rayleigh found for small fields: a loop of a tenth of the travel is a tenth as wide for its size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PLAYS = 12


@dataclass(frozen=True, eq=False)
class PlayOperators:
    """The operators of one axis.

    Parameters
    ----------
    elastic : float
        Slope just after a reversal, when no operator moves: ``q`` [-].
    thresholds_um : (n,) ndarray
        ``r_i`` [µm].
    weights : (n,) ndarray
        ``w_i`` [-].
    """

    elastic: float
    thresholds_um: NDArray[np.float64]
    weights: NDArray[np.float64]

    @property
    def steepest(self) -> float:
        """Slope when all operators move [-]."""
        return float(self.elastic + self.weights.sum())


def design_hysteresis(width: float, half_travel_um: float) -> PlayOperators:
    """Return operators whose loop over the whole travel has a given width and the slope 1.

    Between ``-A`` and ``A`` an operator makes a parallelogram; at ``u = 0`` its two branches are
    ``2 w min(r, A - r)`` apart, and from end to end it rises by ``2 w (A - r)``. The weights are
    proportional to the spacing of the thresholds, which are closer together where they are small.

    Parameters
    ----------
    width : float
        Distance of the branches in the middle, as a share of the travel [-].
    half_travel_um : float
        ``A`` [µm].

    Examples
    --------
    >>> plays = design_hysteresis(0.12, 50.0)
    >>> print(f'{plays.elastic:.2f} to {plays.steepest:.2f}')
    0.76 to 1.24
    """
    edges = (np.arange(PLAYS + 1) / PLAYS) ** 2
    shares = 0.5 * (edges[:-1] + edges[1:])
    spacing = np.diff(edges)
    weights = width * spacing / np.sum(spacing * np.minimum(shares, 1.0 - shares))
    return PlayOperators(
        elastic=float(1.0 - np.sum(weights * (1.0 - shares))),
        thresholds_um=half_travel_um * shares,
        weights=weights,
    )
