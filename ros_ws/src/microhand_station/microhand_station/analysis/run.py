# SPDX-License-Identifier: Apache-2.0
"""A record file, finished or not → the run as arrays, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from microhand_planner.core.plan import Plan
from microhand_station.analysis.finger_record import FingerRecord
from microhand_station.analysis.gathered import Event, Gathered
from microhand_station.analysis.grip_record import GripRecord, grip_record
from microhand_station.analysis.object_mesh import ObjectMesh, object_mesh
from microhand_station.analysis.object_record import Deviation, ObjectRecord
from microhand_station.analysis.plan_progress import PlanProgress
from microhand_station.analysis.run_note import RunNote, node_parameters, run_note
from microhand_station.analysis.run_progress import from_commands, progress_of
from microhand_station.analysis.table import Table
from microhand_station.recording.record_scan import scan_records


@dataclass(frozen=True)
class Run:
    """One recorded run. All times are in seconds since `start_ns`, all arrays read-only.

    Attributes
    ----------
    path : Path
        Of the record.
    finished : bool
        False: the recorder did not come to close the file; what is here is what could be read.
    end : str
        How the run ended, as the recorder saw it; empty: it did not get to say.
    metadata : Mapping[str, str]
        What the recorder noted at the start.
    note : RunNote
        What the client noted: the request, where the stages are, how stiff the fingers.
    parameters : Mapping[str, Mapping[str, Any]]
        Of each node of the station, by its name.
    versions : Mapping[str, str]
        Of microhand, of what it stands on, of the system.
    plan : Plan or None
        What was to be done; None: see `missing`.
    mesh : ObjectMesh or None
        Surface of the object.
    fingers : Mapping[int, FingerRecord]
        By number, 1 to 3; those of which anything was recorded.
    object : ObjectRecord
        Where the object was; empty if nothing watched it.
    deviation : Deviation
        How far it was from where the plan had it; empty: unknown.
    progress : PlanProgress or None
        Where in the plan the run was at each time; None: it did not come to that.
    grip : GripRecord or None
        How firmly two fingers held; None: forces or plan are missing.
    events : tuple of Event
        What the nodes reported, in the order of the record.
    share : float
        Largest share of the planned time that the sequencer reported, 0 to 1.
    counts : Mapping[str, int]
        Messages by topic.
    undecodable : int
        Messages that are damaged and left out.
    missing : tuple of str
        One sentence for each thing that one would look for and that is not there.
    start_ns : int
        First log time [ns since 1970].
    duration_s : float
        From the first message to the last [s].
    """

    path: Path
    finished: bool
    end: str
    metadata: Mapping[str, str]
    note: RunNote
    parameters: Mapping[str, Mapping[str, Any]]
    versions: Mapping[str, str]
    plan: Plan | None
    mesh: ObjectMesh | None
    fingers: Mapping[int, FingerRecord]
    object: ObjectRecord
    deviation: Deviation
    progress: PlanProgress | None
    grip: GripRecord | None
    events: tuple[Event, ...]
    share: float
    counts: Mapping[str, int]
    undecodable: int
    missing: tuple[str, ...]
    start_ns: int
    duration_s: float

    @classmethod
    def open(
        cls, path: str | Path, progress: Callable[[int, int], None] = lambda done, total: None
    ) -> Run:
        """Read a record, also one that a crash left unfinished or that is damaged.

        Parameters
        ----------
        path : path
            The mcap file.
        progress : callable
            Called with bytes done and bytes in total.

        Raises
        ------
        BadRequest
            The file cannot be opened, is empty, is no mcap file, or holds no topic of microhand.
        """
        found = Gathered(Path(path))
        for record in scan_records(Path(path), progress):
            found.add(record)
        found.check()
        start_ns, end_ns = found.span_ns()
        plan, why_no_plan = found.plan()
        note = run_note(found.metadata.get('metadata_json', ''))
        fingers, body = found.fingers(start_ns), found.object(start_ns)
        place = progress_of(plan, note, fingers, *found.told(start_ns))
        off = found.deviation(start_ns)
        if not len(off) and place is not None:
            off = from_commands(place, body)
        grip = None if plan is None or place is None else grip_record(plan, place, body)
        mesh = object_mesh(found.attachments, plan, note.unit_um)
        return cls(
            path=Path(path),
            finished=found.finished,
            end=found.end,
            metadata=found.metadata,
            note=note,
            parameters=node_parameters(found.parameters),
            versions=found.versions,
            plan=plan,
            mesh=mesh,
            fingers=fingers,
            object=body,
            deviation=off,
            progress=place,
            grip=grip if grip is not None and np.isfinite(grip.measured_uN).any() else None,
            events=found.events(start_ns),
            share=found.share,
            counts=dict(found.counts),
            undecodable=found.undecodable,
            missing=tuple(_missing(found.finished, why_no_plan, note, mesh, fingers, body, off)),
            start_ns=start_ns,
            duration_s=(end_ns - start_ns) * 1e-9,
        )

    @property
    def name(self) -> str:
        """Of the run, as the recorder was told; else that of the file."""
        return self.metadata.get('run', '') or self.path.stem

    @property
    def events_table(self) -> Table:
        """The events as a table: time_s, source, error_code, text."""
        return Table(
            {
                'time_s': np.array([event.time_s for event in self.events], dtype=float),
                'source': np.array([event.source for event in self.events], dtype=object),
                'error_code': np.array([event.error_code for event in self.events], dtype=int),
                'text': np.array([event.text for event in self.events], dtype=object),
            }
        )


def _missing(
    finished: bool,
    why_no_plan: str,
    note: RunNote,
    mesh: ObjectMesh | None,
    fingers: Mapping[int, FingerRecord],
    body: ObjectRecord,
    off: Deviation,
) -> list[str]:
    """Say what one would look for and does not find."""
    absent = [str(number) for number in (1, 2, 3) if number not in fingers]
    said = {
        'The record was not finished: this is what could be read of it.': not finished,
        why_no_plan: bool(why_no_plan),
        'No mesh of the object is in the record.': mesh is None,
        'The mesh in the record is not proven to be the object of the plan.': (
            mesh is not None and not mesh.proven
        ),
        'Where the stages stand is not in the record: tips cannot be placed in the station.': (
            note.base_um is None
        ),
        f'Nothing was recorded of finger {", ".join(absent)}.': bool(absent),
        'Nothing watched the object: whether it was held is not judged.': not len(body),
        'How far the object was from its plan is not known.': bool(len(body)) and not len(off),
    }
    return [sentence for sentence, is_so in said.items() if is_so]
