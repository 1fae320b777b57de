# SPDX-License-Identifier: Apache-2.0
"""The scene of the page: object, tips, forces and planned ways. One unit is 1 µm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from viser import ArrowsHandle, FrameHandle, IcosphereHandle, MeshHandle, SceneApi

from microhand_planner.core.parameters import Finger
from microhand_planner.core.plan import FINGERS, Plan
from microhand_planner.core.pose import FloatArray, Pose
from microhand_station.view.figures import Figure, force_arrow, tip_ways
from microhand_station.view.snapshot import Contact, Snapshot, Thing
from microhand_station.view.status_text import FINGER_COLORS

Color = tuple[int, int, int]

OBJECT_COLOR: Color = (128, 160, 196)
LOST_COLOR: Color = (214, 64, 64)
GHOST_COLOR: Color = (90, 160, 90)
GHOST_OPACITY = 0.2
START_OPACITY = 0.6
TIP_OPACITY = 0.62
AXES_UM, AXIS_RADIUS_UM = 26.0, 0.22
SHAFT_RADIUS_UM, HEAD_RADIUS_UM, HEAD_UM = 0.55, 1.3, 3.0
WAY_PIXELS = 2.0
GRID_UM, CELL_UM, SECTION_UM, GRID_BELOW_UM = 400.0, 10.0, 50.0, -48.0
SKY_COLOR: Color = (255, 255, 255)
GROUND_COLOR: Color = (150, 156, 166)
SKY_INTENSITY = 2.0
CELL_COLOR: Color = (232, 235, 238)
SECTION_COLOR: Color = (206, 212, 218)
CAMERA_UM = (72.0, -122.0, 72.0)

Figures = Callable[[str], Figure | None]


class StationScene:
    """Shows the station in the scene that all browsers share.

    Parameters
    ----------
    scene : SceneApi
        Of the server.
    figure : callable
        Returns the figure of a part by its hash; None: not known (yet).
    """

    def __init__(self, scene: SceneApi, figure: Figures) -> None:
        self._scene = scene
        self._figure = figure
        self._drawn_object = ''
        self._body: MeshHandle | None = None
        self._ways = PlannedWays(scene, '/planned')
        self._planned: Plan | None = None
        # plain light: computers without a GPU shall be able to draw it, too
        scene.configure_default_lights(cast_shadow=False)
        scene.configure_environment_map(None)
        scene.add_light_hemisphere(
            '/sky',
            sky_color=SKY_COLOR,
            ground_color=GROUND_COLOR,
            intensity=SKY_INTENSITY,
            position=(0.0, 0.0, 1.0),  # where it comes from
        )
        scene.add_grid(
            '/grid',
            width=GRID_UM,
            height=GRID_UM,
            cell_size=CELL_UM,
            section_size=SECTION_UM,
            cell_color=CELL_COLOR,
            section_color=SECTION_COLOR,
            fade_distance=2.0 * GRID_UM,
            position=(0.0, 0.0, GRID_BELOW_UM),
        )
        self._object: FrameHandle = scene.add_frame(
            '/object', axes_length=AXES_UM, axes_radius=AXIS_RADIUS_UM, visible=False
        )
        self._tips = [_add_tip(scene, finger) for finger in range(FINGERS)]
        self._arrows = [_add_arrow(scene, finger) for finger in range(FINGERS)]

    def show(self, snapshot: Snapshot) -> None:
        """Show the station as it is now."""
        self._show_object(snapshot.thing, snapshot.plan)
        tip_um = snapshot.tip_um
        finger = Finger() if snapshot.plan is None else snapshot.plan.finger
        for tip, at_um in zip(self._tips, tip_um, strict=True):
            known = bool(np.all(np.isfinite(at_um)))
            tip.visible = known
            if known:
                tip.position = at_um
                tip.radius = finger.radius_um
        contacts = () if snapshot.thing is None else snapshot.thing.contacts
        for number, arrow in enumerate(self._arrows):
            _point_arrow(arrow, contacts[number] if contacts else None)
        planned = snapshot.plan if snapshot.running else None
        if planned is not self._planned:
            self._planned = planned
            if planned is None:
                self._ways.clear()
            else:
                self._ways.show(planned, self._figure(planned.object_sha256))

    def _show_object(self, thing: Thing | None, plan: Plan | None) -> None:
        """Draw the object, once; then move it."""
        self._object.visible = thing is not None
        if thing is None:
            return
        self._object.position = np.asarray(thing.pose.position_um)
        self._object.wxyz = np.asarray(thing.pose.quaternion_wxyz)
        sha256 = '' if plan is None else plan.object_sha256
        if sha256 != self._drawn_object:
            figure = self._figure(sha256)
            if figure is not None:
                self._drawn_object = sha256
                self._body = _add_figure(self._scene, '/object/body', figure, OBJECT_COLOR)
        if self._body is not None:
            self._body.color = OBJECT_COLOR if thing.held else LOST_COLOR


class PlannedWays:
    """The ways of the tips through a plan, and where the object shall be at its end.

    Parameters
    ----------
    scene : SceneApi
        Of the server, or of one browser.
    name : str
        Of the node that holds it all.
    """

    def __init__(self, scene: SceneApi, name: str) -> None:
        self._scene = scene
        self._name = name
        self._root: FrameHandle | None = None

    def show(self, plan: Plan, figure: Figure | None, start: Pose | None = None) -> None:
        """Show a plan instead of what is shown.

        Parameters
        ----------
        plan : Plan
            Its ways.
        figure : Figure or None
            Of its object.
        start : Pose, optional
            Where to draw the object too.
        """
        self.clear()
        self._root = self._scene.add_frame(self._name, show_axes=False)
        for finger, way in enumerate(tip_ways(plan)):
            if len(way):
                self._scene.add_line_segments(
                    f'{self._name}/way_{finger + 1}',
                    way,
                    _rgb(finger),
                    thickness=WAY_PIXELS,
                    thickness_units='screen',
                )
        if figure is not None:
            self._add_body('goal', figure, plan.goal, GHOST_COLOR, GHOST_OPACITY)
            if start is not None:
                self._add_body('start', figure, start, OBJECT_COLOR, START_OPACITY)

    def clear(self) -> None:
        """Show nothing."""
        if self._root is not None:
            self._root.remove()
            self._root = None

    def _add_body(
        self, name: str, figure: Figure, pose: Pose, color: Color, opacity: float
    ) -> None:
        self._scene.add_mesh_simple(
            f'{self._name}/{name}',
            figure.vertices_um,
            figure.faces,
            color=color,
            opacity=opacity,
            position=np.asarray(pose.position_um),
            wxyz=np.asarray(pose.quaternion_wxyz),
        )


def _add_figure(scene: SceneApi, name: str, figure: Figure, color: Color) -> MeshHandle:
    return scene.add_mesh_simple(name, figure.vertices_um, figure.faces, color=color)


def _add_tip(scene: SceneApi, finger: int) -> IcosphereHandle:
    """Add the tip of a finger, from 0, with its number."""
    name = f'/tips/{finger + 1}'
    tip = scene.add_icosphere(
        name, Finger().radius_um, _rgb(finger), opacity=TIP_OPACITY, visible=False
    )
    scene.add_label(f'{name}/number', str(finger + 1), anchor='center-center')
    return tip


def _add_arrow(scene: SceneApi, finger: int) -> ArrowsHandle:
    """Add the force of a finger, from 0."""
    return scene.add_arrows(
        f'/forces/{finger + 1}',
        np.zeros((1, 2, 3)),
        _rgb(finger),
        shaft_radius=SHAFT_RADIUS_UM,
        head_radius=HEAD_RADIUS_UM,
        head_length=HEAD_UM,
        visible=False,
    )


def _point_arrow(arrow: ArrowsHandle, contact: Contact | None) -> None:
    """Show a force; nothing where there is none."""
    ends: FloatArray | None = None
    if contact is not None and contact.touching:
        ends = force_arrow(contact)
    shown = ends is not None and bool(np.all(np.isfinite(ends)))
    arrow.visible = shown
    if ends is not None and shown:
        arrow.points = ends[None].astype(np.float32)


def _rgb(finger: int) -> Color:
    """Return the colour of a finger, from 0, as in the table of fingers."""
    text = FINGER_COLORS[finger]
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)
