# SPDX-License-Identifier: Apache-2.0
"""An mcap file, whole or broken → its records, as far as they can be read.

The readers of the mcap library need the end of the file, which a crash never wrote, and take a
message cut short at the end for a whole one. This scan goes from the start, record by record, and
believes a record only when all its bytes are there and another record, or the end, follows it.
Where that is not so it looks for the next place from which the file makes sense again: a damaged
length costs the records that it hides, not the rest of the run.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Header, McapRecord, Message, Metadata
from mcap.records import Schema as SchemaRecord
from mcap.stream_reader import breakup_chunk

from microhand_planner.core.errors import BadRequest

MAGIC = b'\x89MCAP0\r\n'
_FRAME = struct.Struct('<BQ')
_FOOTER_BYTES = _FRAME.size + 20
_LAST_OPCODE = int(Opcode.DATA_END)
# Where a record may begin: a known opcode, and a length below 4 GiB.
_LOOKS_LIKE_A_FRAME = re.compile(rb'[\x01-\x0f](?=.{4}\x00{4})', re.DOTALL)
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

    Chunks are opened. Stops where the file is cut; passes over records that are damaged;
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
        stream = path.open('rb')
    except OSError as error:
        raise BadRequest('record', path, f'a file that can be read ({error.strerror})') from error
    with stream:
        magic = stream.read(len(MAGIC))
        if magic != MAGIC:
            what = 'this one is empty' if not magic else 'this one starts otherwise'
            raise BadRequest('record', path, f'an mcap file; {what}')
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            total = len(data)
            for number, (opcode, body, end) in enumerate(_frames(data)):
                yield from _parse(opcode, body)
                if number == 0:
                    yield from _summary(data)
                progress(end, total)
                if opcode == Opcode.FOOTER:
                    return


def _summary(data: mmap.mmap) -> Iterator[McapRecord]:
    """Schemas and channels that a finished file repeats at its end.

    They come early: a packed file has them in its first chunk, too, and a damaged first chunk
    would leave every message behind it without a meaning. A damaged summary is left out.
    """
    begin = len(data) - len(MAGIC) - _FOOTER_BYTES
    end = _end_of_frame(data, begin) if begin > len(MAGIC) else None
    if end is None or data[begin] != Opcode.FOOTER:
        return
    footer = Footer.read(ReadDataStream(BytesIO(data[begin + _FRAME.size : end])))
    at = footer.summary_start
    if not len(MAGIC) < at < begin or zlib.crc32(data[at : end - 4]) != footer.summary_crc:
        return
    while at < begin:
        end = _end_of_frame(data, at)
        if end is None or data[at] not in (Opcode.SCHEMA, Opcode.CHANNEL):
            return
        yield from _parse(data[at], data[at + _FRAME.size : end])
        at = end


def _frames(data: mmap.mmap) -> Iterator[tuple[int, bytes, int]]:
    """Opcode, content and end of each record that lies whole in the file."""
    at = len(MAGIC)
    while at + _FRAME.size <= len(data):
        end = _end_of_frame(data, at)
        if end is None or not _goes_on(data, end):
            following = _next_frame(data, at + 1)
            if following is not None:
                at = following
                continue
            if end is None:
                return
            # nothing later makes sense: this is the last whole record before the cut
        yield data[at], data[at + _FRAME.size : end], end
        at = end


def _end_of_frame(data: mmap.mmap, at: int) -> int | None:
    """Return where the record that begins at `at` ends; None: none that lies in the file."""
    if at + _FRAME.size > len(data):
        return None
    opcode, length = _FRAME.unpack_from(data, at)
    # No record has opcode 0: a tail of zeros is what a power cut leaves.
    if not 0 < opcode <= _LAST_OPCODE or length > len(data) - at - _FRAME.size:
        return None
    return at + _FRAME.size + int(length)


def _goes_on(data: mmap.mmap, at: int) -> bool:
    """Return whether at `at` the file ends, is cut in the next record, or has a whole one."""
    if len(data) - at < _FRAME.size or data[at : at + len(MAGIC)] == MAGIC:
        return True
    opcode, length = _FRAME.unpack_from(data, at)
    return 0 < opcode <= _LAST_OPCODE and length < 1 << 32


def _next_frame(data: mmap.mmap, start: int) -> int | None:
    """Return where from `start` on two records in a row lie whole in the file; None: nowhere."""
    for found in _LOOKS_LIKE_A_FRAME.finditer(data, start):
        end = _end_of_frame(data, found.start())
        if end is None:
            continue
        after = _end_of_frame(data, end)
        if after is not None and _goes_on(data, after):
            return found.start()
    return None


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
