# SPDX-License-Identifier: Apache-2.0
"""A run on film: what is to be drawn of it, and when."""

from __future__ import annotations

import math
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from microhand_planner.core.errors import BadRequest
from microhand_planner.core.plan import Plan
from microhand_twin.execution import Instant
from microhand_twin.pictures import Camera, Film, write_picture
from microhand_twin.simulation import Simulation

_TO_REST = 25  # frames of the end, so that it can be seen


class DrawnRun:
    """Draws a run while it is watched. A context manager: at its end the files are complete.

    Parameters
    ----------
    plan : Plan
        What is run.
    video, picture : Path or None
        Where a film of the run, and a picture of its end, are written; None: not at all.

    Raises
    ------
    BadRequest
        A folder is missing.
    """

    def __init__(self, plan: Plan, video: Path | None, picture: Path | None) -> None:
        for field, path in (('video', video), ('picture', picture)):
            if path is not None and not path.absolute().parent.is_dir():
                raise BadRequest(field, path, 'a file in a folder that exists')
        self._plan = plan
        self._picture = picture
        self._video = video
        self._open = ExitStack()
        self._camera: Camera | None = None
        self._film: Film | None = None
        self._last: tuple[Simulation, Instant] | None = None

    def __enter__(self) -> DrawnRun:
        """Begin."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Draw how it ended, and finish the files."""
        with self._open:
            if error is None and self._last is not None and self._camera is not None:
                simulation, instant = self._last
                image = self._camera.picture(simulation, self._caption(simulation, instant))
                if self._picture is not None:
                    write_picture(image, self._picture)
                if self._film is not None:
                    for _ in range(_TO_REST):
                        self._film.add(image)

    def watch(self, simulation: Simulation, instant: Instant) -> None:
        """Draw an instant, if a frame is due."""
        if self._video is None and self._picture is None:
            return
        self._last = simulation, instant
        if self._camera is None:
            self._camera = self._open.enter_context(Camera(simulation))
            if self._video is not None:
                self._film = self._open.enter_context(Film(self._video))
        if self._film is not None and self._film.is_due(instant.time_s):
            caption = self._caption(simulation, instant)
            self._film.add(self._camera.picture(simulation, caption))

    def _caption(self, simulation: Simulation, instant: Instant) -> str:
        """Say what is seen."""
        turned = instant.rotation.inv() * simulation.object_rotation
        kind = self._plan.steps[instant.step].kind.value
        return (
            f'{instant.time_s:6.2f} s   {kind} ({instant.step + 1} of {len(self._plan.steps)})   '
            f'{math.degrees(turned.magnitude()):.2f} deg off the plan'
        )
