# SPDX-License-Identifier: Apache-2.0
"""Stages to simulate, by name.

No preset is a data sheet: each is *representative* of its class, with the source of every figure.
The loop's bandwidth spans two orders of magnitude in practice: a commercial 202 µm stage steps
(10-90 %) in 46 ms, about 7 Hz [MCL]_; an industrial stage with a first resonance of 739 Hz reaches
845 Hz with special damping control [DAMP]_; the gain of a plain integral servo is limited by the
damping of that resonance, and damping control bought a factor of five [FL13]_.

References
----------
.. [MCL] Mad City Labs Nano-Z200, 202.161 µm, as used in iSIM,
   https://github.com/LEB-EPFL/iSIM/wiki/Hardware-Components
.. [DAMP] Industrial PI nanopositioner, https://arxiv.org/html/2412.18374v1
.. [FL13] Fleming and Leang, ACC 2013, https://studylib.net/doc/18377340/
.. [FL14] Fleming, Measuring and predicting resolution in nanopositioning systems, 2014: class of
   1-100 µm range with a resolution of about 1 nm
"""

from __future__ import annotations

from stage_driver_sim.model import AxisParameters

_AXIS_100_UM = AxisParameters(
    lower_um=0.0,
    upper_um=100.0,  # [FL14]: top of the class; the travel usual for XYZ cubes
    max_velocity_um_s=3500.0,  # [MCL]: 80 % of 202 µm in 46 ms
    natural_frequency_Hz=150.0,  # between [MCL] and [DAMP], nearer the well-tuned end
    damping_ratio=0.7,  # a servo is tuned to settle without ringing
    noise_rms_um=0.001,  # [FL14]
    resolution_um=0.001,  # [FL14]
)

REPRESENTATIVE_100_UM_XYZ = (_AXIS_100_UM, _AXIS_100_UM, _AXIS_100_UM)
"""Closed-loop XYZ piezo stage of 100 µm travel; the axes are alike, so that a straight command
stays a straight path."""
