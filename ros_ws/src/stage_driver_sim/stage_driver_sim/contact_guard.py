# SPDX-License-Identifier: Apache-2.0
"""Contact as it is reported → whether a guarded stream ends now, and where the stage touched.

Reports come from elsewhere, some tens of milliseconds late, with the time to which they refer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stage_driver_sim.errors import ContactSilent, InvalidNumber
from stage_driver_sim.position_history import PositionHistory
from stage_driver_sim.protocol import Vector

SILENCE_S = 1.0
"""Reports older than this guard nothing: a guarded stage must not move blindly."""


@dataclass(frozen=True)
class ContactReport:
    """Whether the tip touched something: the content of ``TipContact.msg``.

    Parameters
    ----------
    time_s : float
        Time to which it refers [s], on the driver's clock.
    in_contact : bool
        The tip touched.
    """

    time_s: float
    in_contact: bool

    def __post_init__(self) -> None:
        """Check the time."""
        if not math.isfinite(self.time_s):
            raise InvalidNumber(f'time_s is {self.time_s}; allowed: a finite number')


class ContactGuard:
    """The latest report, and the positions that it may ask for."""

    def __init__(self) -> None:
        self._history = PositionHistory()
        self._latest: ContactReport | None = None

    def note(self, report: ContactReport) -> None:
        """Take in a report, unless a later one is known."""
        known = self._latest
        if known is None or report.time_s >= known.time_s:
            # Of a contact that lasts, the first report says where it began.
            if known is None or not (known.in_contact and report.in_contact):
                self._latest = report

    def remember(self, time_s: float, position_um: Vector) -> None:
        """Keep a measured position [µm]."""
        self._history.add(time_s, position_um)

    def contact_um(self, begin_s: float, now_s: float) -> Vector | None:
        """Return where a guarded stream met something [µm], stage frame; None: it did not.

        A contact from before the stream counts if no later report has ended it; the stream then
        ends where it begins.

        Parameters
        ----------
        begin_s : float
            Time of the stream's first setpoint [s].
        now_s : float
            Present time [s].

        Raises
        ------
        ContactSilent
            The latest report is too old to rely on.
        """
        if self._latest is None:
            raise ContactSilent('nobody reports contacts; a guarded stream needs the reports')
        if self._latest.in_contact:
            return self._history.at(max(self._latest.time_s, begin_s))
        silent_s = now_s - self._latest.time_s
        if silent_s > SILENCE_S:
            raise ContactSilent(
                f'the latest contact report is {silent_s:.2f} s old; '
                f'allowed in a guarded stream: up to {SILENCE_S:g} s'
            )
        return None
