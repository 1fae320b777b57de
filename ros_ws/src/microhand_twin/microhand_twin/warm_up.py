# SPDX-License-Identifier: Apache-2.0
"""Compile what finds contacts, so that the first world of a new process need not wait.

Run once after installation: ``python -m microhand_twin.warm_up``; see `microhand_planner.warm_up`.
"""

from __future__ import annotations

from microhand_planner.core.catalogue import find_part
from microhand_twin.simulation import Simulation
from microhand_twin.world import build_world


def main() -> None:
    """Take one step in a world with a smooth surface."""
    simulation = Simulation(build_world(find_part('convex')))
    simulation.advance(simulation.command_um, 0.001)


if __name__ == '__main__':
    main()
