# SPDX-License-Identifier: Apache-2.0
"""An mcap file → which topics it has, how many messages of each, from when to when."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, Message, Schema

from microhand_planner.core.errors import BadRequest
from microhand_station.analysis.message_decoder import MessageDecoder, RecordedTopic
from microhand_station.analysis.record_time import start_and_end_ns
from microhand_station.recording.record_scan import scan_records


@dataclass(frozen=True)
class RecordIndex:
    """What a record holds.

    Attributes
    ----------
    topics : Mapping[str, RecordedTopic]
        By name, in the order in which they are announced.
    counts : Mapping[str, int]
        Messages by topic.
    start_ns, end_ns : int
        First and last log time [ns since 1970]; 0: there is no message.
    """

    topics: Mapping[str, RecordedTopic]
    counts: Mapping[str, int]
    start_ns: int
    end_ns: int

    @property
    def duration_s(self) -> float:
        """From the first message to the last [s]."""
        return (self.end_ns - self.start_ns) * 1e-9

    def chosen(self, names: Collection[str]) -> dict[str, RecordedTopic]:
        """Return the topics of these names, with or without the leading slash; none: all.

        Raises
        ------
        BadRequest
            A name that is not there.
        """
        if not names:
            return dict(self.topics)
        full = [name if name.startswith('/') else f'/{name}' for name in names]
        for name in full:
            if name not in self.topics:
                known = ', '.join(sorted(self.topics)) or 'none: the record has no topics'
                raise BadRequest('topic', name, known)
        return {name: topic for name, topic in self.topics.items() if name in full}


def record_index(
    path: Path, progress: Callable[[int, int], None] = lambda done, total: None
) -> RecordIndex:
    """Read through a record once, without decoding its messages.

    Parameters
    ----------
    path : Path
        The mcap file.
    progress : callable
        Called with bytes done and bytes in total.

    Raises
    ------
    BadRequest
        The file cannot be opened, is empty, is no mcap file, or has no topics.
    """
    decoder, counts, log_ns = MessageDecoder(), Counter[str](), []
    for record in scan_records(path, progress):
        if isinstance(record, Schema | Channel):
            decoder.announce(record)
        elif isinstance(record, Message) and (topic := decoder.topic_of(record)) is not None:
            counts[topic.name] += 1
            log_ns.append(record.log_time)
    if not decoder.topics:
        raise BadRequest('record', path, 'the record of a run; this one has no topics')
    start_ns, end_ns = start_and_end_ns(log_ns)
    return RecordIndex(decoder.topics, counts, start_ns, end_ns)
