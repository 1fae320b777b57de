# SPDX-License-Identifier: Apache-2.0
"""A station whose second finger stands behind a GCS controller: nobody else can tell."""

import contextlib
import dataclasses
import time

import numpy as np
import pytest
from microhand_msgs_py.msg import ErrorCode, StageState
from microhand_msgs_py.srv import GetStageLimits

from microhand_planner.ros.conversions import um_from_point
from microhand_station.client import StationError
from microhand_station.service_call import call
from tests.stage.gcs_bench import ServerProcess
from tests.station.bench import BASE_UM, CONFIG, DEADLINE_S, Bench

GCS = 2


@pytest.fixture(scope='module')
def server():
    """Return a GCS server whose stage is that of finger 2, at home."""
    finger = CONFIG.fingers[GCS - 1]
    travel = ('--travel-um', str(finger.lower_um[0]), str(finger.upper_um[0]))
    server = ServerProcess(*travel, '--home-um', *map(str, finger.home_um))
    yield server
    server.close()


@pytest.fixture(scope='module')
def started(ros_domain, server, tmp_path_factory, sphere_mesh):
    """Start the bench, finger 2 on GCS; takes the place of the fixture that simulates all."""
    fingers = list(CONFIG.fingers)
    fingers[GCS - 1] = dataclasses.replace(
        fingers[GCS - 1],
        driver={'driver': 'gcs', 'gcs_address': f'127.0.0.1:{server.port}'},
    )
    config = dataclasses.replace(CONFIG, fingers=tuple(fingers))
    bench = Bench(tmp_path_factory.mktemp('gcs'), sphere_mesh, config)
    yield bench
    bench.close()


def test_a_plan_is_executed_and_the_object_held(bench, sphere_plan):
    """With guarded approaches, forces and regrasp, as by three simulated stages."""
    node = bench.client.node
    client = node.create_client(GetStageLimits, f'finger_{GCS}/stage_driver/get_limits')
    request = GetStageLimits.Request()
    limits = call(client, request, deadline_s=DEADLINE_S, who='finger 2', missing_code=900)
    assert limits.hardware_id == 'microhand, representative_100_um_xyz, 0, 0.1.0'

    plan = sphere_plan(20.0)
    result = bench.execute(plan)
    assert result.held
    states = bench.watcher.stages
    bench.watcher.wait(lambda: all(states[finger].on_target for finger in (1, 2, 3)))
    for finger in (1, 2, 3):
        state = states[finger]
        assert (state.mode, state.error_code, state.underruns) == (StageState.HOLDING, 0, 0)
        np.testing.assert_allclose(
            um_from_point(state.position), um_from_point(state.command), atol=0.02
        )
    touching_um = bench.watcher.tips_um()[:2]
    np.testing.assert_allclose(touching_um, plan.steps[-1].tip_um[-1, :2], atol=0.5)
    assert (BASE_UM < touching_um).all()


def test_a_controller_that_falls_silent_ends_the_run_and_names_its_finger(
    bench, server, sphere_plan
):
    """STAGE_FAULT for the caller, the others hold; when it answers again, a reset makes ready."""
    with bench.executing(sphere_plan(20.0)) as errors:
        bench.watcher.wait(lambda: bench.watcher.stages[GCS].mode == StageState.STREAMING)
        server.tell('FLT silent')
    (error,) = errors
    assert isinstance(error, StationError)
    assert error.code == ErrorCode.STAGE_FAULT
    assert 'finger 2' in str(error) or 'finger_2' in str(error)
    server.tell('FLT none')

    give_up_s = time.monotonic() + DEADLINE_S
    while bench.watcher.stages[GCS].mode != StageState.HOLDING:  # it is looked for now and then
        assert time.monotonic() < give_up_s, 'not reset in time'
        with contextlib.suppress(StationError):
            bench.client.command('reset')
