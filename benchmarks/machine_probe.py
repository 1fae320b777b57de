# SPDX-License-Identifier: Apache-2.0
"""When the machine itself was away: a thread on each core that does nothing but wake up in time.

As `cyclictest`: the highest priority there is, one millisecond from waking to waking. What is late
here was not delayed by a program, but by the kernel or by whatever the machine runs on. A user who
may not have that priority (`ulimit -r`) also sees what other programs delayed.

Run by streaming.py, as processes: ``CORE FILE``, until SIGTERM.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PERIOD_S = 0.001
PRIORITY = 98
AWAY_S = 0.0003
"""A core that wakes up later than this was away [s]."""
AFTER_S = 0.01
"""So long a stage that was not served may need to be where it should be [s]."""


class MachineProbe:
    """Probes of all cores: ``with MachineProbe(folder) as probe: …``, then ask."""

    def __init__(self, folder: Path) -> None:
        cores = sorted(os.sched_getaffinity(0))
        self._files = [folder / f'core_{core}.npy' for core in cores]
        script = str(Path(__file__).resolve())
        self._processes = [
            subprocess.Popen([sys.executable, script, str(core), str(file)])
            for core, file in zip(cores, self._files, strict=True)
        ]

    def __enter__(self) -> MachineProbe:
        """Return the probe, which runs already."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the probes and take in what they saw."""
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.wait()
        self._woken = np.concatenate([np.load(file) for file in self._files])

    def figures(self) -> dict[str, Any]:
        """Return the median, 99 % and largest delay [ms], and how often a core was away."""
        late_ms = 1e3 * self._woken[:, 1]
        return {
            'machine_late_ms': [round(float(x), 4) for x in np.percentile(late_ms, [50, 99, 100])],
            'machine_away': int((self._woken[:, 1] > AWAY_S).sum()),
        }

    def away(self, steady_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which moments of the steady clock [s] lie in, or just after, an absence."""
        absences = self._woken[self._woken[:, 1] > AWAY_S]
        absences = absences[np.argsort(absences[:, 0])]
        if len(absences) == 0:
            return np.zeros(np.shape(steady_s), dtype=np.bool_)
        ends_s = np.maximum.accumulate(absences.sum(axis=1) + AFTER_S)
        before = np.searchsorted(absences[:, 0], steady_s, side='right') - 1
        return (before >= 0) & (steady_s <= ends_s[before])


def probe(core: int, file: str) -> None:
    """Wake up every millisecond until SIGTERM; save when that was due and how late it was [s]."""
    going = True

    def end(*_: object) -> None:
        nonlocal going
        going = False

    signal.signal(signal.SIGTERM, end)
    os.sched_setaffinity(0, {core})
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    rows: list[tuple[float, float]] = []
    due_s = time.monotonic()
    while going:
        due_s = max(due_s + PERIOD_S, time.monotonic())
        time.sleep(max(0.0, due_s - time.monotonic()))
        rows.append((due_s, time.monotonic() - due_s))
    np.save(file, np.array(rows))


if __name__ == '__main__':
    probe(int(sys.argv[1]), sys.argv[2])
