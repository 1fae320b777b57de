# SPDX-License-Identifier: Apache-2.0
"""A plan's motions in the simulation: what sequencer and stages do in the station."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from microhand_planner.core.motions import Motion
from microhand_planner.core.plan import FINGERS, Plan
from microhand_planner.core.pose import FloatArray
from microhand_twin.contacts import Contacts
from microhand_twin.simulation import Simulation

BoolArray = NDArray[np.bool_]

_SETTLE_S = 0.1


@dataclass(frozen=True)
class Instant:
    """The simulation at one setpoint, and what the plan has there.

    Parameters
    ----------
    step : int
        Index of the plan's step, from 0.
    time_s : float
        Since the fingers began to move [s].
    position_um : (3,) float
        Where the plan has the object, station frame [µm].
    rotation : Rotation
        How the plan has it turned.
    contacts : Contacts
        What the fingers feel.
    released : bool
        False: the object still rests on its support.
    missed : tuple of int
        Fingers, from 1, that should have met the object in the motion that ends here, and did not.
    """

    step: int
    time_s: float
    position_um: FloatArray
    rotation: Rotation
    contacts: Contacts
    released: bool
    missed: tuple[int, ...] = ()


class Execution:
    """Leads the fingers of a simulation along motions, as stages with guarded streams would.

    A guarded finger stops when it touches the object. From then on its commands are shifted by
    where its tip then is, relative to where the plan expected it. The object rests on its
    support until the first grasp is closed.

    Parameters
    ----------
    simulation : Simulation
        Of the plan's object.
    plan : Plan
        The plan that the motions were made from.
    motions : sequence of Motion
        From `microhand_planner.core.motions.motions`.
    placement_um : float
        Standard deviation of where fingers are, in each direction [µm].
    rng : numpy.random.Generator
        Draws these errors, anew for each finger that comes to the object.
    """

    def __init__(
        self,
        simulation: Simulation,
        plan: Plan,
        motions: Sequence[Motion],
        placement_um: float,
        rng: np.random.Generator,
    ) -> None:
        self._simulation = simulation
        self._plan = plan
        self._motions = motions
        self._placement_um = placement_um
        self._rng = rng
        self._error_um = np.zeros((FINGERS, 3))
        self._reference_um = np.zeros((FINGERS, 3))
        self._released = False

    def __iter__(self) -> Iterator[Instant]:
        """Move, setpoint by setpoint."""
        held = np.array(self._plan.steps[0].in_contact)
        self._place(held)
        for number, motion in enumerate(self._motions):
            if np.any(motion.guarded):
                yield from self._guarded(motion)
            else:
                yield from self._plain(motion)
            if not self._released and (np.any(motion.guarded) or number + 1 == len(self._motions)):
                self._release()

    def _place(self, held: BoolArray) -> None:
        """Put the object at the plan's start, and fingers that hold it already around it."""
        start, first = self._plan.start, self._plan.steps[0]
        for finger in range(FINGERS):
            self._draw(finger, off=not held[finger])
        self._simulation.place(start, first.tip_um[0] + self._error_um, fixed=True)
        if np.any(held):
            self._simulation.advance(
                self._command(self._motions[0].trajectory.tip_um[0]), _SETTLE_S
            )
            self._release()

    def _release(self) -> None:
        """Take the support away."""
        self._simulation.release_object()
        self._released = True

    def _draw(self, finger: int, *, off: bool) -> None:
        """Draw how far a finger is from where it is commanded to."""
        self._reference_um[finger] = 0.0
        self._error_um[finger] = 0.0
        if off:
            self._error_um[finger] = self._rng.normal(scale=self._placement_um, size=3)

    def _command(self, tip_um: FloatArray) -> FloatArray:
        """Return where the feet of the springs really are for commanded tips (3, 3)."""
        return tip_um + self._reference_um + self._error_um

    def _plain(self, motion: Motion) -> Iterator[Instant]:
        """Follow a motion to its end."""
        for index in range(len(motion.trajectory)):
            tip_um = motion.trajectory.tip_um[index]
            self._simulation.advance(self._command(tip_um), motion.trajectory.period_s)
            yield self._instant(motion, index)

    def _guarded(self, motion: Motion) -> Iterator[Instant]:
        """Follow a motion until each guarded finger has met the object, or to its end."""
        feeling = [finger for finger in range(FINGERS) if motion.guarded[finger]]
        for finger in feeling:
            self._draw(finger, off=True)
        stopped_um: dict[int, FloatArray] = {}
        for index in range(len(motion.trajectory)):
            command_um = self._command(motion.trajectory.tip_um[index])
            for finger, place_um in stopped_um.items():
                command_um[finger] = place_um
            self._simulation.advance(command_um, motion.trajectory.period_s)
            instant = self._instant(motion, index)
            for finger in feeling:
                if finger not in stopped_um and instant.contacts.touching[finger]:
                    stopped_um[finger] = command_um[finger]
            all_stopped = len(stopped_um) == len(feeling)
            if all_stopped or index + 1 == len(motion.trajectory):
                break
            yield instant
        for finger in stopped_um:
            met_um = self._simulation.tip_um[finger] - self._error_um[finger]
            self._reference_um[finger] = met_um - motion.contact_um[finger]
        missed = tuple(finger + 1 for finger in feeling if finger not in stopped_um)
        yield self._instant(motion, index, missed)

    def _instant(self, motion: Motion, index: int, missed: tuple[int, ...] = ()) -> Instant:
        """Return what is so after a setpoint."""
        trajectory = motion.trajectory
        w, x, y, z = trajectory.object_quaternion_wxyz[index]
        return Instant(
            step=int(trajectory.step_of[index]),
            time_s=self._simulation.time_s,
            position_um=trajectory.object_position_um[index],
            rotation=Rotation.from_quat((x, y, z, w)),
            contacts=self._simulation.contacts(),
            released=self._released,
            missed=missed,
        )
