# SPDX-License-Identifier: Apache-2.0
"""What a driver says of its stage: its state at one moment, and what happened."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from stage_driver_sim.protocol import Vector


class Mode(IntEnum):
    """As in ``microhand_msgs_py/msg/StageState``."""

    OFF = 0
    HOLDING = 1
    STREAMING = 2
    HOMING = 3
    STOPPED = 4
    FAULT = 5


@dataclass(frozen=True)
class Event:
    """Something worth remembering: becomes a ``RunEvent``."""

    time_s: float
    code: int
    text: str


class Snapshot(NamedTuple):
    """What the stage does at one moment: becomes a ``StageState``.

    `time_s` is when the position was measured; of a stage that has fallen silent it stands still.
    """

    time_s: float
    mode: Mode
    position_um: Vector
    velocity_um_s: Vector
    command_um: Vector
    on_target: bool
    stream: int
    received: int
    underruns: int
    dropped: int
    error_code: int
    error_msg: str
    guard_tripped: bool
    contact_um: Vector
