# SPDX-License-Identifier: Apache-2.0
"""The object between the fingers of a running station: put there, released, held or lost."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import FloatArray, Pose, angle_between_rad, readonly
from microhand_twin.contacts import Contacts
from microhand_twin.simulation import Simulation
from microhand_twin.world import World

NOT_ALLOWED = 308

FEWEST_FINGERS = 2
"""Fewer fingers than these do not hold an object."""
LOST_AFTER_S = 0.05
"""An object that so few fingers touch for longer is lost [s]."""
STEP_UM = 0.0015
"""Fingers that touch the object move no further than this in a step of the engine [µm], ..."""
LEAST_SHARE = 0.2
"""... but at least this share of the steps of a motion in real time is done: all comes to rest."""
IN_THE_WAY_UN = 100.0
"""A tip that an object would press with more than this is where the object is to be [µN]."""
DIVERGED = 'the simulation found no finite forces'
SAME_POSE_RAD = math.radians(2.0)
SAME_POSE_UM = 1.0
"""A plan can go on with an object that is so near to where the plan begins."""


@dataclass(frozen=True)
class ObjectReport:
    """What is to be said about the object at one moment.

    Parameters
    ----------
    pose : Pose
        Station frame.
    released : bool
        False: fixed where it was put.
    lost_because : str
        Empty: it is held, or still fixed.
    contacts : Contacts or None
        What the fingers feel; None: the object is not there yet, a finger is in its place.
    tip_um : (3, 3) float
        Tip centres, station frame [µm].
    """

    pose: Pose
    released: bool
    lost_because: str
    contacts: Contacts | None
    tip_um: FloatArray


class LiveWorld:
    """An object and fingers that are where the stages of a running station are.

    The object is fixed at its start pose, as on a support, until `release`. While a tip is
    where the object is to be, it is not there yet: fingers are moved out of the way first.

    Parameters
    ----------
    world : World
        Object, fingers and how they touch.
    start : Pose
        Where the object is put, station frame.
    holding_um : (3, 3) float
        Contact centres of fingers that hold the object from the beginning, station frame [µm];
        NaN: free.
    """

    def __init__(self, world: World, start: Pose, holding_um: FloatArray) -> None:
        self.world = world
        self._start = start
        self._holding_um = holding_um
        self._simulation = Simulation(world)
        self._followed_s = math.nan
        self._dropped_s = math.nan
        self._in_the_way: list[int] = []
        self.report = ObjectReport(start, False, '', None, self._simulation.tip_um)
        """The object as it is now."""

    def follow(self, command_um: FloatArray, time_s: float) -> None:
        """Let the fingers go evenly to where the stages were at a time.

        Parameters
        ----------
        command_um : (3, 3) float
            Tips if no force bent the fingers, station frame [µm].
        time_s : float
            Later than in the calls before [s].
        """
        if self.report.contacts is None:
            self._try_to_place(command_um, time_s)
            return
        if self.report.lost_because == DIVERGED or time_s <= self._followed_s:
            return
        try:
            self._simulation.advance(command_um, self._quasi_static_s(command_um, time_s))
        except RunFailed:
            self.report = replace(self.report, lost_because=DIVERGED)
        else:
            self._look(time_s)
        self._followed_s = time_s

    def release(self) -> None:
        """Let go of the object: from now on only the fingers hold it.

        Raises
        ------
        RunFailed
            NOT_ALLOWED: it is not there yet, or fewer than two fingers touch it.
        """
        if self.report.contacts is None:
            fingers = ', '.join(map(str, self._in_the_way)) or 'unknown'
            raise RunFailed(f'finger {fingers}: where the object is to be', NOT_ALLOWED)
        touching = np.flatnonzero(self.report.contacts.touching) + 1
        if len(touching) < FEWEST_FINGERS:
            who = f'only finger {touching[0]}' if len(touching) else 'no finger'
            raise RunFailed(
                f'{who} touches the object; allowed: at least {FEWEST_FINGERS}', NOT_ALLOWED
            )
        if not self.report.released:
            self._simulation.release_object()
            self.report = replace(self.report, released=True)

    def holds(self, sha256: str, pose: Pose) -> bool:
        """Return whether this object is held now, near a pose: then a plan can go on with it."""
        report = self.report
        return (
            report.released
            and not report.lost_because
            and self.world.part.sha256 == sha256
            and angle_between_rad(report.pose.rotation, pose.rotation) < SAME_POSE_RAD
            and float(np.linalg.norm(np.subtract(report.pose.position_um, pose.position_um)))
            < SAME_POSE_UM
        )

    def _quasi_static_s(self, command_um: FloatArray, time_s: float) -> float:
        """Return how much time of the engine a motion needs, at most as long as it took.

        Nothing depends on speed as long as forces of inertia are small: what is slow may be done
        in fewer steps, and most of the time it is slow. Fingers in the air do not count.
        """
        all_s = time_s - self._followed_s
        moved_um = np.linalg.norm(command_um - self._simulation.command_um, axis=1)
        touching = self.report.contacts is not None and self.report.contacts.touching
        farthest_um = float(np.where(touching, moved_um, 0.0).max())
        needed_s = farthest_um / STEP_UM * self.world.numerics.step_s
        return min(all_s, max(needed_s, LEAST_SHARE * all_s))

    def _try_to_place(self, command_um: FloatArray, time_s: float) -> None:
        """Put the object where it is to be, unless a tip is there."""
        tips = np.where(np.isnan(self._holding_um), command_um, self._holding_um)
        self._simulation.place(self._start, tips, fixed=True)
        contacts = self._simulation.contacts()
        self._in_the_way = (np.flatnonzero(contacts.normal_uN > IN_THE_WAY_UN) + 1).tolist()
        if not self._in_the_way:
            self._followed_s = time_s
            self.report = ObjectReport(self._start, False, '', contacts, readonly(tips))

    def _look(self, time_s: float) -> None:
        """Report, and notice when the object is lost; it stays lost."""
        contacts = self._simulation.contacts()
        released, lost_because = self.report.released, self.report.lost_because
        if not released or np.count_nonzero(contacts.touching) >= FEWEST_FINGERS:
            self._dropped_s = math.nan
        elif math.isnan(self._dropped_s):
            self._dropped_s = time_s
        elif time_s - self._dropped_s >= LOST_AFTER_S and not lost_because:
            still = np.flatnonzero(contacts.touching) + 1
            lost_because = f'{f"only finger {still[0]}" if len(still) else "no finger"} touches it'
        pose = self._simulation.object_pose
        self.report = ObjectReport(pose, released, lost_because, contacts, self._simulation.tip_um)
