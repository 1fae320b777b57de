# SPDX-License-Identifier: Apache-2.0
"""Objects that can be asked for, and how those that were seen before are drawn."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import cast

from microhand_msgs_py.msg import ObjectInfo
from microhand_msgs_py.srv import ListObjects
from rclpy.node import Node

from microhand_planner.core.errors import BadRequest, RunFailed
from microhand_planner.core.part import Frame, Part, load_part
from microhand_planner.ros.conversions import UM_PER_M
from microhand_station.service_call import call
from microhand_station.view.figures import Figure, figure_of

CATALOGUE_S = 3.0
"""Longest wait for the planner to say which objects it knows [s]."""
KEPT_FIGURES = 16


class PartStore:
    """Reads objects as the planner does, and keeps the figures of the last few.

    Parameters
    ----------
    node : Node
        Spun by another thread.
    """

    def __init__(self, node: Node) -> None:
        self._client = node.create_client(ListObjects, 'planner/list_objects')
        self._lock = threading.Lock()
        self._catalogue: dict[str, ObjectInfo] = {}
        self._figures: dict[str, Figure] = {}

    def names(self) -> tuple[str, ...]:
        """Ask the planner which objects it knows; if it does not answer, those that it knew."""
        try:
            answer = call(
                self._client,
                ListObjects.Request(),
                deadline_s=CATALOGUE_S,
                who='the planner',
                missing_code=RunFailed.code,
            )
        except RunFailed:
            return tuple(self._catalogue)
        if not answer.error_code:
            self._catalogue = {entry.name: entry for entry in answer.objects}
        return tuple(self._catalogue)

    def load(self, name: str, unit_um: float) -> Part:
        """Read an object.

        Parameters
        ----------
        name : str
            In the catalogue, or the path of a mesh file.
        unit_um : float
            Length of one unit of the file [µm]; 0: the catalogue's, or 1 µm.

        Raises
        ------
        BadRequest
            There is no such object, or it is none that can be handled.
        """
        if not name:
            raise BadRequest('object', 'empty', 'a name of the catalogue, or a mesh file')
        entry = self._catalogue.get(name)
        if entry is None:
            part = load_part(name, unit_um=unit_um or 1.0)
        else:
            part = load_part(
                Path(entry.mesh_file),
                unit_um=unit_um or entry.unit * UM_PER_M,
                frame=cast('Frame', entry.frame),
                name=name,
            )
        self._keep(part)
        return part

    def figure(self, sha256: str) -> Figure | None:
        """Return how a part is drawn; None: it has not been seen, and is not in the catalogue."""
        with self._lock:
            if sha256 in self._figures:
                return self._figures[sha256]
        for entry in list(self._catalogue.values()):
            if entry.object_hash == sha256:
                try:
                    self.load(entry.name, 0.0)
                except BadRequest:
                    return None
                return self._figures.get(sha256)
        return None

    def _keep(self, part: Part) -> None:
        figure = figure_of(part)
        with self._lock:
            while len(self._figures) >= KEPT_FIGURES:
                self._figures.pop(next(iter(self._figures)))
            self._figures[part.sha256] = figure
