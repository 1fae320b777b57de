# SPDX-License-Identifier: Apache-2.0
"""Compile the stage model, so that a simulated stage of a new process need not wait.

Run once after installation: ``python -m stage_driver_sim.warm_up``.
"""

from __future__ import annotations

import numpy as np

from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.simulated_stage import SimulatedStage


def main() -> None:
    """Take one step."""
    stage = SimulatedStage(
        REPRESENTATIVE_100_UM_XYZ,
        home_um=np.full(3, 50.0),
        rng=np.random.default_rng(0),
        now_s=0.0,
    )
    stage.measure_um(0.001)


if __name__ == '__main__':
    main()
