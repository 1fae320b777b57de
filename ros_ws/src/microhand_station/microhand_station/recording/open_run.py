# SPDX-License-Identifier: Apache-2.0
"""One run while it is being recorded: its file, its counts, and what went wrong with it.

Everything is written twice: into the file of the run, which survives a crash, and into a packed
one without a name, which takes the place of the first when the run ends well. Packing meanwhile
costs little; packing a long run at its end would keep its caller waiting.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, cast

from microhand_station.recording.bag_metadata import AnnouncedTopic, write_bag_metadata
from microhand_station.recording.run_writer import RunWriter
from microhand_station.recording.setpoint_tally import SetpointTally


class OpenRun:
    """A run being recorded. A disk that refuses ends the recording, never the recorder.

    Parameters
    ----------
    run_dir : Path
        Folder of the records; made if it does not exist. The run gets a folder of its own in it,
        ``<name>/``, or ``<name>_2/`` and so on: a record is never overwritten.
    name : str
        Of the run.
    metadata : Mapping[str, str]
        Kept as the metadata record ``microhand_run``.
    topics : sequence of AnnouncedTopic
        All topics.
    fingers : sequence of int
        Whose setpoints are counted.
    max_message_bytes : int
        Larger messages are left out.

    Attributes
    ----------
    path : Path
        Of the file.
    failure : str
        Why nothing is written any more; empty: all is well.
    left_out : Counter of str
        Messages that were too large, by topic.
    closing : bool
        Whether the end of the run has been asked for.

    Raises
    ------
    OSError
        The folder or the file cannot be made.
    """

    def __init__(
        self,
        run_dir: Path,
        name: str,
        metadata: Mapping[str, str],
        topics: Sequence[AnnouncedTopic],
        fingers: Sequence[int],
        max_message_bytes: int,
    ) -> None:
        folder = _new_folder(run_dir, name)
        self.path = folder / f'{folder.name}.mcap'
        self.failure = ''
        self.left_out: Counter[str] = Counter()
        self.closing = False
        self._topics = topics
        self._max_message_bytes = max_message_bytes
        self._tallies = {finger: SetpointTally() for finger in fingers}
        try:
            self._writer = _writer(self.path, metadata, topics)
        except OSError:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self._packed = _packed_writer(folder, metadata, topics)

    @property
    def messages(self) -> int:
        """Messages in the file."""
        return self._writer.messages

    @property
    def fault(self) -> str:
        """What is wrong so far, apart from missing setpoints; empty: nothing."""
        too_large = ', '.join(f'{count} of {topic}' for topic, count in self.left_out.items())
        limit_mb = self._max_message_bytes / 1e6
        larger = f'messages larger than {limit_mb:g} MB are left out: {too_large}'
        return '; '.join(fault for fault in (self.failure, larger if too_large else '') if fault)

    def note(self, name: str, values: Mapping[str, str]) -> bool:
        """Keep a metadata record; False if it did not get into the file."""
        return self._do(lambda writer: writer.note(name, values))

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> bool:
        """Keep a whole file; False if it did not get into the file of the run."""
        return self._do(lambda writer: writer.attach(name, media_type, data, time_ns))

    def write(
        self, topic: str, cdr: bytes, received_ns: int, published_ns: int, sequence: int = 0
    ) -> bool:
        """Append a message, see `RunWriter.write`; False if it did not get into the file."""
        if len(cdr) > self._max_message_bytes:
            self.left_out[topic] += 1
            return False
        return self._do(
            lambda writer: writer.write(topic, cdr, received_ns, published_ns, sequence)
        )

    def count_setpoints(self, finger: int, stream: int, first: int, size: int) -> None:
        """Count a chunk that was written, see `SetpointTally.add`."""
        self._tallies[finger].add(stream, first, size)

    def recorded_setpoints(self, finger: int) -> int:
        """Setpoints of a finger in the file."""
        return self._tallies[finger].count if finger in self._tallies else 0

    def lacks(self, expected: Mapping[int, int]) -> bool:
        """Whether setpoints that were sent may still arrive."""
        return not self.failure and any(
            self.recorded_setpoints(finger) < sent for finger, sent in expected.items()
        )

    def shortfall(self, expected: Mapping[int, int]) -> str:
        """Say what is not as it should be; empty: every setpoint is in the file, in order.

        Parameters
        ----------
        expected : Mapping[int, int]
            Setpoints that were sent, by finger.
        """
        faults = [self.fault] if self.fault else []
        for finger, sent in expected.items():
            recorded = self.recorded_setpoints(finger)
            if recorded != sent:
                faults.append(f'finger_{finger}: {recorded} setpoints recorded, {sent} sent')
        for finger, tally in self._tallies.items():
            if not tally.complete:
                faults.append(
                    f'finger_{finger}: {tally.missing} setpoints skipped, '
                    f'{tally.out_of_order} repeated or late'
                )
        return '; '.join(faults)

    def discard(self) -> None:
        """Remove the file again: the run does not begin."""
        self._give_up('discarded')
        shutil.rmtree(self.path.parent, ignore_errors=True)

    def close(self, end: str) -> None:
        """Finish the file; `failure` says so if that cannot be done.

        At every moment of it the file is there: as it was written, finished, and then packed.
        """
        if self.failure:
            return
        try:
            self._writer.close(end)
        except OSError as error:
            self._give_up(f'{self.path} could not be finished: {error}')
            return
        with suppress(OSError):  # the file is whole, only larger and without metadata.yaml
            self._put_packed_in_place(end)
            write_bag_metadata(self.path, self._writer, self._topics)
        self._drop_packed()

    def _do(self, write: Callable[[RunWriter], None]) -> bool:
        """Write into the file of the run, and into the packed one."""
        if self.failure:
            return False
        try:
            write(self._writer)
        except OSError as error:
            self._give_up(f'{self.path} ends early after {self.messages} messages: {error}')
            return False
        if self._packed is not None:
            try:
                write(self._packed)
            except OSError:
                self._drop_packed()
        return True

    def _give_up(self, failure: str) -> None:
        """Write nothing any more."""
        self._writer.abandon()
        self._drop_packed()
        self.failure = failure

    def _put_packed_in_place(self, end: str) -> None:
        """Replace the file by the packed one."""
        if self._packed is None:
            return
        self._packed.finish(end)
        self._packed.stream.seek(0)
        part = self.path.with_suffix('.part')
        try:
            with part.open('xb') as copy:
                shutil.copyfileobj(self._packed.stream, copy)
                copy.flush()
                os.fsync(copy.fileno())
            part.replace(self.path)
        finally:
            part.unlink(missing_ok=True)

    def _drop_packed(self) -> None:
        """Let go of the packed file: it has no name, and is gone with that."""
        if self._packed is not None:
            self._packed.abandon()
            self._packed = None


def _new_folder(run_dir: Path, name: str) -> Path:
    """Make a folder that was not there."""
    run_dir.mkdir(parents=True, exist_ok=True)
    number = 1
    while True:
        folder = run_dir / (name if number == 1 else f'{name}_{number}')
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
        else:
            return folder


def _writer(
    path: Path, metadata: Mapping[str, str], topics: Sequence[AnnouncedTopic]
) -> RunWriter:
    """Open the file of a run."""
    stream = path.open('xb')
    try:
        writer = RunWriter(stream, metadata)
        _announce(writer, topics)
    except OSError:
        with suppress(OSError):  # closing tries once more to write what was refused
            stream.close()
        raise
    return writer


def _packed_writer(
    folder: Path, metadata: Mapping[str, str], topics: Sequence[AnnouncedTopic]
) -> RunWriter | None:
    """Open a packed file without a name; None: the disk refuses."""
    try:
        writer = RunWriter(
            cast('BinaryIO', tempfile.TemporaryFile(dir=folder)), metadata, packed=True
        )
        _announce(writer, topics)
    except OSError:
        return None
    return writer


def _announce(writer: RunWriter, topics: Sequence[AnnouncedTopic]) -> None:
    """Announce all topics."""
    for topic in topics:
        writer.add_topic(
            topic.name, topic.type_name, topic.schema, topic.offered_qos, topic.type_hash
        )
