# SPDX-License-Identifier: Apache-2.0
"""From typing a command to its answer: new processes, compiled code in numba's cache.

python benchmarks/cold_start.py
"""

from __future__ import annotations

import statistics
import subprocess
import sys

from record import cpu_time_s, write

RUNS = 9
MICROHAND = [sys.executable, '-m', 'microhand_station.cli.app']
CASES = {
    'python': [sys.executable, '-c', 'pass'],
    'import numpy, scipy, numba': [
        sys.executable, '-c', 'import numba, numpy, scipy.spatial.transform',
    ],
    'microhand --help': [*MICROHAND, '--help'],
    'microhand plan': [
        *MICROHAND, 'plan', 'ellipsoid', '--euler-zyz', '80', '220', '100', '--json',
    ],
    'microhand plan, no adhesion': [
        *MICROHAND, 'plan', 'convex', '--euler-zyz', '60', '80', '40', '--no-adhesion', '--json',
    ],
}  # fmt: skip


def main() -> None:
    """Measure all commands, print a line each, and write the results."""
    rows = []
    for name, command in CASES.items():
        times_s = []
        for _ in range(RUNS + 1):
            started = cpu_time_s()
            subprocess.run(command, check=True, capture_output=True)
            times_s.append(cpu_time_s() - started)
        times_s = times_s[1:]  # the first one reads from the disk
        rows.append(
            {
                'command': name,
                'runs': RUNS,
                'median_s': statistics.median(times_s),
                'fastest_s': min(times_s),
                'slowest_s': max(times_s),
            }
        )
        print(f'{name:28} {statistics.median(times_s):.2f} s', flush=True)
    print(write('cold_start', rows, ('numpy', 'scipy', 'numba', 'trimesh', 'click')))


if __name__ == '__main__':
    main()
