# SPDX-License-Identifier: Apache-2.0
"""A record that a crash left unfinished → a well-formed, indexed one with all that is readable."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mcap.records import Attachment, Channel, Footer, Header, Message, Metadata, Schema
from mcap.writer import Writer

from microhand_planner.core.errors import BadRequest
from microhand_station.recording.record_scan import scan_records
from microhand_station.recording.run_writer import CHUNK_BYTES


def recover(
    broken_path: Path,
    out_path: Path,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Copy what is readable of a record into a new mcap file: chunked, compressed, indexed.

    Parameters
    ----------
    broken_path : Path
        The record; only read. A whole one is copied whole.
    out_path : Path
        The new file; must not exist.
    progress : callable
        Called with bytes done and bytes in total.

    Returns
    -------
    int
        Messages in the new file.

    Raises
    ------
    BadRequest
        `broken_path` is unreadable, empty or no mcap file; `out_path` exists or cannot be written.
    """
    records = scan_records(Path(broken_path), progress)
    first = next(records, None)
    try:
        stream = Path(out_path).open('xb')
    except OSError as error:
        allowed = f'a new file in a folder that can be written ({error.strerror})'
        raise BadRequest('output', out_path, allowed) from error
    try:
        with stream:
            writer = Writer(stream, CHUNK_BYTES)
            # A header that cannot be read leaves the profile that the recorder writes.
            profile = first.profile if isinstance(first, Header) else 'ros2'
            writer.start(profile=profile, library='microhand recover')
            copy = _Copy(writer)
            copy.add(first)
            for record in records:
                if isinstance(record, Footer):
                    break
                copy.add(record)
            writer.finish()
    except OSError as error:
        Path(out_path).unlink()
        allowed = f'a place with room for the copy ({error.strerror})'
        raise BadRequest('output', out_path, allowed) from error
    return copy.messages


class _Copy:
    """Copies records, with new numbers for schemas and channels."""

    def __init__(self, writer: Writer) -> None:
        self.messages = 0
        self._writer = writer
        self._schemas = {0: 0}
        self._channels: dict[int, int] = {}

    def add(self, record: object) -> None:
        writer = self._writer
        if isinstance(record, Schema) and record.id not in self._schemas:
            self._schemas[record.id] = writer.register_schema(
                record.name, record.encoding, record.data
            )
        elif isinstance(record, Channel) and record.id not in self._channels:
            # Without its schema a channel cannot be decoded, but its bytes may still be of use.
            self._channels[record.id] = writer.register_channel(
                record.topic,
                record.message_encoding,
                self._schemas.get(record.schema_id, 0),
                record.metadata,
            )
        elif isinstance(record, Message) and record.channel_id in self._channels:
            writer.add_message(
                self._channels[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )
            self.messages += 1
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
