# SPDX-License-Identifier: Apache-2.0
"""The mesh of the object in the twin: drawn if nobody here knows its file."""

from __future__ import annotations

import numpy as np
import trimesh
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.task import Future
from visualization_msgs.msg import MarkerArray

from microhand_node.qos import LATCHED
from microhand_planner.core.pose import FloatArray
from microhand_planner.ros.conversions import um_from_m
from microhand_station.view.figures import Figure, figure_of_mesh

SCALE = 'display_scale'
"""Parameter of the twin: its markers are enlarged by it, and only it knows by how much."""


class TwinMesh:
    """Keeps what the twin shows of its object.

    Parameters
    ----------
    node : Node
        Spun by another thread.
    """

    def __init__(self, node: Node) -> None:
        self._parameters = node.create_client(GetParameters, 'twin/get_parameters')
        self._shown: MarkerArray | None = None
        self._figure: Figure | None = None
        self._scale = 0.0
        node.create_subscription(MarkerArray, 'twin/object_marker', self._keep, LATCHED)

    def figure(self) -> Figure | None:
        """Return how the object in the twin is drawn; None: it is not known yet."""
        shown = self._shown
        if self._figure is None and shown is not None and self._scale > 0.0:
            corners_um = um_from_m([(p.x, p.y, p.z) for p in shown.markers[0].points])
            self._figure = figure_of_corners(corners_um / self._scale)
        return self._figure

    def _keep(self, message: MarkerArray) -> None:
        """Keep the marker of an object, and ask for its scale."""
        self._figure, self._scale = None, 0.0
        self._shown = message if message.markers and message.markers[0].points else None
        if self._parameters.service_is_ready():
            answer = self._parameters.call_async(GetParameters.Request(names=[SCALE]))
            answer.add_done_callback(self._take_scale)

    def _take_scale(self, answer: Future) -> None:
        values = answer.result().values
        self._scale = values[0].double_value if values else 0.0


def figure_of_corners(corners_um: FloatArray) -> Figure:
    """Return how triangles are drawn that are given corner by corner, (3 m, 3) [µm]."""
    faces = np.arange(len(corners_um)).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners_um, faces, process=True)  # equal corners become one
    return figure_of_mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))
