# SPDX-License-Identifier: Apache-2.0
"""Compile the searches, so that the first plan of a new process need not wait.

Run once after installation: ``python -m microhand_planner.warm_up``. The compiled code is kept
beside the modules, or where ``NUMBA_CACHE_DIR`` says, and belongs to this processor.
"""

from __future__ import annotations

import contextlib
import itertools

from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import NoPlanExists
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.section_curves import section_curves
from microhand_planner.evaluation.grasp_count import count_pressing, section_contacts

_TURNS_DEG = ((10.0, 40.0, 10.0), (20.0, 0.0, 0.0))  # between joints, and with free ends


def main() -> None:
    """Plan small reorientations of a part with hollows, with and without adhesion."""
    part = find_part('concave')
    for adhesion, turn_deg in itertools.product((True, False), _TURNS_DEG):
        goal = Pose.of((0.0, 0.0, 0.0), Rotation.from_euler('ZYZ', turn_deg, degrees=True))
        law = ContactLaw(adhesion=adhesion)
        with contextlib.suppress(NoPlanExists):  # an answer all the same: its search is compiled
            plan_reorientation(part, Pose(), goal, Finger(), law, SearchOptions())
    curves = section_curves(part, Finger()).curves
    count_pressing(section_contacts(curves['z'], Finger(), SearchOptions().step_rad), 0.3)


if __name__ == '__main__':
    main()
