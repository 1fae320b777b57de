# SPDX-License-Identifier: Apache-2.0
"""What was noted at the start of a run → where the stages are, and what was asked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.plan import FINGERS


@dataclass(frozen=True)
class RunNote:
    """The notes of a run.

    Attributes
    ----------
    request : Mapping[str, Any]
        What was asked for, in SI units; empty: not noted.
    base_um : (3, 3) array or None
        Tips of fingers 1, 2, 3 in the station when their stages are at zero; None: not noted.
    stiffness_uN_per_um : (3,) array or None
        Of the fingers; None: not noted.
    """

    request: Mapping[str, Any]
    base_um: NDArray[np.float64] | None
    stiffness_uN_per_um: NDArray[np.float64] | None

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for value in (self.base_um, self.stiffness_uN_per_um):
            if value is not None:
                value.setflags(write=False)

    @property
    def unit_um(self) -> float | None:
        """Length of one unit of the mesh that was asked for [µm]; None: not told."""
        unit_m = self.request.get('unit')
        return unit_m * 1e6 if isinstance(unit_m, float) and unit_m > 0.0 else None


def node_parameters(noted: Mapping[str, str]) -> dict[str, Mapping[str, Any]]:
    """Read the parameters of all nodes; what is damaged is left out.

    Parameters
    ----------
    noted : Mapping[str, str]
        By the name of the node, a JSON object.
    """
    found: dict[str, Mapping[str, Any]] = {}
    for node, text in noted.items():
        try:
            values = json.loads(text)
        except ValueError:
            continue
        if isinstance(values, dict):
            found[node] = values
    return found


def run_note(metadata_json: str) -> RunNote:
    """Read what the client gave the recorder; what is damaged or not there is left out.

    Parameters
    ----------
    metadata_json : str
        A JSON object with ``station``, the content of the station file, and perhaps ``request``.
    """
    try:
        content = json.loads(metadata_json or '{}')
    except ValueError:
        content = {}
    if not isinstance(content, dict):
        content = {}
    request = content.get('request')
    try:
        fingers = content['station']['fingers']
        base_um = np.array([finger['base_um'] for finger in fingers], dtype=float)
        stiffness = np.array([finger['stiffness_n_per_m'] for finger in fingers], dtype=float)
    except (KeyError, TypeError, ValueError):
        return RunNote(request if isinstance(request, dict) else {}, None, None)
    sound = base_um.shape == (FINGERS, 3) and stiffness.shape == (FINGERS,)
    sound = sound and bool(np.isfinite(base_um).all() and (stiffness > 0.0).all())
    return RunNote(
        request if isinstance(request, dict) else {},
        base_um if sound else None,
        stiffness if sound else None,
    )
