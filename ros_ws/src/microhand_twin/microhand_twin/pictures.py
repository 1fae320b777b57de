# SPDX-License-Identifier: Apache-2.0
"""Pictures and films of a run, drawn without a screen."""

from __future__ import annotations

import ctypes.util
import importlib
import os
import struct
import zlib
from pathlib import Path
from types import TracebackType
from typing import Any

import imageio_ffmpeg
import mujoco
import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.errors import RunFailed
from microhand_twin.appearance import FORCE_RGBA
from microhand_twin.numerics import LENGTH_UNIT_UM
from microhand_twin.simulation import Simulation

Image = NDArray[np.uint8]

WIDTH, HEIGHT = 960, 720
FRAMES_PER_S = 25

_MOST_GEOMS = 100
_ARROW_UM_PER_UN = 2.0
_ARROW_WIDTH_UM = 0.6
_SHORTEST_ARROW_UN = 0.02
_AWAY = 3.9  # distance of the camera over the size of what it looks at
_LIBRARIES = {'osmesa': 'OSMesa', 'egl': 'EGL'}


class Camera:
    """Looks at a simulation. A context manager: it holds a drawing context.

    Parameters
    ----------
    simulation : Simulation
        What to look at: the object's place at this time is in the middle of the picture.

    Raises
    ------
    RunFailed
        The machine has no library that draws without a screen; says what to install.
    """

    def __init__(self, simulation: Simulation) -> None:
        world = simulation.world
        self._model = world.model
        self._context = _drawing_context()
        self._context.make_current()
        self._drawer = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawer)
        self._scene = mujoco.MjvScene(self._model, _MOST_GEOMS)
        self._options = mujoco.MjvOption()
        self._view = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(self._model, self._view)
        self._view.lookat[:] = simulation.object_position_um / LENGTH_UNIT_UM
        part_um = np.linalg.norm(world.part.vertices_um, axis=1).max()
        reach_um = part_um + 3.0 * world.finger_radius_um
        self._view.distance = _AWAY * reach_um / LENGTH_UNIT_UM

    def __enter__(self) -> Camera:
        """Return the camera."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Free the drawing context."""
        self._drawer.free()
        self._context.free()

    def picture(self, simulation: Simulation, caption: str = '') -> Image:
        """Draw the simulation as it is now.

        Parameters
        ----------
        simulation : Simulation
            The one that the camera was made for.
        caption : str
            Written into the lower left corner.

        Returns
        -------
        (HEIGHT, WIDTH, 3) uint8
        """
        simulation.draw_into(self._scene, self._options, self._view)
        self._add_forces(simulation)
        area = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        mujoco.mjr_render(area, self._scene, self._drawer)
        if caption:
            mujoco.mjr_overlay(
                mujoco.mjtFont.mjFONT_NORMAL,
                mujoco.mjtGridPos.mjGRID_BOTTOMLEFT,
                area,
                caption,
                '',
                self._drawer,
            )
        image: Image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(image, None, area, self._drawer)
        return np.ascontiguousarray(image[::-1])

    def _add_forces(self, simulation: Simulation) -> None:
        """Add an arrow behind each tip that holds the object: 2 µm for a force of 1 µN."""
        radius_um = simulation.world.finger_radius_um
        for tip_um, force_uN in zip(
            simulation.tip_um, simulation.contacts().force_uN, strict=True
        ):
            strength_uN = float(np.linalg.norm(force_uN))
            if strength_uN < _SHORTEST_ARROW_UN:
                continue
            end_um = tip_um - radius_um * force_uN / strength_uN
            start_um = end_um - _ARROW_UM_PER_UN * force_uN
            arrow = self._scene.geoms[self._scene.ngeom]
            self._scene.ngeom += 1
            kind = mujoco.mjtGeom.mjGEOM_ARROW
            mujoco.mjv_initGeom(
                arrow, kind, np.zeros(3), np.zeros(3), np.zeros(9), np.array(FORCE_RGBA, 'f4')
            )
            mujoco.mjv_connector(
                arrow,
                kind,
                _ARROW_WIDTH_UM / LENGTH_UNIT_UM,
                start_um / LENGTH_UNIT_UM,
                (2.0 * end_um - start_um) / LENGTH_UNIT_UM,  # arrows are drawn half as long
            )


class Film:
    """A film file. A context manager.

    Parameters
    ----------
    path : Path
        Where it is written; the ending decides the format, ``.mp4`` for one that plays anywhere.

    Raises
    ------
    RunFailed
        It cannot be written there.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._due_s = 0.0
        self._writer = imageio_ffmpeg.write_frames(
            str(path), (WIDTH, HEIGHT), fps=FRAMES_PER_S, quality=8, ffmpeg_log_level='error'
        )

    def __enter__(self) -> Film:
        """Open the file."""
        self._writer.send(None)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the file."""
        self._writer.close()

    def is_due(self, time_s: float) -> bool:
        """Return whether the next frame is to be taken at a time [s] or before."""
        return time_s >= self._due_s

    def add(self, image: Image) -> None:
        """Append a frame, which the film shows for 1/25 s."""
        try:
            self._writer.send(image)
        except OSError as error:
            raise RunFailed(f'{self._path} cannot be written: {error}') from error
        self._due_s += 1.0 / FRAMES_PER_S


def write_picture(image: Image, path: Path) -> None:
    """Write a picture as a PNG file.

    Raises
    ------
    RunFailed
        It cannot be written there.
    """
    height, width = image.shape[:2]
    rows = np.hstack([np.zeros((height, 1), dtype=np.uint8), image.reshape(height, -1)])
    header = struct.pack('>IIBBBBB', width, height, 8, 2, 0, 0, 0)
    chunks = ((b'IHDR', header), (b'IDAT', zlib.compress(rows.tobytes())), (b'IEND', b''))
    content = b'\x89PNG\r\n\x1a\n' + b''.join(
        struct.pack('>I', len(data)) + kind + data + struct.pack('>I', zlib.crc32(kind + data))
        for kind, data in chunks
    )
    try:
        path.write_bytes(content)
    except OSError as error:
        raise RunFailed(f'{path} cannot be written: {error.strerror}') from error


def _drawing_context() -> Any:
    """Return a context to draw in without a screen."""
    wanted = os.environ.get('MUJOCO_GL', '').lower()
    found = [
        kind
        for kind, library in _LIBRARIES.items()
        if wanted in ('', kind) and ctypes.util.find_library(library)
    ]
    if not found:
        raise RunFailed(
            'no library draws without a screen here; install OSMesa (Debian, Ubuntu: libosmesa6)'
        )
    os.environ.setdefault('PYOPENGL_PLATFORM', found[0])  # PyOpenGL decides when it is imported
    try:
        return importlib.import_module(f'mujoco.{found[0]}').GLContext(WIDTH, HEIGHT)
    except Exception as error:  # each library has errors of its own
        raise RunFailed(
            f'{_LIBRARIES[found[0]]} cannot draw here ({error}); '
            'install OSMesa (Debian, Ubuntu: libosmesa6)'
        ) from error
