# SPDX-License-Identifier: Apache-2.0
"""What every stage promises, whatever is behind it; a new driver joins by one line in `MAKERS`.

The test turns the clock. `test_driver_contract` asks the same of whole drivers, over DDS.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from stage_driver_sim.errors import InvalidNumber, NotAllowed, TravelExceeded
from stage_driver_sim.faults import FaultyStage
from stage_driver_sim.gcs.gcs_stage import GcsStage
from stage_driver_sim.gcs.simulated_controller import SimulatedController
from stage_driver_sim.gcs.syntax import CommandSplitter, ReplySplitter
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.protocol import Stage
from stage_driver_sim.simulated_stage import SimulatedStage

TOLERANCE_UM = 0.02
SETTLE_S = 0.2
HOME_UM = np.array([50.0, 40.0, 60.0])


class Wire:
    """A connection to a simulated controller without a network: what is sent is executed."""

    def __init__(self, controller: SimulatedController) -> None:
        self._controller = controller
        self._commands = CommandSplitter()
        self._replies = ReplySplitter()

    def exchange(self, data: bytes, replies: int, now_s: float) -> list[list[str]]:
        """Have the controller execute commands now, and return its replies."""
        answers = [self._controller.handle(line, now_s) for line in self._commands.feed(data)]
        received = self._replies.feed(b''.join(answers))
        assert len(received) == replies
        return received

    def close(self) -> None:
        """Nothing to close."""


def make_simulated_stage() -> SimulatedStage:
    """Return a simulated stage, powered up at time 0."""
    return SimulatedStage(
        REPRESENTATIVE_100_UM_XYZ, home_um=HOME_UM, rng=np.random.default_rng(5), now_s=0.0
    )


def make_faulty_stage() -> Stage:
    """Return a stage with which nothing goes wrong yet."""
    return FaultyStage(make_simulated_stage())


def make_gcs_stage() -> Stage:
    """Return a stage behind a controller that speaks GCS."""
    stage = make_simulated_stage()
    wire = Wire(SimulatedController(stage))
    return GcsStage(wire, axes=('1', '2', '3'), limits=stage.limits, now_s=0.0)


MAKERS = [make_simulated_stage, make_faulty_stage, make_gcs_stage]


@pytest.fixture(params=MAKERS, ids=lambda make: make.__name__)
def powered_up(request: pytest.FixtureRequest) -> Stage:
    """Return each kind of stage as it powers up at time 0."""
    make: Callable[[], Stage] = request.param
    return make()


@pytest.fixture
def stage(powered_up: Stage) -> Stage:
    """Return each kind of stage, servo on, at rest in (50, 40, 60) µm at time 1."""
    powered_up.set_servo(True, 0.0)
    powered_up.command_um(HOME_UM, 0.0)
    powered_up.measure_um(1.0)
    return powered_up


def test_it_powers_up_with_the_servo_off_and_says_who_it_is(powered_up: Stage) -> None:
    """Nothing moves before somebody closes the servo, and the device has a name."""
    assert not powered_up.servo_on
    assert powered_up.hardware_id
    with pytest.raises(NotAllowed):
        powered_up.command_um(HOME_UM, 0.1)
    with pytest.raises(NotAllowed):
        powered_up.home(0.1)


def test_closing_the_servo_does_not_move_it(powered_up: Stage) -> None:
    """Where it was measured with the servo off, there it stays with the servo on."""
    before_um = powered_up.measure_um(0.0)
    powered_up.set_servo(True, 0.1)
    assert powered_up.servo_on
    np.testing.assert_allclose(powered_up.measure_um(1.0), before_um, atol=TOLERANCE_UM)


def test_it_goes_where_it_is_told_and_stays(stage: Stage) -> None:
    """All three axes arrive, each at its own position, and keep it."""
    target_um = np.array([51.0, 39.5, 60.25])
    stage.command_um(target_um, 1.0)
    for now_s in (1.0 + SETTLE_S, 2.0, 10.0):
        np.testing.assert_allclose(stage.measure_um(now_s), target_um, atol=TOLERANCE_UM)


def test_the_ends_of_the_travel_can_be_reached(stage: Stage) -> None:
    """Limits are ends that can be used, not open bounds."""
    for now_s, end_um in ((1.0, stage.limits.lower_um), (2.0, stage.limits.upper_um)):
        stage.command_um(end_um, now_s)
        np.testing.assert_allclose(stage.measure_um(now_s + 0.9), end_um, atol=TOLERANCE_UM)


@pytest.mark.parametrize('axis', [0, 1, 2])
@pytest.mark.parametrize(
    ('error', 'value_um'),
    [(TravelExceeded, 1e4), (TravelExceeded, -1e4), (InvalidNumber, math.nan)],
)
def test_what_it_cannot_reach_it_refuses_and_stays(
    stage: Stage, axis: int, error: type[Exception], value_um: float
) -> None:
    """One bad axis refuses the whole position; no axis moves."""
    target_um = HOME_UM + 5.0
    target_um[axis] = value_um
    with pytest.raises(error, match='xyz'[axis]):
        stage.command_um(target_um, 1.0)
    np.testing.assert_allclose(stage.measure_um(2.0), HOME_UM, atol=TOLERANCE_UM)


def test_it_is_not_faster_than_it_says(stage: Stage) -> None:
    """In half the time that the velocity limit allows it covers about half of a long way."""
    way_um = 30.0
    stage.command_um(HOME_UM + way_um, 1.0)
    half_s = 0.5 * way_um / stage.limits.max_velocity_um_s
    covered_um = stage.measure_um(1.0 + half_s) - HOME_UM
    assert (covered_um <= 0.5 * way_um + TOLERANCE_UM).all()


def test_stop_ends_a_motion_and_says_where(stage: Stage) -> None:
    """After a stop the stage stands where it said, short of its target."""
    stage.command_um(HOME_UM + 30.0, 1.0)
    held_um = stage.stop(1.003)
    assert (held_um < HOME_UM + 29.0).all()
    np.testing.assert_allclose(stage.measure_um(1.003 + SETTLE_S), held_um, atol=TOLERANCE_UM)
    stage.command_um(HOME_UM, 2.0)
    np.testing.assert_allclose(stage.measure_um(3.0), HOME_UM, atol=TOLERANCE_UM)


def test_home_is_reached_and_announced(stage: Stage) -> None:
    """`home` sets off, refuses commands on the way, and ends at the home position."""
    stage.command_um(HOME_UM - 20.0, 1.0)
    stage.measure_um(2.0)
    stage.home(2.0)
    assert stage.is_homing(2.001)
    with pytest.raises(NotAllowed):
        stage.command_um(HOME_UM, 2.001)
    assert not stage.is_homing(5.0)
    np.testing.assert_allclose(
        stage.measure_um(5.0 + SETTLE_S), stage.limits.home_um, atol=TOLERANCE_UM
    )


def test_stop_ends_homing(stage: Stage) -> None:
    """A stage on the way home can be stopped, and then commanded."""
    stage.command_um(HOME_UM - 20.0, 1.0)
    stage.measure_um(2.0)
    stage.home(2.0)
    held_um = stage.stop(2.002)
    assert not stage.is_homing(2.003)
    stage.command_um(held_um, 2.004)
    np.testing.assert_allclose(stage.measure_um(3.0), held_um, atol=TOLERANCE_UM)


def test_without_servo_it_does_not_follow(stage: Stage) -> None:
    """With the servo opened again, commands are refused and the stage stays."""
    stage.set_servo(False, 1.0)
    assert not stage.servo_on
    with pytest.raises(NotAllowed):
        stage.command_um(HOME_UM + 1.0, 1.1)
    np.testing.assert_allclose(stage.measure_um(2.0), HOME_UM, atol=TOLERANCE_UM)


def test_it_says_when_it_measured(stage: Stage) -> None:
    """The time of a reading is not in the future, and goes on with the readings."""
    stage.measure_um(1.5)
    first_s = stage.measured_s
    stage.measure_um(2.0)
    assert first_s <= 1.5
    assert first_s < stage.measured_s <= 2.0
    stage.close()
