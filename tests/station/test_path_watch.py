# SPDX-License-Identifier: Apache-2.0
"""Following, judged: who is away from its setpoint, by how much, and for how long."""

import dataclasses

import numpy as np
import pytest
from microhand_msgs_py.msg import ErrorCode

from microhand_planner.core.errors import RunFailed
from microhand_station.sequencer import path_watch
from microhand_station.sequencer.path_watch import PathWatch, check_goal
from microhand_station.sequencer.stage_watch import Mode
from microhand_station.tolerance_config import ToleranceConfig
from tests.station.test_stage_watch import GOOD, STREAMING

LIMITS = ToleranceConfig(path_um=0.5, lag_s=0.05, path_dwell_s=0.1, goal_um=0.05, settle_s=2.0)


def away(y_um, arrived_s, velocity_um_s=0.0, base=STREAMING):
    """Return a report of a stage whose y is behind its command by `y_um`."""
    return dataclasses.replace(
        base,
        arrived_s=arrived_s,
        position_um=base.command_um - [0.0, y_um, 0.0],
        velocity_um_s=np.array([0.0, velocity_um_s, 0.0]),
        on_target=False,
    )


def test_a_stage_that_stays_away_is_named_with_axis_and_amount():
    """1.8 µm behind for a tenth of a second: finger, axis, amount, and what is allowed."""
    watch = PathWatch(LIMITS)
    watch.check([GOOD, away(1.8, 10.0), GOOD])
    watch.check([GOOD, away(1.8, 10.0), GOOD])  # the same report again
    watch.check([GOOD, away(1.81, 10.09), GOOD])
    with pytest.raises(RunFailed) as error:
        watch.check([GOOD, away(1.82, 10.11), GOOD])
    assert error.value.code == ErrorCode.PATH_TOLERANCE == path_watch.PATH_TOLERANCE
    assert str(error.value) == ('finger 2, y: 1.82 µm from its setpoint for 0.1 s, allowed 0.5 µm')


def test_standing_stages_are_judged_like_moving_ones_and_those_out_of_order_are_not():
    """A stage that drifts while it holds is away; one in a fault is somebody else's to tell."""
    for mode, judged in ((Mode.HOLDING, True), (Mode.FAULT, False), (Mode.HOMING, False)):
        base = dataclasses.replace(GOOD, mode=mode)
        watch = PathWatch(LIMITS)
        watch.check([away(1.0, 10.0, base=base), GOOD, None])
        if judged:
            with pytest.raises(RunFailed, match='finger 1, y'):
                watch.check([away(1.0, 11.0, base=base), GOOD, None])
        else:
            watch.check([away(1.0, 11.0, base=base), GOOD, None])


def test_being_late_and_a_single_hiccup_are_allowed():
    """At 40 µm/s a stage may be 2 µm more behind; a report in between that is good counts."""
    watch = PathWatch(LIMITS)
    for arrived_s in (10.0, 10.2, 10.4):
        watch.check([away(2.4, arrived_s, velocity_um_s=-40.0), GOOD, GOOD])
    for arrived_s in (11.0, 11.2, 11.4):
        watch.check([away(2.4, arrived_s), GOOD, GOOD])
        watch.check([away(0.1, arrived_s + 0.1), GOOD, GOOD])


def test_a_stage_that_never_settles_may_stay_within_the_goal_tolerance():
    """40 nm off is tolerated, 310 nm are named; on target is on target."""
    near, far = away(0.04, 10.0, base=GOOD), away(0.31, 10.0, base=GOOD)
    check_goal([near, GOOD, near], LIMITS)
    with pytest.raises(RunFailed) as error:
        check_goal([GOOD, GOOD, far], LIMITS)
    assert error.value.code == ErrorCode.GOAL_TOLERANCE == path_watch.GOAL_TOLERANCE
    assert str(error.value) == (
        'finger 3, y: 0.31 µm from its setpoint 2 s after the last one, allowed 0.05 µm'
    )
