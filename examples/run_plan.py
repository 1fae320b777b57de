# SPDX-License-Identifier: Apache-2.0
"""Let a running station execute a plan file.

microhand station                                     # in another terminal
python examples/run_plan.py PLAN.json [RUN_NAME]
"""

import sys
from pathlib import Path

from microhand_planner.core.errors import MicrohandError
from microhand_planner.core.plan_file import read_plan
from microhand_station.client import StationClient


def main(file: str, name: str = '') -> int:
    """Execute the plan; return the exit status of `microhand`: 0 done, 2 bad plan, 4 failed."""
    try:
        plan = read_plan(Path(file))
        with StationClient() as station:
            station.wait_until_ready(deadline_s=30.0)
            print(f'{len(plan.steps)} steps')
            done = station.execute(plan, name, object_name=plan.object_name)
    except MicrohandError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    print(f'held: {done.held}, after {done.duration_s:.1f} s')
    print(f'record: {done.record_file}')
    return 0


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
