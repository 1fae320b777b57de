# SPDX-License-Identifier: Apache-2.0
"""A record → one tidy table per topic, as CSV files with units in their heads."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from mcap.records import Channel, Message, Schema

from microhand_planner.core.errors import BadRequest
from microhand_station.analysis.message_decoder import MessageDecoder, RecordedTopic
from microhand_station.analysis.record_index import RecordIndex
from microhand_station.analysis.schema_units import schema_units
from microhand_station.analysis.tidy_rows import SIDE_TABLES, Row, tidy_rows, unit_of
from microhand_station.recording.record_scan import scan_records

_TIME = 'time'


@dataclass(frozen=True)
class Slice:
    """A part of a run.

    Parameters
    ----------
    from_s, to_s : float
        Since the first message of the record [s]; messages at both ends are in it.

    Raises
    ------
    BadRequest
        It ends before it begins, or one of them is no number.
    """

    from_s: float = -math.inf
    to_s: float = math.inf

    def __post_init__(self) -> None:
        """Check the order."""
        if not self.from_s <= self.to_s:
            raise BadRequest('to', f'{self.to_s:g} s', f'from {self.from_s:g} s on')


@dataclass(frozen=True)
class Exported:
    """One table that was written.

    Attributes
    ----------
    topic : str
        Where its rows come from.
    path : Path
        The file.
    rows : int
        Without the head.
    """

    topic: str
    path: Path
    rows: int


def export_csv(
    record: Path,
    index: RecordIndex,
    folder: Path,
    topics: Collection[str] = (),
    part: Slice = Slice(),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[tuple[Exported, ...], int]:
    """Write the messages of a record as CSV files, one per topic.

    ``/finger_1/state`` becomes ``finger_1.state.csv``. The first column is the time since the
    first message of the record; see `tidy_rows` for the others. Stamps are exact decimals.

    Parameters
    ----------
    record : Path
        The mcap file, whole or broken.
    index : RecordIndex
        Of that file.
    folder : Path
        Made if it does not exist.
    topics : collection of str
        Names; none: all topics that have messages.
    part : Slice
        Which part of the run.
    progress : callable
        Called with bytes done and bytes in total.

    Returns
    -------
    tables : tuple of Exported
        In the order of the topics in the record.
    damaged : int
        Messages that could not be decoded.

    Raises
    ------
    BadRequest
        A topic that is not there, a folder that cannot be written, or tables that are there.
    """
    chosen = index.chosen(topics)
    decoder, damaged = MessageDecoder(), 0
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as open_files:
            tables: dict[tuple[str, str], _Table] = {}
            for name, topic in chosen.items():
                if topics or index.counts.get(name, 0):
                    for side in ('', *SIDE_TABLES.get(topic.type_name.replace('/msg/', '/'), ())):
                        tables[name, side] = _Table(folder, topic, side, open_files)
            for found in scan_records(record, progress):
                if isinstance(found, Schema | Channel):
                    decoder.announce(found)
                if not isinstance(found, Message):
                    continue
                of = decoder.topic_of(found)
                time_s = (found.log_time - index.start_ns) * 1e-9
                if of is None or of.name not in chosen or not part.from_s <= time_s <= part.to_s:
                    continue
                message = decoder.decode(found)
                damaged += message is None
                for (name, side), table in tables.items():
                    if name == of.name and message is not None:
                        table.add(time_s, tidy_rows(message, side))
        return tuple(table.finished() for table in tables.values()), damaged
    except FileExistsError as error:
        allowed = 'a folder in which no table of this name is'
        raise BadRequest('csv', error.filename, allowed) from error
    except OSError as error:
        allowed = f'a folder that can be written ({error.strerror})'
        raise BadRequest('csv', folder, allowed) from error


class _Table:
    """One file while it is being written. Columns may be added by later rows."""

    def __init__(self, folder: Path, topic: RecordedTopic, side: str, files: ExitStack) -> None:
        name = '.'.join([*topic.name.strip('/').split('/'), *([side] if side else [])])
        self._topic = topic.name
        self._path = folder / f'{name}.csv'
        self._stream: TextIO = files.enter_context(
            self._path.open('x', encoding='utf-8', newline='')
        )
        self._writer = csv.writer(self._stream)
        self._units = schema_units(topic.type_name, topic.schema) if topic.schema else {}
        self._columns: dict[str, None] = {_TIME: None}
        self._headed = 0
        self._rows = 0

    def add(self, time_s: float, rows: Any) -> None:
        """Append the rows of a message."""
        for row in rows:
            self._columns.update(dict.fromkeys(row))
            if not self._headed:
                self._headed = len(self._columns)
                self._writer.writerow(self._head())
            values: Row = {_TIME: f'{time_s:.9f}', **row}
            self._writer.writerow([_cell(values.get(column)) for column in self._columns])
            self._rows += 1

    def finished(self) -> Exported:
        """Return what was written, once the file is closed; give all rows the same columns."""
        if self._headed < len(self._columns):
            self._fill_up()
        return Exported(self._topic, self._path, self._rows)

    def _fill_up(self) -> None:
        """Write the file again with all columns in every row."""
        whole = self._path.with_suffix('.part')
        with (
            self._path.open(encoding='utf-8', newline='') as old,
            whole.open('w', encoding='utf-8', newline='') as new,
        ):
            writer = csv.writer(new)
            writer.writerow(self._head())
            rows = csv.reader(old)
            if self._headed:
                next(rows)
            for row in rows:
                writer.writerow(row + [''] * (len(self._columns) - len(row)))
        whole.replace(self._path)

    def _head(self) -> list[str]:
        return [_headed(column, self._units) for column in self._columns]


def _headed(column: str, units: Mapping[str, str]) -> str:
    unit = 's' if column == _TIME else unit_of(column, units)
    return f'{column} [{unit}]' if unit else column


def _cell(value: Any) -> Any:
    """Return a value as it stands in a cell: NaN and what is not there are blank."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ''
    if isinstance(value, bool):
        return 'true' if value else 'false'
    return value.hex() if isinstance(value, bytes) else value
