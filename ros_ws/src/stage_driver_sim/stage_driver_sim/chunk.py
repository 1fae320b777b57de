# SPDX-License-Identifier: Apache-2.0
"""Setpoints as they arrive: the content of ``SetpointChunk.msg`` in µm and s, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stage_driver_sim.errors import InvalidNumber, InvalidParameter
from stage_driver_sim.protocol import AXES

MIN_PERIOD_S = 1e-5
MAX_PERIOD_S = 10.0


@dataclass(frozen=True, eq=False)
class Chunk:
    """Successive setpoints of one stream.

    Parameters
    ----------
    time_s : float
        Time of the first setpoint [s], on the driver's clock.
    period_s : float
        Time between two setpoints [s], `MIN_PERIOD_S` to `MAX_PERIOD_S`.
    positions_um : (n, 3) ndarray
        Positions [µm], stage frame, n >= 1.
    velocities_um_s : (n, 3) ndarray or None
        Velocities [µm/s]; None: the stream takes difference quotients.
    sequence : int
        Number of the first setpoint in the stream, from 0.
    stream : int
        Number of the stream.
    last : bool
        True: the stream ends with this chunk.
    guarded : bool
        True: the stream ends as soon as the tip touches something.

    Raises
    ------
    InvalidNumber
        NaN or infinity anywhere.
    InvalidParameter
        Wrong shape, no setpoint, or a period outside its range.
    """

    time_s: float
    period_s: float
    positions_um: NDArray[np.float64]
    velocities_um_s: NDArray[np.float64] | None
    sequence: int
    stream: int
    last: bool
    guarded: bool = False

    def __post_init__(self) -> None:
        """Check and freeze."""
        for field in ('time_s', 'period_s'):
            if not math.isfinite(getattr(self, field)):
                raise InvalidNumber(f'{field} is {getattr(self, field)}; allowed: a finite number')
        if not MIN_PERIOD_S <= self.period_s <= MAX_PERIOD_S:
            raise InvalidParameter(
                f'period is {self.period_s:g} s; allowed: {MIN_PERIOD_S:g} to {MAX_PERIOD_S:g} s'
            )
        object.__setattr__(self, 'positions_um', _rows('positions', self.positions_um))
        if self.velocities_um_s is not None:
            rows = _rows('velocities', self.velocities_um_s)
            if len(rows) != len(self.positions_um):
                raise InvalidParameter(
                    f'{len(rows)} velocities for {len(self.positions_um)} positions; '
                    'allowed: one each, or none'
                )
            object.__setattr__(self, 'velocities_um_s', rows)

    def times_s(self) -> NDArray[np.float64]:
        """Return the times of the setpoints [s], shape (n,)."""
        return self.time_s + self.period_s * np.arange(len(self.positions_um), dtype=np.float64)

    def same_as(self, other: Chunk) -> bool:
        """Return whether `other` is a copy: equal in every field."""
        # almost all chunks differ in their numbers: arrays are compared only if they may be equal
        return (
            (self.stream, self.sequence) == (other.stream, other.sequence)
            and (self.time_s, self.period_s) == (other.time_s, other.period_s)
            and (self.last, self.guarded) == (other.last, other.guarded)
            and np.array_equal(self.positions_um, other.positions_um)
            and _same_rows(self.velocities_um_s, other.velocities_um_s)
        )


def _same_rows(one: NDArray[np.float64] | None, other: NDArray[np.float64] | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)


def _rows(field: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
    rows = np.array(values, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) == 0:
        raise InvalidParameter(f'{field} have the shape {rows.shape}; allowed: n x 3, n >= 1')
    if not np.isfinite(rows).all():
        row, column = np.argwhere(~np.isfinite(rows))[0]
        raise InvalidNumber(
            f'{AXES[column]}: {field} {row} is {rows[row, column]}; allowed: a finite number'
        )
    rows.setflags(write=False)
    return rows
