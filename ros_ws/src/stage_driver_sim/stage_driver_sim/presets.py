# SPDX-License-Identifier: Apache-2.0
"""Stages to simulate, by name.

No preset is a data sheet: each is *representative* of its class, with the source of every figure,
and where no source was in reach, it says so.

- Open-loop hysteresis is 10 to 15 % of a large motion [PZT]_, creep 1 to 2 % of a step per decade
  of time [PI_CREEP]_: the presets have 12 % and 1.5 %.
- The bandwidth of servos spans two orders of magnitude. A commercial 202 µm stage steps (10-90 %)
  in 46 ms [MCL]_: ``2.15 / (2 pi f)`` at a damping of 0.7, so f = 7.4 Hz. An industrial stage with
  its first resonance at 739 Hz reaches 845 Hz with special damping control [DAMP]_. In between,
  damping control bought a factor of five over a plain integral servo [FL13]_.
- The damping of flexures is not in any source that was in reach: 0.02 is representative.

References
----------
.. [PZT] PI Ceramic, piezo tutorial, http://www.piceramic.com/piezo_tutorial5.php
.. [PI_CREEP] PI, piezo tutorial, "creep / drift", http://pdf.directindustry.com/pdf/
   physik-instrumente/piezo-tutorial-background-knowledge/13949-24506-_18.html
.. [MCL] Mad City Labs Nano-Z200, 202.161 µm, as used in iSIM,
   https://github.com/LEB-EPFL/iSIM/wiki/Hardware-Components
.. [DAMP] Industrial PI nanopositioner, https://arxiv.org/html/2412.18374v1
.. [FL13] Fleming and Leang, ACC 2013, https://studylib.net/doc/18377340/
.. [FL14] Fleming, Measuring and predicting resolution in nanopositioning systems, 2014: class of
   1-100 µm range with a resolution of about 1 nm
"""

from __future__ import annotations

from dataclasses import replace

from stage_driver_sim.axis_parameters import AxisParameters

_AXIS_100_UM = AxisParameters(
    lower_um=0.0,
    upper_um=100.0,  # [FL14]: top of the class; the travel usual for XYZ cubes
    max_velocity_um_s=3500.0,  # [MCL]: 80 % of 202 µm in 46 ms
    natural_frequency_Hz=150.0,  # between [MCL] and [DAMP], nearer the well-tuned end
    damping_ratio=0.7,  # a servo is tuned to settle without ringing
    noise_rms_um=0.001,  # [FL14]
    resolution_um=0.001,  # [FL14]
    resonance_Hz=739.0,  # [DAMP]
    resonance_damping=0.02,
    hysteresis=0.12,  # [PZT]
    creep_per_decade=0.015,  # [PI_CREEP]
)
_AXIS_200_UM = replace(_AXIS_100_UM, upper_um=202.161, natural_frequency_Hz=7.4)  # [MCL]
_AXIS_DAMPED = replace(_AXIS_100_UM, natural_frequency_Hz=845.0)  # [DAMP]

REPRESENTATIVE_100_UM_XYZ = (_AXIS_100_UM, _AXIS_100_UM, _AXIS_100_UM)
"""Closed-loop XYZ piezo stage of 100 µm travel; the axes are alike, so that a straight command
stays a straight path."""

SLOW_200_UM_XYZ = (_AXIS_200_UM, _AXIS_200_UM, _AXIS_200_UM)
"""Three axes with travel and step response of the Nano-Z200: what an untuned stage is like."""

DAMPED_100_UM_XYZ = (_AXIS_DAMPED, _AXIS_DAMPED, _AXIS_DAMPED)
"""Three axes with resonance and bandwidth of [DAMP]_: the fastest that has been shown."""

PRESETS = {
    'representative_100_um_xyz': REPRESENTATIVE_100_UM_XYZ,
    'slow_200_um_xyz': SLOW_200_UM_XYZ,
    'damped_100_um_xyz': DAMPED_100_UM_XYZ,
}


def max_acceleration_um_s2(axis: AxisParameters) -> float:
    """Return the acceleration that the servo of an axis still follows closely [µm/s²].

    To its velocity limit within ``1 / w``, `w` the angular frequency of the closed loop.
    """
    return axis.max_velocity_um_s * 6.283185307179586 * axis.natural_frequency_Hz
