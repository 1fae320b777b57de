# SPDX-License-Identifier: Apache-2.0
"""Messages as they arrive → an mcap file that survives a crash of the recorder, or a small one.

While a run lasts its file has no chunks and every message is handed to the operating system at
once: a killed recorder loses the message it was writing, no more, and ``recover`` reads the rest.
A chunked writer would keep up to 1 MiB in memory, which is a minute of a slow run.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from typing import BinaryIO

from mcap.writer import Writer

RUN_METADATA = 'microhand_run'
END_METADATA = 'microhand_end'


PARAMETERS_METADATA = 'microhand_parameters'
VERSIONS_METADATA = 'microhand_versions'
CHUNK_BYTES = 1 << 18
"""Of packed files: a damaged chunk costs all that is in it."""


class RunWriter:
    """Writer of one run: profile ``ros2``, CDR messages, ``ros2msg`` schemas.

    Every method raises OSError when the disk refuses; the writer is then of no further use except
    for `abandon`, and what was written before stays readable.

    Parameters
    ----------
    stream : BinaryIO
        Where to write; owned and closed by the writer.
    metadata : Mapping[str, str]
        Kept as the metadata record ``microhand_run``.
    packed : bool
        Whether to compress, in chunks: smaller, but what is not yet in a chunk dies with the
        process.

    Attributes
    ----------
    stream : BinaryIO
        As above.
    counts : dict of str to int
        Messages written, by topic.
    start_ns, end_ns : int
        First and last log time [ns since 1970]; 0: no message yet.
    """

    def __init__(
        self, stream: BinaryIO, metadata: Mapping[str, str], *, packed: bool = False
    ) -> None:
        self.counts: dict[str, int] = {}
        self.start_ns = self.end_ns = 0
        self.stream = stream
        self._packed = packed
        self._writer = Writer(stream, CHUNK_BYTES, use_chunking=packed)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._writer.start(profile='ros2', library='microhand')
        self.note(RUN_METADATA, metadata)

    @property
    def messages(self) -> int:
        """Messages written."""
        return sum(self.counts.values())

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Keep a metadata record."""
        self._writer.add_metadata(name, dict(values))
        self._hand_over()

    def add_topic(
        self, topic: str, type_name: str, schema: str, offered_qos: str, type_hash: str = ''
    ) -> None:
        """Announce a topic.

        Parameters
        ----------
        topic : str
            Full name, with namespace.
        type_name : str
            ``package/msg/Type``.
        schema : str
            Of `ros2msg_schema`.
        offered_qos : str
            QoS of the publishers, in the YAML of rosbag2.
        type_hash : str
            Of the type, as ROS computes it; empty: unknown.
        """
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(
                type_name, 'ros2msg', schema.encode()
            )
        details = {'offered_qos_profiles': offered_qos, 'topic_type_hash': type_hash}
        self._channels[topic] = self._writer.register_channel(
            topic, 'cdr', self._schemas[type_name], details
        )
        self.counts[topic] = 0
        self._hand_over()

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Keep a whole file, such as the mesh of the object, in the record."""
        self._writer.add_attachment(time_ns, time_ns, name, media_type, data)
        self._hand_over()

    def write(
        self, topic: str, cdr: bytes, received_ns: int, published_ns: int, sequence: int = 0
    ) -> None:
        """Append a message and hand it to the operating system.

        Parameters
        ----------
        topic : str
            Announced by `add_topic`.
        cdr : bytes
            Serialized message with its encapsulation header.
        received_ns, published_ns : int
            [ns] since 1970. The log time is `received_ns`, but never earlier than that of the
            message before: the file is in the order of its log times.
        sequence : int
            Number that the publisher gave to the message; 0: unknown.
        """
        log_ns = max(self.end_ns, received_ns)
        self._writer.add_message(
            self._channels[topic], log_ns, cdr, published_ns, sequence & 0xFFFFFFFF
        )
        self._hand_over()
        self.start_ns, self.end_ns = self.start_ns or log_ns, log_ns
        self.counts[topic] += 1

    def finish(self, end: str) -> None:
        """Write the summary, statistics and footer.

        Parameters
        ----------
        end : str
            How the run ended, one sentence; kept as the metadata record ``microhand_end``.
        """
        self.note(END_METADATA, {'end': end})
        self._writer.finish()
        self.stream.flush()

    def close(self, end: str) -> None:
        """Finish the file, see `finish`, see it onto the disk, and let go of it."""
        self.finish(end)
        os.fsync(self.stream.fileno())
        self.stream.close()

    def abandon(self) -> None:
        """Let go of a file that can no longer be written."""
        with suppress(OSError):  # closing tries once more to write what was refused
            self.stream.close()

    def _hand_over(self) -> None:
        """Give what has been written to the operating system, unless a chunk is being filled."""
        if not self._packed:
            self._writer.flush()
