# SPDX-License-Identifier: Apache-2.0
"""One run while it is being recorded: its file, its counts, and what went wrong with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from microhand_station.recording.run_writer import RunWriter
from microhand_station.recording.setpoint_tally import SetpointTally


class OpenRun:
    """A run being recorded. A disk that refuses ends the recording, never the recorder.

    Attributes
    ----------
    path : Path
        Of the file.
    failure : str
        Why nothing is written any more; empty: all is well.
    closing : bool
        Whether the end of the run has been asked for.
    """

    def __init__(self, path: Path, writer: RunWriter, fingers: Sequence[int]) -> None:
        self.path = path
        self.failure = ''
        self.closing = False
        self._writer = writer
        self._tallies = {finger: SetpointTally() for finger in fingers}

    @property
    def messages(self) -> int:
        """Messages in the file."""
        return self._writer.messages

    def write(
        self, topic: str, cdr: bytes, received_ns: int, published_ns: int, sequence: int = 0
    ) -> bool:
        """Append a message, see `RunWriter.write`; False if it did not get into the file."""
        if self.failure:
            return False
        try:
            self._writer.write(topic, cdr, received_ns, published_ns, sequence)
        except OSError as error:
            self._writer.abandon()
            self.failure = f'{self.path} ends early after {self.messages} messages: {error}'
            return False
        return True

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
        faults = [self.failure] if self.failure else []
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

    def close(self, end: str) -> None:
        """Finish the file; `failure` says so if that cannot be done."""
        if self.failure:
            return
        try:
            self._writer.close(end)
        except OSError as error:
            self._writer.abandon()
            self.failure = f'{self.path} could not be finished: {error}'
