# SPDX-License-Identifier: Apache-2.0
"""Judging the stages' reports: which finger, which code, by how much."""

import dataclasses

import numpy as np
import pytest
from microhand_msgs_py.msg import ErrorCode, StageState

from microhand_planner.core.errors import RunFailed
from microhand_station.sequencer import stage_watch
from microhand_station.sequencer.stage_watch import (
    Mode,
    StageReport,
    check_alive,
    check_ready,
    finished,
    what_is_missing,
)

GOOD = StageReport(
    arrived_s=10.0,
    mode=Mode.HOLDING,
    position_um=np.array([50.0, 50.0, 50.0]),
    command_um=np.array([50.0, 50.0, 50.0]),
    velocity_um_s=np.zeros(3),
    on_target=True,
    stream=3,
    received=100,
    underruns=0,
    error_code=0,
    error_msg='',
    guard_tripped=False,
    contact_um=np.full(3, np.nan),
)
STREAMING = dataclasses.replace(GOOD, mode=Mode.STREAMING)


def fault(**changes):
    """Return what `check_alive` says of finger 2 when its report has these changes."""
    with pytest.raises(RunFailed) as error:
        check_alive([GOOD, dataclasses.replace(GOOD, **changes), GOOD], now_s=10.1)
    return error.value.code, str(error.value)


def test_good_reports_pass():
    """Stages that hold are alive and ready; one that streams is alive but not ready."""
    check_alive([GOOD, STREAMING, GOOD], now_s=10.4)
    check_ready([GOOD, GOOD, GOOD], now_s=10.4)
    with pytest.raises(RunFailed, match='finger 2: its stage is streaming; allowed: holding'):
        check_ready([GOOD, STREAMING, GOOD], now_s=10.1)


def test_silence_is_a_missing_stage():
    """Too long without a report, or none ever, is STAGE_MISSING and names the finger."""
    code, text = fault(arrived_s=9.0)
    assert code == ErrorCode.STAGE_MISSING
    assert text.startswith('finger 2: its stage driver has been silent for 1.10 s')
    with pytest.raises(RunFailed, match='finger 3: its stage driver is silent') as error:
        check_alive([GOOD, GOOD, None], now_s=10.1)
    assert error.value.code == ErrorCode.STAGE_MISSING


def test_a_fault_carries_the_drivers_words():
    """What the driver says about axis and amount reaches the caller."""
    code, text = fault(mode=Mode.FAULT, error_code=301, error_msg='z: stuck at 12 µm')
    assert (code, text) == (ErrorCode.STAGE_FAULT, 'finger 2: z: stuck at 12 µm')
    code, _ = fault(mode=Mode.FAULT, error_code=303, error_msg='ran dry')
    assert code == ErrorCode.STREAM_BROKEN
    code, text = fault(
        mode=Mode.FAULT, error_code=310, error_msg='finger_2: nobody reports contacts'
    )
    assert (code, text) == (ErrorCode.NO_CONTACT, 'finger 2: nobody reports contacts')
    code, text = fault(mode=Mode.STOPPED)
    assert (code, text) == (ErrorCode.STAGE_FAULT, 'finger 2: its stage is stopped')


def test_finished_means_all_setpoints_and_on_target():
    """One setpoint short, another stream, or not holding: not finished, and it says why."""
    assert finished([GOOD] * 3, stream=3, setpoints=100)
    short = dataclasses.replace(GOOD, received=99)
    assert not finished([GOOD, short, GOOD], 3, 100)
    assert what_is_missing([GOOD, short, GOOD], 3, 100) == (
        'finger 2: accepted 99 of 100 setpoints'
    )
    assert not finished([GOOD, GOOD, dataclasses.replace(GOOD, on_target=False)], 3, 100)
    assert what_is_missing([GOOD, STREAMING, GOOD], 3, 100) == (
        'finger 2: its stage is streaming; allowed: holding'
    )
    assert not finished([GOOD, GOOD, None], 3, 100)


def test_a_stage_that_was_stopped_by_contact_is_finished_with_less():
    """A tripped guard takes nothing more of its stream; of another stream it says nothing."""
    stopped = dataclasses.replace(GOOD, received=60, guard_tripped=True)
    assert finished([GOOD, stopped, GOOD], 3, 100)
    assert what_is_missing([GOOD, stopped, GOOD], 3, 100) == ''
    assert not finished([GOOD, dataclasses.replace(stopped, mode=Mode.STREAMING), GOOD], 3, 100)
    assert not finished([GOOD, stopped, GOOD], 4, 60)


def test_modes_and_codes_are_those_of_the_messages():
    """The pure part repeats constants of the interfaces; here they are kept in step."""
    for mode in Mode:
        assert getattr(StageState, mode.name) == mode.value
    for name in ('STAGE_MISSING', 'STAGE_FAULT', 'STREAM_BROKEN', 'NO_CONTACT'):
        assert getattr(stage_watch, name) == getattr(ErrorCode, name)
