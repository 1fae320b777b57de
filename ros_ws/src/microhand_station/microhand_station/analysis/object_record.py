# SPDX-License-Identifier: Apache-2.0
"""States of the object → where it was, whether it was held, and with which forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.plan import FINGERS
from microhand_station.analysis.record_time import Stamped, in_time, stamps_s
from microhand_station.analysis.table import Table, spread

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_UM_PER_M = 1e6
_UN_PER_N = 1e6


@dataclass(frozen=True)
class ObjectRecord:
    """What the twin or a sensor reported of the object. Times since the start of the run.

    Attributes
    ----------
    time_s : (n,) array
        Times to which the reports refer.
    position_um : (n, 3) array
        Origin of the object, station frame.
    quaternion_wxyz : (n, 4) array
        Orientation, station frame.
    held, released : (n,) array of bool
        Not lost so far; no longer fixed where it was put.
    lost_because : str
        The first reason given; empty: never lost.
    touching : (n, 3) array of bool
        Fingers 1, 2, 3 touch.
    contact_um : (n, 3, 3) array
        Where they touch, station frame; NaN: not, or unknown.
    force_uN : (n, 3, 3) array
        Force of each finger on the object, station frame; NaN: unknown.
    normal_uN, friction_use : (n, 3) array
        Normal force; share of the friction in use, 1 slips; NaN: no contact, or unknown.
    """

    time_s: FloatArray
    position_um: FloatArray
    quaternion_wxyz: FloatArray
    held: BoolArray
    released: BoolArray
    lost_because: str
    touching: BoolArray
    contact_um: FloatArray
    force_uN: FloatArray
    normal_uN: FloatArray
    friction_use: FloatArray

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of reports."""
        return len(self.time_s)

    @property
    def lost_at_s(self) -> float | None:
        """When it was first reported lost; None: never."""
        lost = np.flatnonzero(~self.held)
        return float(self.time_s[lost[0]]) if len(lost) else None

    @property
    def table(self) -> Table:
        """The reports as a table; station frame."""
        columns = {
            'time_s': self.time_s,
            **spread('position', 'um', self.position_um),
            **{f'quaternion_{q}': self.quaternion_wxyz[:, k] for k, q in enumerate('wxyz')},
            'held': self.held,
            'released': self.released,
        }
        for finger in range(FINGERS):
            name = f'finger_{finger + 1}'
            columns[f'{name}_touching'] = self.touching[:, finger]
            columns |= spread(f'{name}_contact', 'um', self.contact_um[:, finger])
            columns |= spread(f'{name}_force', 'uN', self.force_uN[:, finger])
            columns[f'{name}_normal_uN'] = self.normal_uN[:, finger]
            columns[f'{name}_friction_use'] = self.friction_use[:, finger]
        return Table(columns)


@dataclass(frozen=True)
class Deviation:
    """How far the object was from where the plan had it. Times since the start of the run.

    Attributes
    ----------
    time_s : (n,) array
        Times to which the values refer.
    angle_deg, distance_um : (n,) array
        Turned and displaced by so much.
    source : str
        'sequencer': published during the run; 'commands': worked out afterwards from the plan and
        the commands of the stages; empty: unknown.
    """

    time_s: FloatArray
    angle_deg: FloatArray
    distance_um: FloatArray
    source: str = ''

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for value in (self.time_s, self.angle_deg, self.distance_um):
            value.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of values."""
        return len(self.time_s)

    @property
    def table(self) -> Table:
        """The values as a table."""
        return Table(
            {
                'time_s': self.time_s,
                'angle_deg': self.angle_deg,
                'distance_um': self.distance_um,
            }
        )


def object_record(states: Sequence[Stamped], start_ns: int) -> ObjectRecord:
    """Gather the decoded ObjectState messages of a run; see `ObjectRecord`."""
    states = in_time(states)
    messages = [state.message for state in states]
    contacts = [_by_finger(message.contacts) for message in messages]
    poses = [message.pose for message in messages]
    return ObjectRecord(
        time_s=stamps_s(states, start_ns),
        position_um=_UM_PER_M * _vectors([pose.position for pose in poses]),
        quaternion_wxyz=np.array(
            [(q.w, q.x, q.y, q.z) for q in (pose.orientation for pose in poses)], dtype=float
        ).reshape(-1, 4),
        held=np.array([message.held for message in messages], dtype=bool),
        released=np.array([message.released for message in messages], dtype=bool),
        lost_because=next((m.lost_because for m in messages if not m.held), ''),
        touching=np.array(
            [[bool(one and one.in_contact) for one in row] for row in contacts], dtype=bool
        ).reshape(-1, FINGERS),
        contact_um=_UM_PER_M * _of_fingers(contacts, 'position'),
        force_uN=_UN_PER_N * _of_fingers(contacts, 'force'),
        normal_uN=_UN_PER_N * _numbers(contacts, 'normal_force'),
        friction_use=_numbers(contacts, 'friction_use'),
    )


def deviation(messages: Sequence[Stamped], start_ns: int) -> Deviation:
    """Gather the decoded ObjectDeviation messages of a run; see `Deviation`."""
    kept = in_time(messages)
    return Deviation(
        time_s=stamps_s(kept, start_ns),
        angle_deg=np.degrees([one.message.angle for one in kept]).reshape(-1),
        distance_um=_UM_PER_M * np.array([one.message.distance for one in kept], dtype=float),
        source='sequencer' if kept else '',
    )


def _by_finger(contacts: Sequence[Any]) -> list[Any]:
    """Return the contacts of fingers 1, 2, 3; None where there is none."""
    found = {contact.finger: contact for contact in contacts}
    return [found.get(finger) for finger in range(1, FINGERS + 1)]


def _vectors(points: Sequence[Any]) -> FloatArray:
    return np.array([(p.x, p.y, p.z) for p in points], dtype=float).reshape(-1, 3)


def _of_fingers(contacts: Sequence[Sequence[Any]], field: str) -> FloatArray:
    unknown = (np.nan,) * 3
    rows = [
        [unknown if one is None else _xyz(getattr(one, field)) for one in row] for row in contacts
    ]
    return np.array(rows, dtype=float).reshape(-1, FINGERS, 3)


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _numbers(contacts: Sequence[Sequence[Any]], field: str) -> FloatArray:
    rows = [[np.nan if one is None else getattr(one, field) for one in row] for row in contacts]
    return np.array(rows, dtype=float).reshape(-1, FINGERS)
