# SPDX-License-Identifier: Apache-2.0
"""Logarithmic creep: its rate per decade → the relaxations that make it.

After a step of the voltage the displacement goes on ([PI_CREEP]_)::

    L(t) = L(0.1 s) (1 + g lg(t / 0.1 s))        g: creep per decade

That is one step. For any course of the voltage, the law is taken apart into relaxations of first
order, whose time constants are spread evenly over the logarithm of time ([Krejci2001]): each
decade of time constants contributes `g`.

References
----------
.. [PI_CREEP] Physik Instrumente, piezo tutorial, "creep / drift": g = 0.01 to 0.02,
   http://pdf.directindustry.com/pdf/physik-instrumente/piezo-tutorial-background-knowledge/13949-24506-_18.html
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FIRST_S, LAST_S = 0.1, 1e5
"""The law holds between these times after a step [s]: "a few hours", says the source."""
BEYOND = 10.0
"""Time constants reach beyond these times by this factor: near its ends a spectrum is too weak."""
PER_DECADE = 2
"""Relaxations per decade: with two, the law is met within 1 % of `g`."""


@dataclass(frozen=True, eq=False)
class Relaxations:
    """What follows the displacement of the piezo slowly, and is added to it.

    Parameters
    ----------
    times_s : (n,) ndarray
        Time constants [s].
    weights : (n,) ndarray
        Contribution of each once it has relaxed, as a share of the step [-].
    """

    times_s: NDArray[np.float64]
    weights: NDArray[np.float64]


def design_creep(per_decade: float) -> Relaxations:
    """Return relaxations that creep by `per_decade` [-] between `FIRST_S` and `LAST_S`.

    Examples
    --------
    >>> creep = design_creep(0.015)
    >>> def grown(t):
    ...     return float(np.sum(creep.weights * -np.expm1(-t / creep.times_s)))
    >>> round((grown(100.0) - grown(10.0)) / (1.0 + grown(0.1)), 4)
    0.015
    """
    count = round(PER_DECADE * np.log10(BEYOND**2 * LAST_S / FIRST_S))
    decades = np.log10(FIRST_S / BEYOND) + (np.arange(count) + 0.5) / PER_DECADE
    times_s = 10.0**decades
    # The law counts from L(0.1 s), which has crept already.
    crept = np.sum(-np.expm1(-FIRST_S / times_s)) / PER_DECADE
    weight = per_decade / (1.0 - per_decade * crept) / PER_DECADE
    return Relaxations(times_s, np.full(count, weight))
