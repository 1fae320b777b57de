# SPDX-License-Identifier: Apache-2.0
"""Setpoints, states and contacts of one finger → what it was told and what it did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microhand_station.analysis.record_time import Stamped, in_time, stamps_s
from microhand_station.analysis.table import Table, spread
from microhand_station.recording.setpoint_tally import SetpointTally

FloatArray = NDArray[np.float64]

_UM_PER_M = 1e6
_STREAMING = 2  # StageState.STREAMING


@dataclass(frozen=True)
class TrackingError:
    """Distance between the commanded and the measured position of a stage.

    Attributes
    ----------
    rms_um, max_um : float
        Over the states in which the stage followed a stream.
    max_at_s : float
        When it was largest.
    """

    rms_um: float
    max_um: float
    max_at_s: float


@dataclass(frozen=True)
class FingerRecord:
    """What one finger was told and what it did. Times since the start of the run.

    Attributes
    ----------
    setpoint_time_s : (n,) array
        When each setpoint was due.
    setpoint_um : (n, 3) array
        Setpoints, stage frame.
    setpoint_stream : (n,) array of int
        Stream that each setpoint belongs to.
    state_time_s : (m,) array
        When the stage measured.
    measured_um, commanded_um : (m, 3) array
        Measured position, and the command that held at that time, stage frame.
    streaming : (m,) array of bool
        Whether the stage followed a stream of setpoints then.
    touched_time_s : (k,) array
        When guarded streams ended at a contact, as the states report it.
    touched_um : (k, 3) array
        Where the stage was at those contacts, stage frame.
    contact_time_s : (c,) array
        Times of the contact reports.
    in_contact : (c,) array of bool
        What they said.
    missing, out_of_order : int
        Setpoints whose numbers were skipped; setpoints repeated or late.
    underruns : int
        Times that a stream ran dry during the run.
    """

    setpoint_time_s: FloatArray
    setpoint_um: FloatArray
    setpoint_stream: NDArray[np.int64]
    state_time_s: FloatArray
    measured_um: FloatArray
    commanded_um: FloatArray
    streaming: NDArray[np.bool_]
    touched_time_s: FloatArray
    touched_um: FloatArray
    contact_time_s: FloatArray
    in_contact: NDArray[np.bool_]
    missing: int
    out_of_order: int
    underruns: int

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def off_um(self) -> FloatArray:
        """Distance between command and measured position in each state, (m,) [µm]."""
        return np.linalg.norm(self.measured_um - self.commanded_um, axis=1)

    @property
    def tracking_error(self) -> TrackingError | None:
        """Over the states in which the stage followed a stream; None if there are none."""
        if not self.streaming.any():
            return None
        off_um, time_s = self.off_um[self.streaming], self.state_time_s[self.streaming]
        worst = int(np.argmax(off_um))
        return TrackingError(
            float(np.sqrt(np.mean(off_um**2))), float(off_um[worst]), float(time_s[worst])
        )

    @property
    def states(self) -> Table:
        """The states as a table; positions in the stage frame."""
        return Table(
            {
                'time_s': self.state_time_s,
                **spread('commanded', 'um', self.commanded_um),
                **spread('measured', 'um', self.measured_um),
                'off_um': self.off_um,
                'streaming': self.streaming,
            }
        )

    @property
    def setpoints(self) -> Table:
        """The setpoints as a table; positions in the stage frame."""
        return Table(
            {
                'time_s': self.setpoint_time_s,
                'stream': self.setpoint_stream,
                **spread('position', 'um', self.setpoint_um),
            }
        )


def finger_record(
    chunks: Sequence[Stamped],
    states: Sequence[Stamped],
    contacts: Sequence[Stamped],
    start_ns: int,
) -> FingerRecord:
    """Gather the messages of one finger; see `FingerRecord`.

    Parameters
    ----------
    chunks, states, contacts : sequence of Stamped
        Decoded SetpointChunk, StageState and TipContact messages, in file order.
    start_ns : int
        Start of the run [ns since 1970].
    """
    chunks, states, contacts = in_time(chunks), in_time(states), in_time(contacts)
    tally = SetpointTally()
    times_s: list[FloatArray] = [np.zeros(0)]
    positions_um: list[FloatArray] = [np.zeros((0, 3))]
    streams: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    for begin_s, chunk in zip(stamps_s(chunks, start_ns), chunks, strict=True):
        block_um = _UM_PER_M * np.asarray(chunk.message.positions, dtype=float).reshape(-1, 3)
        tally.add(chunk.message.stream, chunk.message.sequence, len(block_um))
        times_s.append(begin_s + chunk.message.period * np.arange(len(block_um)))
        positions_um.append(block_um)
        streams.append(np.full(len(block_um), chunk.message.stream, dtype=np.int64))
    state_time_s = stamps_s(states, start_ns)
    touched = _touched(states)
    return FingerRecord(
        setpoint_time_s=np.concatenate(times_s),
        setpoint_um=np.concatenate(positions_um),
        setpoint_stream=np.concatenate(streams),
        state_time_s=state_time_s,
        measured_um=_points_um([state.message.position for state in states]),
        commanded_um=_points_um([state.message.command for state in states]),
        streaming=np.array([s.message.mode == _STREAMING for s in states], dtype=bool),
        touched_time_s=state_time_s[touched],
        touched_um=_points_um([states[i].message.contact_position for i in touched]),
        contact_time_s=stamps_s(contacts, start_ns),
        in_contact=np.array([contact.message.in_contact for contact in contacts], dtype=bool),
        missing=tally.missing,
        out_of_order=tally.out_of_order,
        underruns=states[-1].message.underruns - states[0].message.underruns if states else 0,
    )


def _touched(states: Sequence[Stamped]) -> list[int]:
    """Return the states that are the first to report the contact that ended a guarded stream."""
    found, was = [], None
    for number, state in enumerate(states):
        tripped = state.message.guard_tripped
        stream = state.message.stream if tripped else None
        if tripped and stream != was and np.isfinite(state.message.contact_position.x):
            found.append(number)
        was = stream
    return found


def _points_um(points: Sequence[Any]) -> FloatArray:
    """Return points [m] as (n, 3) µm."""
    return _UM_PER_M * np.array([(p.x, p.y, p.z) for p in points], dtype=float).reshape(-1, 3)
