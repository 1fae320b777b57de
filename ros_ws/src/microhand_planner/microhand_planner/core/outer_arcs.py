# SPDX-License-Identifier: Apache-2.0
"""What a tip can reach of a section with hollows: the outer boundary of all its offset arcs."""

from __future__ import annotations

from microhand_planner.core.arc_chain import ArcChain


def outer_arcs(arcs: ArcChain, radius_um: float) -> tuple[ArcChain, list[float]]:
    """Return the reachable arcs and the path lengths at which they meet in kinks [µm]."""
    raise NotImplementedError
