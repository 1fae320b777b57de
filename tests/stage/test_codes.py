# SPDX-License-Identifier: Apache-2.0
"""Numbers that the ROS-free modules repeat are those of the messages."""

from __future__ import annotations

import inspect

import pytest
from microhand_msgs_py.msg import ErrorCode, StageState

from stage_driver_sim import errors
from stage_driver_sim.controller import Mode

CODES = {
    'StageError': 'INTERNAL',
    'InvalidNumber': 'INVALID_NUMBER',
    'InvalidParameter': 'INVALID_PARAMETER',
    'TravelExceeded': 'TRAVEL_EXCEEDED',
    'StreamBroken': 'STREAM_BROKEN',
    'LeftoverChunk': 'STREAM_BROKEN',
    'NotAllowed': 'NOT_ALLOWED',
    'ContactSilent': 'NO_CONTACT',
    'StageFailed': 'STAGE_FAULT',
    'StageSilent': 'STAGE_FAULT',
}


def test_every_error_has_the_code_of_the_message() -> None:
    """Each class of the tree carries the constant of ErrorCode that its name stands for."""
    classes = dict(inspect.getmembers(errors, inspect.isclass))
    assert set(classes) == set(CODES)
    for name, constant in CODES.items():
        assert classes[name].code == getattr(ErrorCode, constant), name


@pytest.mark.parametrize('mode', list(Mode))
def test_every_mode_has_the_number_of_the_message(mode: Mode) -> None:
    """Each mode is the constant of StageState of the same name."""
    assert getattr(StageState, mode.name) == mode
