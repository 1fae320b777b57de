# SPDX-License-Identifier: Apache-2.0
"""What the twin says about a plan."""

from __future__ import annotations

from dataclasses import dataclass

from microhand_planner.core.plan import StepKind


@dataclass(frozen=True)
class Loss:
    """Where and how an object was lost.

    Parameters
    ----------
    step : int
        Index of the plan's step, from 0.
    kind : StepKind
        What the step does.
    time_s : float
        Since the fingers began to move [s].
    what : str
        What happened.
    """

    step: int
    kind: StepKind
    time_s: float
    what: str

    def __str__(self) -> str:
        """Return one sentence."""
        return f'step {self.step} ({self.kind.value}), {self.time_s:.2f} s: {self.what}'


@dataclass(frozen=True)
class Verdict:
    """How a plan went.

    Parameters
    ----------
    lost_at : Loss or None
        Where the run ended too early; None: the object was held to the end.
    final_error_deg, final_error_um : float
        Where the object is, beside where the plan has it, at the end [deg, µm]; after a loss,
        when it was noticed.
    max_error_deg : float
        Largest such angle during the run [deg].
    max_friction_use : float
        Largest ``|f_t| / (µ (f_n + f_po))`` of a finger that holds, with the true µ and f_po:
        from 1 on it slips.
    max_force_uN : float
        Largest normal force of a finger [µN].
    tip_gap_um : float
        Smallest free distance between two tips [µm]; negative: they overlapped.
    duration_s : float
        Of the motion [s].
    wall_s : float
        Of the simulation [s].
    """

    lost_at: Loss | None
    final_error_deg: float
    final_error_um: float
    max_error_deg: float
    max_friction_use: float
    max_force_uN: float
    tip_gap_um: float
    duration_s: float
    wall_s: float

    @property
    def held(self) -> bool:
        """True: the object was held to the end."""
        return self.lost_at is None
