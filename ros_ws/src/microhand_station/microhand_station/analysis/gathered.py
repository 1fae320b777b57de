# SPDX-License-Identifier: Apache-2.0
"""Records of a file, one after the other → what is in it, sorted by what it is about."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Footer, McapRecord, Message, Metadata, Schema
from numpy.typing import NDArray

from microhand_planner.core.errors import BadRequest
from microhand_planner.core.plan import Plan
from microhand_station.analysis.finger_record import FingerRecord, finger_record
from microhand_station.analysis.message_decoder import MessageDecoder
from microhand_station.analysis.object_record import (
    Deviation,
    ObjectRecord,
    deviation,
    object_record,
)
from microhand_station.analysis.record_time import Stamped, in_time, stamps_s, start_and_end_ns
from microhand_station.analysis.recorded_plan import recorded_plan
from microhand_station.recording.run_writer import (
    END_METADATA,
    PARAMETERS_METADATA,
    RUN_METADATA,
    VERSIONS_METADATA,
)

_PACKAGE = 'microhand_msgs_py/msg/'
_FINGER = re.compile(r'/finger_([1-3])/')
_OF_FINGER = ('SetpointChunk', 'StageState', 'TipContact')
_OF_RUN = ('RunEvent', 'ObjectState', 'ObjectDeviation', 'SequencerState')
_LIMIT = 1.0  # no stage is a metre long, no period a second, no force a newton
_LARGEST_ANGLE = 3.15  # rad; no two orientations are further apart
_UNIT_LENGTH = 1e-3
_TOUCHED = ('contact_position.x', 'contact_position.y', 'contact_position.z')
_STAMP = ('header.stamp.sec', 'header.stamp.nanosec')
# Fields that are used as numbers and as texts, by kind of message.
_NUMBERS = {
    'RunEvent': (*_STAMP, 'error_code'),
    'ObjectState': (*_STAMP, 'held', 'released'),
    'ObjectDeviation': (*_STAMP, 'angle', 'distance'),
    'SequencerState': (*_STAMP, 'state', 'step', 'steps', 'progress'),
    'SetpointChunk': (*_STAMP, 'stream', 'sequence', 'period'),
    'StageState': (*_STAMP, 'mode', 'stream', 'underruns', 'guard_tripped', *_TOUCHED),
    'TipContact': (*_STAMP, 'in_contact'),
}
_TEXTS = {'RunEvent': ('source', 'text'), 'ObjectState': ('lost_because',)}
_UNDER_WAY = (2, 3, 4)  # SequencerState: RUNNING, PAUSED, STOPPING


@dataclass(frozen=True)
class Event:
    """Something that a node reported during the run; `time_s` since its start."""

    time_s: float
    source: str
    error_code: int
    text: str


class Gathered:
    """What one file holds.

    Attributes
    ----------
    metadata : dict
        What the recorder noted at the start.
    parameters : dict
        Of each node, as JSON.
    versions : dict
        Of what was installed.
    end : str
        How the run ended, as the recorder saw it.
    finished : bool
        Whether the file was closed.
    attachments : list of Attachment
        Files kept in it.
    counts : Counter
        Messages by topic.
    undecodable : int
        Messages that are damaged.
    """

    def __init__(self, path: Path) -> None:
        self.metadata: dict[str, str] = {}
        self.parameters: dict[str, str] = {}
        self.versions: dict[str, str] = {}
        self.end = ''
        self.finished = False
        self.attachments: list[Attachment] = []
        self.counts: Counter[str] = Counter()
        self.undecodable = 0
        self._path = path
        self._decoder = MessageDecoder()
        self._log_ns: list[int] = []
        self._plans: list[Any] = []
        self._messages: defaultdict[tuple[str, int], list[Stamped]] = defaultdict(list)

    def add(self, record: McapRecord) -> None:
        """Take in a record."""
        if isinstance(record, Schema | Channel):
            self._decoder.announce(record)
            if isinstance(record, Channel):
                self.counts.setdefault(record.topic, 0)
        elif isinstance(record, Metadata):
            self._add_metadata(record)
        elif isinstance(record, Attachment):
            self.attachments.append(record)
        elif isinstance(record, Message):
            self._add_message(record)
        elif isinstance(record, Footer):
            self.finished = True

    def _add_metadata(self, record: Metadata) -> None:
        if record.name == RUN_METADATA:
            self.metadata = record.metadata
        elif record.name == PARAMETERS_METADATA:
            self.parameters = record.metadata
        elif record.name == VERSIONS_METADATA:
            self.versions = record.metadata
        elif record.name == END_METADATA:
            self.end = record.metadata.get('end', '')

    def _add_message(self, record: Message) -> None:
        topic = self._decoder.topic_of(record)
        if topic is None:
            return
        self.counts[topic.name] += 1
        self._log_ns.append(record.log_time)
        kind = topic.type_name.removeprefix(_PACKAGE)
        finger = _FINGER.search(topic.name)
        if kind not in (*_OF_RUN, 'Plan') and not (finger and kind in _OF_FINGER):
            return
        message = self._decoder.decode(record)
        if message is None or not _is_plausible(kind, message):
            self.undecodable += 1
        elif kind == 'Plan':
            self._plans.append(message)
        else:
            number = int(finger.group(1)) if finger and kind in _OF_FINGER else 0
            self._messages[kind, number].append(Stamped(record.log_time, message))

    def check(self) -> None:
        """Check that this is a record of a run.

        Raises
        ------
        BadRequest
            No topic of it is one of microhand.
        """
        topics = self._decoder.topics.values()
        if not any(topic.type_name.startswith(_PACKAGE) for topic in topics):
            none = f'this one has {len(topics)} topics, none of microhand'
            raise BadRequest('record', self._path, f'the record of a run; {none}')

    def span_ns(self) -> tuple[int, int]:
        """Return the first and the last log time [ns]; 0, 0: there is no message."""
        return start_and_end_ns(self._log_ns)

    def plan(self) -> tuple[Plan | None, str]:
        """Return the last plan, or None and a sentence that says why there is none."""
        if not self._plans:
            return None, 'No plan is in the record.'
        try:
            return recorded_plan(self._plans[-1]), ''
        # A damaged plan fails in as many ways as it has fields.
        except Exception as error:
            return None, f'The plan in the record cannot be used: {error}.'

    def fingers(self, start_ns: int) -> dict[int, FingerRecord]:
        """Return the records of the fingers of which there is anything."""
        found = sorted({finger for _, finger in self._messages if finger})
        return {
            finger: finger_record(
                self._messages.get(('SetpointChunk', finger), []),
                self._messages.get(('StageState', finger), []),
                self._messages.get(('TipContact', finger), []),
                start_ns,
            )
            for finger in found
        }

    def object(self, start_ns: int) -> ObjectRecord:
        """Return the record of the object."""
        return object_record(self._messages.get(('ObjectState', 0), []), start_ns)

    def deviation(self, start_ns: int) -> Deviation:
        """Return how far the object was from its plan, as published."""
        return deviation(self._messages.get(('ObjectDeviation', 0), []), start_ns)

    def events(self, start_ns: int) -> tuple[Event, ...]:
        """Return the events, in file order."""
        kept = in_time(self._messages.get(('RunEvent', 0), []))
        return tuple(
            Event(float(when), one.message.source, one.message.error_code, one.message.text)
            for when, one in zip(stamps_s(kept, start_ns), kept, strict=True)
        )

    def told(self, start_ns: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return when the sequencer said in which step it was (m,) [s], and that step (m,)."""
        kept = [one for one in self._sequencer() if one.message.state in _UNDER_WAY]
        steps = np.array([one.message.step for one in kept], dtype=np.int64)
        return stamps_s(kept, start_ns), np.maximum.accumulate(steps)

    @property
    def share(self) -> float:
        """Largest share of the planned time that the sequencer reported."""
        kept = [one.message for one in self._sequencer() if one.message.state in _UNDER_WAY]
        return max((float(message.progress) for message in kept), default=0.0)

    def _sequencer(self) -> list[Stamped]:
        return in_time(self._messages.get(('SequencerState', 0), []))


