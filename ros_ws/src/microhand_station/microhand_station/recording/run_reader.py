# SPDX-License-Identifier: Apache-2.0
"""A record file, finished or not → the run as arrays, without ROS."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stderr
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from mcap.records import Channel, Footer, Message, Metadata, Schema
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from microhand_station.recording.record_scan import scan_records
from microhand_station.recording.run_writer import END_METADATA, RUN_METADATA
from microhand_station.recording.setpoint_tally import SetpointTally

_UM_PER_M = 1e6
_LIMIT = 1.0  # no stage is a metre long, no period a second
_LARGEST_ANGLE = 3.15  # rad; no two orientations are further apart
_STREAMING = 2  # StageState.STREAMING
_FINGER_TOPIC = re.compile(r'/finger_([1-3])/(setpoints|state)$')


@dataclass(frozen=True)
class TrackingError:
    """Distance between the commanded and the measured position of a stage."""

    rms_um: float
    max_um: float


@dataclass(frozen=True)
class FingerRecord:
    """What one finger was told and what it did. Times since the start of the run.

    Attributes
    ----------
    setpoint_time_s : (n,) array
        When each setpoint was due.
    setpoint_um : (n, 3) array
        Setpoints, stage frame.
    state_time_s : (m,) array
        When the stage measured.
    measured_um, commanded_um : (m, 3) array
        Measured position, and the command that held at that time, stage frame.
    streaming : (m,) array of bool
        Whether the stage followed a stream of setpoints then.
    missing, out_of_order : int
        Setpoints whose numbers were skipped; setpoints repeated or late.
    """

    setpoint_time_s: NDArray[np.float64]
    setpoint_um: NDArray[np.float64]
    state_time_s: NDArray[np.float64]
    measured_um: NDArray[np.float64]
    commanded_um: NDArray[np.float64]
    streaming: NDArray[np.bool_]
    missing: int
    out_of_order: int

    def __post_init__(self) -> None:
        for array in (value for value in vars(self).values() if isinstance(value, np.ndarray)):
            array.setflags(write=False)

    @property
    def tracking_error(self) -> TrackingError | None:
        """Over the states in which the stage followed a stream; None if there are none."""
        if not self.streaming.any():
            return None
        off_um = (self.measured_um - self.commanded_um)[self.streaming]
        distance_um = np.linalg.norm(off_um, axis=1)
        return TrackingError(float(np.sqrt(np.mean(distance_um**2))), float(distance_um.max()))


@dataclass(frozen=True)
class ObjectRecord:
    """How far the object was from where the plan had it. Times since the start of the run.

    Attributes
    ----------
    time_s : (n,) array
        Times to which the deviations refer.
    angle_deg, distance_um : (n,) array
        Turned and displaced by so much.
    """

    time_s: NDArray[np.float64]
    angle_deg: NDArray[np.float64]
    distance_um: NDArray[np.float64]

    def __post_init__(self) -> None:
        for array in vars(self).values():
            array.setflags(write=False)


@dataclass(frozen=True)
class Event:
    """Something that a node reported during the run; `time_s` since its start."""

    time_s: float
    source: str
    error_code: int
    text: str


@dataclass(frozen=True)
class Run:
    """One recorded run.

    Attributes
    ----------
    path : Path
        Of the record.
    finished : bool
        False: the recorder did not come to close the file; what is here is what could be read.
    end : str
        How the run ended, as the recorder saw it; empty: it did not get to say.
    metadata : Mapping[str, str]
        What the recorder noted at the start; the key ``metadata_json`` holds what the client gave.
    plan : Mapping or None
        Fields of ``microhand_msgs_py/msg/Plan`` as plain values, SI units; None: no plan is there.
    fingers : Mapping[int, FingerRecord]
        By finger, those that occur in the record.
    object : ObjectRecord
        How the object followed the plan; empty if nothing watched it.
    events : tuple of Event
        In the order of the record.
    counts : Mapping[str, int]
        Messages by topic; 0 for topics that stayed silent.
    undecodable : int
        Messages whose content is damaged; they are counted but not used.
    start_ns : int
        [ns] since 1970, log time of the first message.
    duration_s : float
        From the first to the last message.
    """

    path: Path
    finished: bool
    end: str
    metadata: Mapping[str, str]
    plan: Mapping[str, Any] | None
    fingers: Mapping[int, FingerRecord]
    object: ObjectRecord
    events: tuple[Event, ...]
    counts: Mapping[str, int]
    undecodable: int
    start_ns: int
    duration_s: float

    @classmethod
    def open(
        cls, path: Path, progress: Callable[[int, int], None] = lambda done, total: None
    ) -> Run:
        """Read a record, also one that a crash left unfinished.

        Parameters
        ----------
        path : Path
            The mcap file.
        progress : callable
            Called with bytes done and bytes in total.

        Raises
        ------
        BadRequest
            The file cannot be opened, is empty, or is no mcap file.
        """
        collected = _Collected()
        for record in scan_records(Path(path), progress):
            collected.add(record)
        return collected.run(Path(path))


class _Collected:
    """Records of one file, sorted by what they are about."""

    def __init__(self) -> None:
        self._factory = DecoderFactory()
        self._decoders: dict[int, Callable[[bytes], SimpleNamespace] | None] = {}
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._counts: Counter[str] = Counter()
        self._log_ns: list[int] = []
        self._undecodable = 0
        self._finished = False
        self._plan: SimpleNamespace | None = None
        self._events: list[SimpleNamespace] = []
        self._deviations: list[SimpleNamespace] = []
        self._chunks: defaultdict[int, list[SimpleNamespace]] = defaultdict(list)
        self._states: defaultdict[int, list[SimpleNamespace]] = defaultdict(list)

    def add(self, record: object) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
            self._counts.setdefault(record.topic, 0)
        elif isinstance(record, Metadata):
            self._metadata[record.name] = record.metadata
        elif isinstance(record, Message) and record.channel_id in self._channels:
            self._add_message(self._channels[record.channel_id], record)
        elif isinstance(record, Footer):
            self._finished = True

    def _add_message(self, channel: Channel, message: Message) -> None:
        self._counts[channel.topic] += 1
        self._log_ns.append(message.log_time)
        finger_topic = _FINGER_TOPIC.search(channel.topic)
        is_plan, is_event, is_deviation = (
            channel.topic.endswith(f'/{end}') for end in ('plan', 'events', 'object_deviation')
        )
        if not (finger_topic or is_plan or is_event or is_deviation):
            return
        decoded = self._decode(channel, message.data)
        if decoded is None or not _is_plausible(decoded):
            self._undecodable += 1
        elif finger_topic:
            finger, kind = finger_topic.groups()
            (self._chunks if kind == 'setpoints' else self._states)[int(finger)].append(decoded)
        elif is_event:
            self._events.append(decoded)
        elif is_deviation:
            self._deviations.append(decoded)
        else:
            self._plan = decoded

    def _decode(self, channel: Channel, data: bytes) -> SimpleNamespace | None:
        # Damaged bytes surface as whatever the decoder stumbles over.
        try:
            if channel.id not in self._decoders:
                self._decoders[channel.id] = self._decoder(channel)
            decoder = self._decoders[channel.id]
            return None if decoder is None else decoder(data)
        except Exception:
            return None

    def _decoder(self, channel: Channel) -> Callable[[bytes], SimpleNamespace] | None:
        """Make the decoder of a channel; None if its schema is missing or damaged."""
        schema = self._schemas.get(channel.schema_id)
        with redirect_stderr(StringIO()):  # the parser of schemas prints what it stumbles over
            try:
                return self._factory.decoder_for(channel.message_encoding, schema)
            except Exception:
                return None

    def run(self, path: Path) -> Run:
        start_ns, end_ns = min(self._log_ns, default=0), max(self._log_ns, default=0)
        fingers = sorted(self._chunks.keys() | self._states.keys())
        return Run(
            path=path,
            finished=self._finished,
            end=self._metadata.get(END_METADATA, {}).get('end', ''),
            metadata=self._metadata.get(RUN_METADATA, {}),
            plan=None if self._plan is None else _plain(self._plan),
            fingers={
                finger: _finger_record(self._chunks[finger], self._states[finger], start_ns)
                for finger in fingers
            },
            object=_object_record(self._deviations, start_ns),
            events=tuple(
                Event(
                    _since_s(event.header.stamp, start_ns),
                    event.source,
                    event.error_code,
                    event.text,
                )
                for event in self._events
            ),
            counts=dict(self._counts),
            undecodable=self._undecodable,
            start_ns=start_ns,
            duration_s=(end_ns - start_ns) * 1e-9,
        )


def _finger_record(
    chunks: list[SimpleNamespace], states: list[SimpleNamespace], start_ns: int
) -> FingerRecord:
    tally = SetpointTally()
    times_s, positions_m = [], []
    for chunk in chunks:
        block_m = np.asarray(chunk.positions, dtype=float).reshape(-1, 3)
        tally.add(chunk.stream, chunk.sequence, len(block_m))
        times_s.append(
            _since_s(chunk.header.stamp, start_ns) + chunk.period * np.arange(len(block_m))
        )
        positions_m.append(block_m)
    return FingerRecord(
        setpoint_time_s=np.concatenate(times_s) if times_s else np.zeros(0),
        setpoint_um=_UM_PER_M * (np.concatenate(positions_m) if times_s else np.zeros((0, 3))),
        state_time_s=np.array([_since_s(state.header.stamp, start_ns) for state in states]),
        measured_um=_points_um(state.position for state in states),
        commanded_um=_points_um(state.command for state in states),
        streaming=np.array([state.mode == _STREAMING for state in states], dtype=bool),
        missing=tally.missing,
        out_of_order=tally.out_of_order,
    )


def _object_record(deviations: list[SimpleNamespace], start_ns: int) -> ObjectRecord:
    return ObjectRecord(
        time_s=np.array([_since_s(off.header.stamp, start_ns) for off in deviations]),
        angle_deg=np.degrees([off.angle for off in deviations]),
        distance_um=_UM_PER_M * np.array([off.distance for off in deviations], dtype=float),
    )


def _is_plausible(decoded: SimpleNamespace) -> bool:
    """Whether positions, periods and deviations can be real; damaged bytes rarely are."""
    numbers = list(getattr(decoded, 'positions', ()))
    for name in ('position', 'command'):
        if hasattr(decoded, name):
            point = getattr(decoded, name)
            numbers += [point.x, point.y, point.z]
    in_threes = len(numbers) % 3 == 0
    numbers += [getattr(decoded, name, 0.0) for name in ('period', 'distance')]
    numbers.append(getattr(decoded, 'angle', 0.0) / _LARGEST_ANGLE)
    return in_threes and all(abs(x) < _LIMIT for x in numbers)


def _points_um(points: Iterable[Any]) -> NDArray[np.float64]:
    return _UM_PER_M * np.array([(p.x, p.y, p.z) for p in points], dtype=float).reshape(-1, 3)


def _since_s(stamp: SimpleNamespace, start_ns: int) -> float:
    """Seconds since the start of the run; subtracted as integers, which keeps the nanoseconds."""
    return (stamp.sec * 1_000_000_000 + stamp.nanosec - start_ns) * 1e-9


def _plain(value: Any) -> Any:
    """Turn a decoded message into dicts, lists and numbers."""
    if isinstance(value, SimpleNamespace):
        fields: list[str] = value.__slots__  # of the class that the decoder made for the type
        return {name: _plain(getattr(value, name)) for name in fields}
    if isinstance(value, str | bytes | bool | int | float):
        return value
    return [_plain(item) for item in value]
