# SPDX-License-Identifier: Apache-2.0
"""How planning grows with finer steps, larger parts and dearer goals.

Each case runs in a process of its own, so that its peak memory is its own.

    python benchmarks/growth.py
"""

from __future__ import annotations

import json
import math
import resource
import subprocess
import sys

from record import cpu_time_s, write

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.parameters import Finger
from microhand_planner.core.part import make_part
from microhand_planner.core.planar import solve_planar
from microhand_planner.core.section_curves import section_curves
from microhand_planner.evaluation.paper_figures import TABLE_4
from microhand_planner.evaluation.speed import dearest_problem, measure, plan_whole

WHOLE = {whole.object_name: whole for whole in TABLE_4}
CASES: tuple[tuple[str, str, float, float], ...] = (
    # what, object, step [deg], scale
    *(
        ('step', name, step_deg, 1.0)
        for name in WHOLE
        for step_deg in (20.0, 15.0, 10.0, 7.0, 5.0, 3.0, 2.0, 1.0)
    ),
    *(('size', 'ellipsoid', 20.0, scale) for scale in (1.0, 2.0, 4.0, 8.0, 16.0)),
    *(('dearest', 'ellipse', step_deg, 1.0) for step_deg in (20.0, 10.0, 5.0, 2.0)),
)


def run_case(what: str, name: str, step_deg: float, scale: float) -> dict[str, object]:
    """Measure one case in this process."""
    if what == 'dearest':
        problem = dearest_problem(step_deg)
        contacts = problem.contacts
        timing = measure(lambda: solve_planar(problem), cpu_time_s)
    else:
        part = find_part(name)
        if scale != 1.0:
            part = make_part(name, part.vertices_um * scale, part.faces)
        curves = section_curves(part, Finger())
        contacts = math.ceil(curves.curves['z'].length_rad / math.radians(step_deg))
        timing = measure(lambda: plan_whole(WHOLE[name], curves, step_deg), cpu_time_s)
    return {
        'what': what,
        'object': name,
        'step_deg': step_deg,
        'scale': scale,
        'contacts_l1': contacts,
        'runs': timing.runs,
        'median_s': timing.median_s,
        'fastest_s': timing.fastest_s,
        'slowest_s': timing.slowest_s,
        'peak_memory_mb': resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def main() -> None:
    """Measure all cases, print a line each, and write the results."""
    rows = []
    for case in CASES:
        child = subprocess.run(
            [sys.executable, __file__, *map(str, case)], capture_output=True, text=True, check=True
        )
        row = json.loads(child.stdout)
        rows.append(row)
        print(
            f'{row["what"]:8} {row["object"]:10} step {row["step_deg"]:4g} deg, '
            f'scale {row["scale"]:3g}, c = {row["contacts_l1"]:5}: '
            f'{1e3 * row["median_s"]:9.2f} ms, {row["peak_memory_mb"]:.0f} MB',
            flush=True,
        )
    print(write('growth', rows, ('numpy', 'scipy', 'numba')))


if __name__ == '__main__':
    if len(sys.argv) == 5:
        what, name, step_deg, scale = sys.argv[1:]
        print(json.dumps(run_case(what, name, float(step_deg), float(scale))))
    else:
        main()
