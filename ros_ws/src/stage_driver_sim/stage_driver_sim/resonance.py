# SPDX-License-Identifier: Apache-2.0
"""The mechanics of an axis, over one sampling period of its controller: an oscillator, exactly.

Between two samples the amplifier keeps its voltage. The stage, mass on a flexure, obeys::

    x'' = w^2 (y - x) - 2 z w x'        w = 2 pi f: resonance, z: damping, y: where the piezo pulls

and its state after a period `T` is a linear function of the state before and of `y`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class SampledOscillator:
    """How position and velocity go on, relative to where the piezo pulls.

    ``x - y`` becomes ``xx (x - y) + xv v``, and ``v`` becomes ``vx (x - y) + vv v``.

    Parameters
    ----------
    xx, xv, vx, vv : float
        The matrix exponential of the motion [-], [s], [1/s], [-].
    """

    xx: float
    xv: float
    vx: float
    vv: float

    @property
    def denominator(self) -> tuple[float, float]:
        """``a1, a2`` of the pulse transfer function's denominator ``1 + a1/Z + a2/Z²``."""
        return -(self.xx + self.vv), self.xx * self.vv - self.xv * self.vx

    @property
    def numerator(self) -> tuple[float, float]:
        """``b1, b2`` of its numerator ``b1/Z + b2/Z²``; at rest, ``x`` equals ``y``."""
        a1, a2 = self.denominator
        return 1.0 - self.xx, 1.0 + a1 + a2 - (1.0 - self.xx)


def sample_oscillator(frequency_Hz: float, damping: float, period_s: float) -> SampledOscillator:
    """Return the motion of an oscillator over a period.

    Parameters
    ----------
    frequency_Hz : float
        Undamped natural frequency [Hz].
    damping : float
        Damping ratio [-], of any size.
    period_s : float
        How long [s].
    """
    w = 2.0 * math.pi * frequency_Hz
    cosine, sine_s = _decay(w, damping, period_s)
    return SampledOscillator(
        xx=cosine + damping * w * sine_s,
        xv=sine_s,
        vx=-w * w * sine_s,
        vv=cosine - damping * w * sine_s,
    )


def _decay(w: float, z: float, t: float) -> tuple[float, float]:
    """Return ``e^(-zwt) cos(vt)`` and ``e^(-zwt) sin(vt)/v``, v = w sqrt(1 - z²), for any damping.

    They make up the matrix exponential of ``[[0, 1], [-w², -2zw]] t``.
    """
    if z < 1.0:
        v = w * math.sqrt(1.0 - z * z)
        envelope = math.exp(-z * w * t)
        return envelope * math.cos(v * t), envelope * math.sin(v * t) / v
    v = w * math.sqrt(z * z - 1.0)
    slow = math.exp((v - z * w) * t)
    # cosh and sinh would overflow; expm1 keeps the difference exact for v -> 0.
    fast_less_slow = math.expm1(-2.0 * v * t)
    cosine = slow * (1.0 + 0.5 * fast_less_slow)
    sine = -slow * fast_less_slow / (2.0 * v) if v > 0.0 else slow * t
    return cosine, sine
