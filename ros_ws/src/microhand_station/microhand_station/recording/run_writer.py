# SPDX-License-Identifier: Apache-2.0
"""Messages as they arrive → one mcap file per run that survives a crash of the recorder.

While a run lasts the file has no chunks and every message is handed to the operating system at
once: a killed recorder loses the message it was writing, no more, and ``recover`` reads the rest.
A chunked writer would keep up to 1 MiB in memory, which is a minute of a slow run.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from mcap.writer import Writer

RUN_METADATA = 'microhand_run'
END_METADATA = 'microhand_end'


def create_run_file(run_dir: Path, name: str) -> tuple[Path, BinaryIO]:
    """Create ``<name>.mcap``, or ``<name>_2.mcap`` and so on: a record is never overwritten.

    Parameters
    ----------
    run_dir : Path
        Folder; made if it does not exist.
    name : str
        Of the run, without suffix.

    Raises
    ------
    OSError
        The folder cannot be made or written.
    """
    run_dir.mkdir(parents=True, exist_ok=True)
    number = 1
    while True:
        path = run_dir / (f'{name}.mcap' if number == 1 else f'{name}_{number}.mcap')
        try:
            return path, path.open('xb')
        except FileExistsError:
            number += 1


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

    Attributes
    ----------
    messages : int
        Messages written.
    """

    def __init__(self, stream: BinaryIO, metadata: Mapping[str, str]) -> None:
        self.messages = 0
        self._stream = stream
        self._writer = Writer(stream, use_chunking=False)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._last_log_ns = 0
        self._writer.start(profile='ros2', library='microhand')
        self._writer.add_metadata(RUN_METADATA, dict(metadata))
        self._writer.flush()

    def add_topic(self, topic: str, type_name: str, schema: str, offered_qos: str) -> None:
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
        """
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(
                type_name, 'ros2msg', schema.encode()
            )
        self._channels[topic] = self._writer.register_channel(
            topic, 'cdr', self._schemas[type_name], {'offered_qos_profiles': offered_qos}
        )
        self._writer.flush()

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Keep a whole file, such as the mesh of the object, in the record."""
        self._writer.add_attachment(time_ns, time_ns, name, media_type, data)
        self._writer.flush()

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
        self._last_log_ns = max(self._last_log_ns, received_ns)
        self._writer.add_message(
            self._channels[topic], self._last_log_ns, cdr, published_ns, sequence & 0xFFFFFFFF
        )
        self._writer.flush()
        self.messages += 1

    def close(self, end: str) -> None:
        """Finish the file: summary, statistics, footer; then see it onto the disk.

        Parameters
        ----------
        end : str
            How the run ended, one sentence; kept as the metadata record ``microhand_end``.
        """
        self._writer.add_metadata(END_METADATA, {'end': end})
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def abandon(self) -> None:
        """Let go of a file that can no longer be written."""
        with suppress(OSError):  # closing tries once more to write what was refused
            self._stream.close()
