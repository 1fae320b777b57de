# SPDX-License-Identifier: Apache-2.0
"""Where and when a benchmark ran, kept beside its figures."""

from __future__ import annotations

import datetime
import json
import os
import platform
import resource
import sys
from importlib.metadata import version
from pathlib import Path

RESULTS = Path(__file__).parent / 'results'


def cpu_time_s() -> float:
    """Return the processor time of this process and of its children that have ended [s].

    The planner works in one thread and waits for nothing: on an idle machine its wall time is as
    much, and on a busy one only this can be compared.
    """
    of = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in of)


def processor() -> str:
    """Return the name of the processor."""
    for line in Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines():
        if line.startswith('model name'):
            return line.split(':', 1)[1].strip()
    return platform.machine()


def write(name: str, rows: list[dict[str, object]], packages: tuple[str, ...]) -> Path:
    """Write the rows of a benchmark to ``results/<name>.json``.

    Parameters
    ----------
    name : str
        Name of the benchmark.
    rows : list of dict
        Its figures.
    packages : tuple of str
        Installed packages whose versions matter.
    """
    content = {
        'command': ' '.join(['python', f'benchmarks/{name}.py', *sys.argv[1:]]),
        'date': datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        'machine': {
            'processor': processor(),
            'cores': len(os.sched_getaffinity(0)),
            'load_before': round(os.getloadavg()[0], 2),
            'python': platform.python_version(),
            'packages': {package: version(package) for package in packages},
        },
        'rows': rows,
    }
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f'{name}.json'
    path.write_text(json.dumps(content, indent=2) + '\n', encoding='utf-8')
    return path
