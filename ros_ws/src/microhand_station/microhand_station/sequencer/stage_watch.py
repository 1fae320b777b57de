# SPDX-License-Identifier: Apache-2.0
"""What the stages report, judged: is each of them there, in order, and keeping up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import FloatArray

STAGE_MISSING = 300
STAGE_FAULT = 301
STREAM_BROKEN = 303
NO_CONTACT = 310

SILENCE_S = 0.9
"""A stage that has not reported for longer is gone [s]; that its driver ended is known before."""


class Mode(IntEnum):
    """What a stage does; the values are those of ``microhand_msgs_py/msg/StageState``."""

    OFF = 0
    HOLDING = 1
    STREAMING = 2
    HOMING = 3
    STOPPED = 4
    FAULT = 5


@dataclass(frozen=True)
class StageReport:
    """The last state of one stage.

    Parameters
    ----------
    arrived_s : float
        When it arrived, on the sequencer's steady clock [s].
    mode : Mode
        What the stage does.
    position_um, command_um : (3,) float
        Measured and commanded, stage frame [µm].
    velocity_um_s : (3,) float
        Measured, stage frame [µm/s].
    on_target : bool
        Within the window around the command, for the dwell time.
    stream, received : int
        Stream of the last setpoint, and how many of that stream were accepted.
    underruns : int
        Times that a stream ran dry.
    error_code : int
        See ErrorCode; 0: none.
    error_msg : str
        What the driver says about it.
    guard_tripped : bool
        The stream was guarded, and ended at a contact.
    contact_um : (3,) float
        Where the stage was when its tip touched, stage frame [µm]; NaN: it did not.
    """

    arrived_s: float
    mode: Mode
    position_um: FloatArray
    command_um: FloatArray
    velocity_um_s: FloatArray
    on_target: bool
    stream: int
    received: int
    underruns: int
    error_code: int
    error_msg: str
    guard_tripped: bool
    contact_um: FloatArray


def check_alive(reports: Sequence[StageReport | None], now_s: float) -> None:
    """Check that every stage reports, and reports no fault.

    Parameters
    ----------
    reports : sequence of 3 StageReport or None
        Of fingers 1, 2, 3; None: nothing arrived yet.
    now_s : float
        On the clock of the reports [s].

    Raises
    ------
    RunFailed
        STAGE_MISSING, STREAM_BROKEN, NO_CONTACT or STAGE_FAULT; the message names the finger.
    """
    for finger, report in enumerate(reports, start=1):
        if report is None:
            raise RunFailed(f'finger {finger}: its stage driver is silent', STAGE_MISSING)
        silent_s = now_s - report.arrived_s
        if silent_s > SILENCE_S:
            raise RunFailed(
                f'finger {finger}: its stage driver has been silent for {silent_s:.2f} s; '
                f'allowed: up to {SILENCE_S:g} s',
                STAGE_MISSING,
            )
        if report.mode is Mode.FAULT:
            code = report.error_code or STAGE_FAULT
            # drivers begin with their own name for the finger
            text = report.error_msg.removeprefix(f'finger_{finger}: ')
            raise RunFailed(
                f'finger {finger}: {text or "its stage reports a fault"}',
                code if code in (STREAM_BROKEN, NO_CONTACT) else STAGE_FAULT,
            )
        if report.mode in (Mode.OFF, Mode.STOPPED):
            raise RunFailed(
                f'finger {finger}: its stage is {report.mode.name.lower()}', STAGE_FAULT
            )


def check_ready(reports: Sequence[StageReport | None], now_s: float) -> None:
    """Check that every stage holds its position, ready for a stream.

    Raises
    ------
    RunFailed
        As `check_alive`, and STAGE_FAULT for a stage that is busy.
    """
    check_alive(reports, now_s)
    for finger, report in enumerate(reports, start=1):
        if report is not None and report.mode is not Mode.HOLDING:
            raise RunFailed(
                f'finger {finger}: its stage is {report.mode.name.lower()}; allowed: holding',
                STAGE_FAULT,
            )


def finished(reports: Sequence[StageReport | None], stream: int, setpoints: int) -> bool:
    """Return whether every stage holds on target after a stream: at its end, or at a contact."""
    return all(
        report is not None
        and report.stream == stream
        and (report.received == setpoints or report.guard_tripped)
        and report.mode is Mode.HOLDING
        and report.on_target
        for report in reports
    )


def what_is_missing(reports: Sequence[StageReport | None], stream: int, setpoints: int) -> str:
    """Say which finger has not got all of a stream, or does not hold; empty: all do."""
    for finger, report in enumerate(reports, start=1):
        if report is None:
            return f'finger {finger}: nothing heard of its stage'
        complete = report.received == setpoints or report.guard_tripped
        if report.stream != stream or not complete:
            accepted = report.received if report.stream == stream else 0
            return f'finger {finger}: accepted {accepted} of {setpoints} setpoints'
        if report.mode is not Mode.HOLDING:
            return f'finger {finger}: its stage is {report.mode.name.lower()}; allowed: holding'
    return ''
