# SPDX-License-Identifier: Apache-2.0
"""A plan before its judge: whether the object stays in the fingers, and where it ends."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable

import numpy as np

from microhand_planner.core.errors import InvalidPlan
from microhand_planner.core.motions import Touch, motions
from microhand_planner.core.part import Part
from microhand_planner.core.plan import FINGERS, Plan, StepKind
from microhand_planner.core.trajectory import Pace
from microhand_twin.execution import BoolArray, Execution, Instant
from microhand_twin.numerics import Numerics
from microhand_twin.simulation import Simulation
from microhand_twin.true_station import TrueStation
from microhand_twin.verdict import Loss, Verdict
from microhand_twin.world import World, build_world

OBJECT_LOST = 306
"""As in ``ErrorCode.msg``."""

LARGEST_ERROR_DEG = 5.0
LARGEST_ERROR_UM = 2.0
"""An object that is farther from where the plan has it is lost: nobody leads it any more."""
FEWEST_FINGERS = 2
LARGEST_OVERLAP_UM = 0.3
"""Tips that overlap by more have run into each other [µm]; placement errors explain less."""

_SETTLE_S = 0.05
_NUMERICS = Numerics(time_unit_s=0.02)  # no steps are left out, so half as many do

Watch = Callable[[Simulation, Instant, float], None]
"""Is shown each setpoint: the simulation, the instant, and the share of the run that is done."""


def verify(
    plan: Plan,
    part: Part,
    station: TrueStation | None = None,
    *,
    rng: np.random.Generator | None = None,
    pace: Pace | None = None,
    touch: Touch | None = None,
    world: World | None = None,
    watch: Watch | None = None,
) -> Verdict:
    """Run a plan in the simulation.

    The object is lost if it is more than 5° or 2 µm from where the plan has it, if fewer than two
    fingers touch it, if a finger that holds it by the plan does not touch it, if a finger that
    comes to it meets nothing, or if two tips run into each other.

    Parameters
    ----------
    plan : Plan
        The plan.
    part : Part
        Its object.
    station : TrueStation
        What fingers and contacts are really like; by default as the plan assumes.
    rng : numpy.random.Generator
        Draws placement errors; by default seeded with 0.
    pace, touch : Pace, Touch
        How the plan is executed.
    world : World
        Of that object and station, if it is at hand already.
    watch : callable
        Is shown each setpoint.

    Raises
    ------
    InvalidPlan
        It was made for another object, or has no steps.
    RunFailed
        The engine found no solution.
    """
    began_s = time.perf_counter()
    if plan.object_sha256 != part.sha256:
        raise InvalidPlan(
            'object', f'{part.name} ({part.sha256[:12]}…)',
            f'{plan.object_name} ({plan.object_sha256[:12]}…), for which the plan was made',
        )  # fmt: skip
    station = station or TrueStation(law=plan.law)
    led = motions(plan, pace or Pace(), station.stiffness_uN_per_um, touch or Touch())
    simulation = Simulation(
        world
        or build_world(
            part,
            law=station.law,
            finger_radius_um=plan.finger.radius_um,
            stiffness_uN_per_um=station.stiffness_uN_per_um,
            numerics=_NUMERICS,
        )
    )
    rng = np.random.default_rng(0) if rng is None else rng
    judge = _Judge(plan)
    setpoints = sum(len(motion.trajectory) for motion in led)
    for number, instant in enumerate(Execution(simulation, plan, led, station.placement_um, rng)):
        if watch is not None:
            watch(simulation, instant, (number + 1) / setpoints)
        judge.look(simulation, instant)
        if judge.lost_at is not None:
            break
    else:
        simulation.advance(simulation.command_um, _SETTLE_S)
        judge.measure(simulation, instant)
    return judge.verdict(simulation.time_s, time.perf_counter() - began_s)


class _Judge:
    """Watches a run, and keeps what the verdict needs."""

    def __init__(self, plan: Plan) -> None:
        self._steps = plan.steps
        self._radius_um = plan.finger.radius_um
        self.lost_at: Loss | None = None
        self._error_deg = 0.0
        self._error_um = 0.0
        self._max_error_deg = 0.0
        self._max_friction_use = 0.0
        self._max_force_uN = 0.0
        self._tip_gap_um = math.inf

    def look(self, simulation: Simulation, instant: Instant) -> None:
        """Look at an instant; sets `lost_at` if the object is lost there."""
        self.measure(simulation, instant)
        what = self._fault(instant)
        if what:
            step = self._steps[instant.step]
            self.lost_at = Loss(instant.step, step.kind, instant.time_s, what)

    def measure(self, simulation: Simulation, instant: Instant) -> None:
        """Measure errors, forces and distances."""
        tips_um = simulation.tip_um
        for one, other in itertools.combinations(range(FINGERS), 2):
            gap_um = float(np.linalg.norm(tips_um[one] - tips_um[other])) - 2.0 * self._radius_um
            self._tip_gap_um = min(self._tip_gap_um, gap_um)
        if not instant.released:
            return
        turned = instant.rotation.inv() * simulation.object_rotation
        self._error_deg = math.degrees(turned.magnitude())
        self._error_um = float(np.linalg.norm(simulation.object_position_um - instant.position_um))
        self._max_error_deg = max(self._max_error_deg, self._error_deg)
        contacts = instant.contacts
        self._max_force_uN = max(self._max_force_uN, float(contacts.normal_uN.max()))
        holding = self._holding(instant)
        if np.any(holding):
            use = float(contacts.friction_use[holding].max())
            self._max_friction_use = max(self._max_friction_use, use)

    def _holding(self, instant: Instant) -> BoolArray:
        """Return which fingers hold the object by the plan.

        Once the grip is ramped for a removal, the finger that goes does not hold any more.
        """
        step = self._steps[instant.step]
        holding = np.array(step.in_contact)
        following = self._steps[instant.step + 1 : instant.step + 2]
        if step.kind is StepKind.GRIP and following and following[0].kind is StepKind.REMOVE:
            holding[following[0].finger - 1] = False
        return holding

    def _fault(self, instant: Instant) -> str:
        """Say what is wrong at an instant; empty: nothing."""
        if instant.missed:
            return f'{_fingers(instant.missed)} met nothing'
        if self._tip_gap_um < -LARGEST_OVERLAP_UM:
            return f'two tips ran into each other, by {-self._tip_gap_um:.2f} µm'
        if not instant.released:
            return ''
        touching = instant.contacts.touching
        away = np.flatnonzero(self._holding(instant) & ~touching) + 1
        if len(away):
            return f'{_fingers(tuple(away.tolist()))} lost contact'
        if np.count_nonzero(touching) < FEWEST_FINGERS:
            return f'{np.count_nonzero(touching)} of {FEWEST_FINGERS} fingers touch the object'
        if self._error_deg > LARGEST_ERROR_DEG:
            return f'the object is {self._error_deg:.1f}° from where the plan has it'
        if self._error_um > LARGEST_ERROR_UM:
            return f'the object is {self._error_um:.1f} µm from where the plan has it'
        return ''

    def verdict(self, duration_s: float, wall_s: float) -> Verdict:
        """Return the verdict."""
        return Verdict(
            lost_at=self.lost_at,
            final_error_deg=self._error_deg,
            final_error_um=self._error_um,
            max_error_deg=self._max_error_deg,
            max_friction_use=self._max_friction_use,
            max_force_uN=self._max_force_uN,
            tip_gap_um=self._tip_gap_um,
            duration_s=duration_s,
            wall_s=wall_s,
        )


def _fingers(numbers: tuple[int, ...]) -> str:
    """Return fingers in words."""
    names = ' and '.join(map(str, numbers))
    return f'{"fingers" if len(numbers) > 1 else "finger"} {names}'