def _is_plausible(kind: str, message: Any) -> bool:
    """Whether a message can be real; damaged bytes, also those of definitions, rarely make one."""
    try:
        numbers = attrgetter(*_NUMBERS[kind])(message) if kind in _NUMBERS else ()
        texts = [getattr(message, name) for name in _TEXTS.get(kind, ())]
        return (
            all(isinstance(value, int | float) for value in numbers)
            and all(isinstance(value, str) for value in texts)
            and _in_range(kind, message)
        )
    # a damaged definition renames fields or changes their types
    except (AttributeError, TypeError, ValueError):
        return False


def _in_range(kind: str, message: Any) -> bool:
    """Whether the numbers of a message are within what is possible."""
    if kind == 'StageState':
        return _small(message.position) and _small(message.command)
    if kind == 'SetpointChunk':
        values = np.asarray(message.positions, dtype=float)
        sound = values.size % 3 == 0 and bool(np.all(np.abs(values) < _LIMIT))
        return sound and 0.0 < message.period < _LIMIT
    if kind == 'ObjectDeviation':
        return abs(message.angle) <= _LARGEST_ANGLE and abs(message.distance) < _LIMIT
    if kind == 'ObjectState':
        q = message.pose.orientation
        turned = abs(math.hypot(q.w, q.x, q.y, q.z) - 1.0) < _UNIT_LENGTH
        return turned and _small(message.pose.position) and _sound_contacts(message.contacts)
    if kind == 'SequencerState':
        return 0.0 <= message.progress <= 1.0 and message.step <= max(message.steps, 1)
    return True


def _sound_contacts(contacts: Any) -> bool:
    for contact in contacts:
        p = contact.position
        values = (contact.normal_force, contact.friction_use, contact.in_contact, p.x, p.y, p.z)
        if not _small(contact.force) or not all(isinstance(x, int | float) for x in values):
            return False
        # NaN where a finger does not touch
        if any(abs(value) >= _LIMIT for value in (contact.normal_force, p.x, p.y, p.z)):
            return False
        if contact.finger not in (1, 2, 3):
            return False
    return True


def _small(vector: Any) -> bool:
    return all(abs(value) < _LIMIT for value in (vector.x, vector.y, vector.z))
