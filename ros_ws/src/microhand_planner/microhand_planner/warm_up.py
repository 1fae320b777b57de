# SPDX-License-Identifier: Apache-2.0
"""Compile the searches, so that the first plan of a new process need not wait.

Run once after installation: ``python -m microhand_planner.warm_up``. The compiled code is kept
beside the modules, or where ``NUMBA_CACHE_DIR`` says, and belongs to this processor.
"""

from __future__ import annotations

import contextlib

from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import NoPlanExists
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose

_TURN_DEG = (10.0, 40.0, 10.0)


def main() -> None:
    """Plan a small reorientation of a part with hollows, with and without adhesion."""
    goal = Pose.of((0.0, 0.0, 0.0), Rotation.from_euler('ZYZ', _TURN_DEG, degrees=True))
    part = find_part('concave')
    for adhesion in (True, False):
        law = ContactLaw(adhesion=adhesion)
        with contextlib.suppress(NoPlanExists):  # an answer all the same: its search is compiled
            plan_reorientation(part, Pose(), goal, Finger(), law, SearchOptions())


if __name__ == '__main__':
    main()
