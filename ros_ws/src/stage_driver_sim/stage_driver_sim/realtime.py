# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling of a driver: its control loop first, and nothing ordinary before it.

All threads of the process are raised, because Python runs one of them at a time: a control loop
that waits for a thread of ordinary priority waits for whatever keeps that one from the processor.
"""

from __future__ import annotations

import os
from pathlib import Path

REST_PRIORITY = 1
"""Of all threads but the first: the lowest that comes before ordinary ones."""
TASKS = Path('/proc/self/task')


def run_first(thread_id: int, priority: int) -> str:
    """Schedule this process by SCHED_FIFO, one of its threads above the others.

    Threads that are started later inherit from the one that starts them.

    Parameters
    ----------
    thread_id : int
        Native id of the thread that comes first, e.g. the control loop.
    priority : int
        Of that thread, 1 to 99; the others get `REST_PRIORITY`.

    Returns
    -------
    str
        Empty, or why the process is scheduled as before: usually it may not ask for more.
    """
    try:
        os.sched_setscheduler(thread_id, os.SCHED_FIFO, os.sched_param(priority))
        for task in TASKS.iterdir():
            if task.name != str(thread_id):
                _raise_if_alive(int(task.name))
    except OSError as error:
        return f'{error.strerror}; see `ulimit -r`'
    return ''


def _raise_if_alive(thread_id: int) -> None:
    """Raise one of the other threads; it may have ended meanwhile."""
    try:
        os.sched_setscheduler(thread_id, os.SCHED_FIFO, os.sched_param(REST_PRIORITY))
    except ProcessLookupError:
        return
