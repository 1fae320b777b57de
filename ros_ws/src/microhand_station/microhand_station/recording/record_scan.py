# SPDX-License-Identifier: Apache-2.0
"""An mcap file, whole or broken → its records, as far as they can be read.

The readers of the mcap library need the end of the file, which a crash never wrote, and take a
message cut short at the end for a whole one. This scan goes from the start, record by record, and
believes a record only when all its bytes are there.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Header, McapRecord, Message, Metadata
from mcap.records import Schema as SchemaRecord
from mcap.stream_reader import breakup_chunk

from microhand_planner.core.errors import BadRequest

MAGIC = b'\x89MCAP0\r\n'
_FRAME = struct.Struct('<BQ')
_PARSERS: dict[int, Callable[[bytes], McapRecord]] = {
    Opcode.HEADER: lambda body: Header.read(ReadDataStream(BytesIO(body))),
    Opcode.SCHEMA: lambda body: SchemaRecord.read(ReadDataStream(BytesIO(body))),
    Opcode.CHANNEL: lambda body: Channel.read(ReadDataStream(BytesIO(body))),
    Opcode.MESSAGE: lambda body: Message.read(ReadDataStream(BytesIO(body)), len(body)),
    Opcode.CHUNK: lambda body: Chunk.read(ReadDataStream(BytesIO(body))),
    Opcode.ATTACHMENT: lambda body: Attachment.read(ReadDataStream(BytesIO(body))),
    Opcode.METADATA: lambda body: Metadata.read(ReadDataStream(BytesIO(body))),
    Opcode.FOOTER: lambda body: Footer.read(ReadDataStream(BytesIO(body))),
}


def scan_records(
    path: Path, progress: Callable[[int, int], None] = lambda done, total: None
) -> Iterator[McapRecord]:
    """Yield the records of an mcap file in file order: header, schemas, channels, messages, ...

    Chunks are opened. Stops where the file is cut; passes over records whose content is damaged;
    a `Footer` is the last record of a finished file.

    Parameters
    ----------
    path : Path
        The file; only read.
    progress : callable
        Called with bytes done and bytes in total, after each record.

    Raises
    ------
    BadRequest
        The file cannot be opened, is empty, or is no mcap file.
    """
    try:
        total = path.stat().st_size
        stream = path.open('rb')
    except OSError as error:
        raise BadRequest('record', path, f'a file that can be read ({error.strerror})') from error
    with stream:
        magic = stream.read(len(MAGIC))
        if magic != MAGIC:
            what = 'this one is empty' if not magic else 'this one starts otherwise'
            raise BadRequest('record', path, f'an mcap file; {what}')
        for opcode, body in _frames(stream, total):
            yield from _parse(opcode, body)
            progress(stream.tell(), total)
            if opcode == Opcode.FOOTER:
                return


def _frames(stream: BinaryIO, total: int) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each record that lies whole in the file."""
    while len(frame := stream.read(_FRAME.size)) == _FRAME.size:
        opcode, length = _FRAME.unpack(frame)
        # No record has opcode 0: a tail of zeros is what a power cut leaves.
        if opcode == 0 or length > total - stream.tell():
            return
        yield opcode, stream.read(length)


def _parse(opcode: int, body: bytes) -> list[McapRecord]:
    """Return the records in a frame: several for a chunk, none for damage and for indices."""
    if opcode not in _PARSERS:
        return []
    # Damaged bytes surface as any of the errors of struct, utf-8, zstandard, lz4 or the mcap
    # library, which share no class below Exception.
    try:
        record = _PARSERS[opcode](body)
        if isinstance(record, Chunk):
            return breakup_chunk(record, validate_crc=True)
    except Exception:
        return []
    return [record]
