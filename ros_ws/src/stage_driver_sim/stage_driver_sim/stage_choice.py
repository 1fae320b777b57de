# SPDX-License-Identifier: Apache-2.0
"""Parameters → the stage that they describe, powered up: a simulated one, or one behind GCS."""

from __future__ import annotations

from functools import partial

import numpy as np

from stage_driver_sim.driver_parameters import DriverParameters
from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.faults import FaultyStage
from stage_driver_sim.gcs.connection import TcpConnection
from stage_driver_sim.gcs.gcs_stage import GcsStage
from stage_driver_sim.remote_stage import RemoteStage
from stage_driver_sim.simulated_stage import SimulatedStage


def power_up(parameters: DriverParameters, now_s: float) -> FaultyStage | RemoteStage:
    """Return the stage of a driver.

    Raises
    ------
    StageError
        There is no such stage, or it is another one than the parameters say.
    """
    if parameters.driver == 'gcs':
        return RemoteStage(partial(_connect, parameters), period_s=parameters.gcs_period_s)
    return FaultyStage(
        SimulatedStage(
            parameters.axes,
            home_um=parameters.limits.home_um,
            rng=np.random.default_rng([parameters.seed, parameters.finger]),
            now_s=now_s,
            hardware_id=parameters.hardware_id or f'simulated-{parameters.finger}',
            max_acceleration_um_s2=parameters.limits.max_acceleration_um_s2,
        )
    )


def _connect(parameters: DriverParameters, now_s: float) -> GcsStage:
    """Return the stage at the address of the parameters."""
    stage = GcsStage(
        TcpConnection(*parameters.gcs_address),
        axes=parameters.gcs_axes,
        limits=parameters.limits,
        now_s=now_s,
    )
    if parameters.hardware_id not in stage.hardware_id:
        stage.close()
        raise InvalidParameter(
            f'hardware_id is {parameters.hardware_id!r}; '
            f'allowed: part of what the controller says it is, {stage.hardware_id!r}'
        )
    return stage
