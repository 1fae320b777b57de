# SPDX-License-Identifier: Apache-2.0
"""The parameters of a driver decide which stage it drives, and which it must not."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.faults import FaultyStage
from stage_driver_sim.presets import PRESETS, REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.protocol import StageLimits
from stage_driver_sim.remote_stage import RemoteStage
from stage_driver_sim.stage_choice import power_up
from tests.stage.gcs_bench import running_server

LIMITS = StageLimits(np.zeros(3), np.full(3, 100.0), np.full(3, 50.0), 3500.0, 3e6)


def parameters(**changes: Any) -> Any:
    """Return what `power_up` reads of the parameters of a driver."""
    values = {
        'driver': 'simulated',
        'finger': 2,
        'hardware_id': '',
        'seed': 0,
        'axes': REPRESENTATIVE_100_UM_XYZ,
        'limits': LIMITS,
        'gcs_axes': ('1', '2', '3'),
        'gcs_period_s': 0.002,
    }
    return SimpleNamespace(**{**values, **changes})


def test_a_simulated_stage_has_what_the_parameters_say() -> None:
    """Limits with their acceleration, a name of its finger, or the one that it is given."""
    stage = power_up(parameters(), 0.0)
    assert isinstance(stage, FaultyStage)
    assert (stage.hardware_id, stage.limits.max_acceleration_um_s2) == ('simulated-2', 3e6)
    assert power_up(parameters(hardware_id='mine'), 0.0).hardware_id == 'mine'
    slow = PRESETS['slow_200_um_xyz']
    far = replace(LIMITS, upper_um=np.full(3, 202.161), home_um=np.full(3, 101.0))
    stage = power_up(parameters(axes=slow, limits=far), 0.0)
    np.testing.assert_allclose(stage.limits.upper_um, 202.161)


def test_a_gcs_stage_is_the_one_that_is_meant() -> None:
    """The name must be part of what the controller says it is; else both are named."""
    with running_server(name='E-1 0815') as server:
        address = ('127.0.0.1', server.port)
        meant = parameters(driver='gcs', gcs_address=address, hardware_id='0815')
        stage = power_up(meant, time.monotonic())
        assert isinstance(stage, RemoteStage)
        assert stage.limits is LIMITS
        stage.close()
        other = parameters(driver='gcs', gcs_address=address, hardware_id='4711')
        with pytest.raises(InvalidParameter, match=r"hardware_id is '4711'; allowed: part .*0815"):
            power_up(other, time.monotonic())
