# SPDX-License-Identifier: Apache-2.0
"""What a driver tells ``/diagnostics`` about its stage and its own timing (REP 107)."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from stage_driver_sim.control_loop import LoopTiming
from stage_driver_sim.snapshot import Mode, Snapshot


def stage_status(
    name: str, hardware_id: str, snapshot: Snapshot | None, timing: LoopTiming, scheduling: str
) -> DiagnosticStatus:
    """Return the status of a driver.

    Parameters
    ----------
    name : str
        Fully qualified name of the node.
    hardware_id : str
        The stage.
    snapshot : Snapshot or None
        What the stage does; None: the driver is not active.
    timing : LoopTiming
        How the control loop kept its deadlines since the last status.
    scheduling : str
        Of the control loop.
    """
    status = DiagnosticStatus(name=f'{name}: stage', hardware_id=hardware_id)
    if snapshot is None:
        status.level = DiagnosticStatus.STALE
        status.message = 'not active'
        return status
    if snapshot.mode is Mode.FAULT:
        status.level = DiagnosticStatus.ERROR
        status.message = snapshot.error_msg
    elif snapshot.mode in (Mode.OFF, Mode.STOPPED):
        status.level = DiagnosticStatus.WARN
        status.message = snapshot.mode.name
    else:
        status.level = DiagnosticStatus.OK
        status.message = snapshot.mode.name
    wall_s = max(timing.wall_s, 1e-9)
    values = {
        'mode': snapshot.mode.name,
        'stream': str(snapshot.stream),
        'setpoints received': str(snapshot.received),
        'chunks dropped': str(snapshot.dropped),
        'underruns': str(snapshot.underruns),
        'control loop scheduling': scheduling,
        'control loop rate [Hz]': f'{timing.ticks / wall_s:.1f}',
        'control loop missed ticks': str(timing.missed),
        'control loop worst delay [s]': f'{timing.worst_late_s:.6f}',
        'control loop processor share [1]': f'{timing.cpu_s / wall_s:.4f}',
    }
    status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    return status
