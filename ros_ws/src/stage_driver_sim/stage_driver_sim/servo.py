# SPDX-License-Identifier: Apache-2.0
"""The digital servo of an axis: integral control behind a filter that inverts the resonance.

"The most common method" for nanopositioners ([FL13]_), and what the manuals of piezo controllers
describe: P-I control, notch filters, a slew rate limiter ([E517]_, [E727]_). Sampled with the
period `T`, the mechanics are ``P = (b1/Z + b2/Z²) / (1 + a1/Z + a2/Z²)``, and the servo is::

    C = K (1 + a1/Z + a2/Z²) / ((1 - 1/Z) (1 - p/Z))        p = e^(-2 z w T)

so that in ``C P`` the resonance is gone, and what remains is the loop ``w² / (s (s + 2 z w))``,
closed: ``w² / (s² + 2 z w s + w²)``. `K` is tuned on small steps, where the piezo is least
sensitive; on long ways the loop is faster and less damped.

References
----------
.. [FL13] Fleming and Leang, ACC 2013, https://studylib.net/doc/18377340/
.. [E517] PI, E-517 manual, section 3.2.2: P-I controller, notch filter, slew rate limiter,
   http://38.142.81.21:8001/manual/e-lins/e481-series/specifications-english/page-28.html
.. [E727] PI, E-727 manual E727T0005, p. 35: PID with two notch filters, slew rate limitation,
   https://manualshive.com/en/manual/pi/e-727/e-727_user-manual_1554315-35.html
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.resonance import SampledOscillator

SAMPLE_S = 5e-5
"""Sampling period of the controller [s]: 20 kHz, usual for digital piezo controllers."""


@dataclass(frozen=True)
class Servo:
    """``du = pole * (du before) + gain * (e + a1 (e before) + a2 (e before that))``.

    Parameters
    ----------
    gain, pole, a1, a2 : float
        See above; `e` is the reference less the reading, `du` the change of the voltage, both in
        µm of nominal travel.
    """

    gain: float
    pole: float
    a1: float
    a2: float


def design_servo(
    frequency_Hz: float,
    damping: float,
    mechanics: SampledOscillator,
    slopes: tuple[float, float],
) -> Servo:
    """Return the servo that closes the loop with a given frequency and damping.

    Parameters
    ----------
    frequency_Hz, damping : float
        Of the closed loop, for small steps [Hz], [-].
    mechanics : SampledOscillator
        Over `SAMPLE_S`.
    slopes : (float, float)
        Smallest and largest slope of the piezo [-].

    Raises
    ------
    InvalidParameter
        The loop would be unstable on long ways: its frequency is too high for the sampling.
    """
    w = 2.0 * math.pi * frequency_Hz
    a1, a2 = mechanics.denominator
    pole = math.exp(-2.0 * damping * w * SAMPLE_S)
    # so that for slow signals C P = w / (2 z s)
    gain = w * SAMPLE_S * (1.0 - pole) / (2.0 * damping * (1.0 + a1 + a2) * slopes[0])
    b1, b2 = mechanics.numerator
    loop = gain * slopes[1]
    # (1 - 1/Z)(1 - p/Z) + loop (b1/Z + b2/Z²) = 0
    half = 0.5 * (loop * b1 - 1.0 - pole)
    root = cmath.sqrt(half * half - (pole + loop * b2))
    if max(abs(-half + root), abs(-half - root)) >= 1.0:
        raise InvalidParameter(
            f'natural_frequency_Hz is {frequency_Hz:g} with damping_ratio {damping:g}; '
            'allowed: a servo that is stable, try a lower frequency or more damping'
        )
    return Servo(gain, pole, a1, a2)
