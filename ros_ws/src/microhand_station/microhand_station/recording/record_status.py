# SPDX-License-Identifier: Apache-2.0
"""An open run → what the recorder tells ``/diagnostics`` about its record (REP 107)."""

from __future__ import annotations

import shutil
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from microhand_station.recording.open_run import OpenRun

LOW_SPACE_MB = 500.0
"""A disk with less is worth a warning: an hour of a run [MB]."""


def record_status(name: str, run_dir: Path, run: OpenRun | None) -> DiagnosticStatus:
    """Return the status of a recorder.

    Parameters
    ----------
    name : str
        Fully qualified name of the node.
    run_dir : Path
        Folder of the records.
    run : OpenRun or None
        Being recorded; None: no run is.
    """
    status = DiagnosticStatus(name=f'{name}: record', hardware_id=str(run_dir))
    free_mb = _free_mb(run_dir)
    if run is not None and run.fault:
        status.level, status.message = DiagnosticStatus.ERROR, run.fault
    elif free_mb is not None and free_mb < LOW_SPACE_MB:
        status.level, status.message = DiagnosticStatus.WARN, f'{free_mb:.0f} MB are left'
    else:
        status.level = DiagnosticStatus.OK
        status.message = 'no run' if run is None else 'recording'
    values = {
        'file': '' if run is None else str(run.path),
        'messages': '0' if run is None else str(run.messages),
        'free space [MB]': 'unknown' if free_mb is None else f'{free_mb:.0f}',
    }
    status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    return status


def _free_mb(folder: Path) -> float | None:
    """Return the free space where a folder is, or will be made [MB]; None: unknown."""
    for place in (folder, *folder.absolute().parents):
        try:
            return shutil.disk_usage(place).free / 1e6
        except OSError:
            continue
    return None
