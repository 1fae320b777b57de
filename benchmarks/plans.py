# SPDX-License-Identifier: Apache-2.0
"""The rows of ``microhand bench``, kept.

python benchmarks/plans.py
"""

from __future__ import annotations

from dataclasses import asdict

from record import cpu_time_s, write

from microhand_planner.core.catalogue import find_part
from microhand_planner.evaluation.speed import bench


def main() -> None:
    """Measure, print a line each, and write the results."""
    rows = []
    for row in bench(find_part, cpu_time_s):
        flat = asdict(row)
        rows.append({**flat.pop('timing'), **flat, 'times_faster': row.times_faster})
        print(
            f'{row.case:24} {row.object_name:10} {row.step_deg:4g} deg: '
            f'{1e3 * row.timing.median_s:9.2f} ms',
            flush=True,
        )
    print(write('plans', rows, ('numpy', 'scipy', 'numba', 'trimesh')))


if __name__ == '__main__':
    main()
