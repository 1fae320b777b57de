# SPDX-License-Identifier: Apache-2.0
"""The station at one moment, as the page shows it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from microhand_planner.core.plan import FINGERS, Plan
from microhand_planner.core.pose import FloatArray, Pose
from microhand_station.sequencer.progress import Progress
from microhand_station.sequencer.stage_watch import Mode
from microhand_station.sequencer.states import State

FEWEST_FINGERS = 2
"""Fewer fingers than these do not hold an object."""


@dataclass(frozen=True)
class Stage:
    """One finger's stage.

    Parameters
    ----------
    mode : Mode
        What it does.
    on_target : bool
        Within the window around its command, for the dwell time.
    error : str
        What its driver says is wrong; empty: nothing.
    tip_um : (3,) float
        Where the tip would be without a force on it, station frame [µm].
    lag_um : float
        Between command and measured position [µm].
    """

    mode: Mode
    on_target: bool
    error: str
    tip_um: FloatArray
    lag_um: float


@dataclass(frozen=True)
class Contact:
    """What one finger does to the object.

    Parameters
    ----------
    touching : bool
        Whether it does anything.
    point_um : (3,) float
        Where, station frame [µm]; NaN: nowhere.
    force_uN : (3,) float
        On the object, station frame [µN].
    normal_uN : float
        > 0 pushes, < 0 pulls [µN].
    friction_use : float
        1: slips; NaN: does not touch.
    """

    touching: bool
    point_um: FloatArray
    force_uN: FloatArray
    normal_uN: float
    friction_use: float


@dataclass(frozen=True)
class Thing:
    """The object between the fingers.

    Parameters
    ----------
    pose : Pose
        Station frame.
    held, released : bool
        Not lost; and left to the fingers, no longer fixed where it was put.
    lost_because : str
        Empty while it is held.
    contacts : tuple of 3 Contact
        Of fingers 1, 2, 3; empty: forces are not known.
    """

    pose: Pose
    held: bool
    released: bool
    lost_because: str
    contacts: tuple[Contact, ...]


@dataclass(frozen=True)
class Note:
    """Something worth remembering.

    Parameters
    ----------
    time_s : float
        When, seconds since 1970.
    source : str
        Node that said it.
    code : int
        See ErrorCode; 0: not an error.
    text : str
        One sentence.
    """

    time_s: float
    source: str
    code: int
    text: str


@dataclass(frozen=True)
class Snapshot:
    """All that is known of the station now.

    Parameters
    ----------
    state : State or None
        Of the sequencer; None: it is not there.
    progress : Progress
        Of its run.
    stages : tuple of 3 (Stage or None)
        Fingers 1, 2, 3; None: nothing heard of it lately.
    thing : Thing or None
        None: no object, or nobody watches it.
    off_plan : (float, float) or None
        How far the object is from where the plan has it now [rad], [µm]; None: not known.
    plan : Plan or None
        That of the present run, or of the last one.
    notes : tuple of Note
        The latest ones, in their order.
    stiffness_uN_per_um : (3,) float
        Of the fingers.
    """

    state: State | None = None
    progress: Progress = field(default_factory=Progress)
    stages: tuple[Stage | None, ...] = (None,) * FINGERS
    thing: Thing | None = None
    off_plan: tuple[float, float] | None = None
    plan: Plan | None = None
    notes: tuple[Note, ...] = ()
    stiffness_uN_per_um: tuple[float, ...] = (np.inf,) * FINGERS

    @property
    def running(self) -> bool:
        """Whether a plan is being executed."""
        return self.state in (State.STARTING, State.RUNNING, State.PAUSED, State.STOPPING)

    @property
    def tip_um(self) -> FloatArray:
        """Where the tips are, bent by their forces, station frame (3, 3) [µm]; NaN: unknown."""
        tips = np.full((FINGERS, 3), np.nan)
        for finger, stage in enumerate(self.stages):
            if stage is not None:
                tips[finger] = stage.tip_um
        if self.thing is not None:
            for finger, contact in enumerate(self.thing.contacts):
                if contact.touching:
                    tips[finger] -= contact.force_uN / self.stiffness_uN_per_um[finger]
        return tips

    @property
    def grasp_um(self) -> FloatArray | None:
        """Tips that hold the object now, (3, 3) [µm], NaN: free; None: it is not held by them."""
        thing = self.thing
        if thing is None or not (thing.held and thing.released):
            return None
        touching = np.array([contact.touching for contact in thing.contacts], dtype=bool)
        if np.count_nonzero(touching) < FEWEST_FINGERS:
            return None
        return np.where(touching[:, None], self.tip_um, np.nan)
