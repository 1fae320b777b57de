# SPDX-License-Identifier: Apache-2.0
"""A simulation: the world, and the state that commands bring it into."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.plan import FINGERS
from microhand_planner.core.pose import FloatArray, Pose, readonly
from microhand_twin.contacts import Contacts, read_contacts
from microhand_twin.numerics import LENGTH_UNIT_UM
from microhand_twin.surface_collision import smooth_contacts
from microhand_twin.world import AXES, World

_OBJECT_POSITION = slice(0, 3)
_OBJECT_QUATERNION = slice(3, 7)
_OBJECT_VELOCITY = slice(0, 6)
_TIPS = slice(7, 7 + AXES)
_SPRINGS = slice(0, 2 * AXES, 2)
_DAMPERS = slice(1, 2 * AXES, 2)
_ADHESION = slice(2 * AXES, None)
_FIXED_MASS = 1e6  # heavier, and the solver stops before the tips are at rest
_FIXED_STEPS = 100  # in so many, no force moves it by more than 0.1 nm


class Simulation:
    """Three fingers and an object that follow commands.

    The object starts free at the origin, the fingers far away: call `place` first.

    Parameters
    ----------
    world : World
        From `build_world`.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self._free = world.model
        self._fixed = _with_heavy_object(world.model)
        self._model = self._free
        self._data = mujoco.MjData(world.model)
        self._resting = self._data.qpos[: _TIPS.start].copy()
        self.place(Pose(), 1e3 * np.eye(FINGERS))

    def place(self, pose: Pose, tip_um: ArrayLike, *, fixed: bool = False) -> None:
        """Put object and tips somewhere, all at rest, commands where the tips are.

        Parameters
        ----------
        pose : Pose
            Of the object, station frame.
        tip_um : (3, 3) float
            Tip centres, station frame [µm].
        fixed : bool
            See `fix_object`.
        """
        mujoco.mj_resetData(self._model, self._data)
        tips = np.asarray(tip_um, dtype=float).reshape(AXES) / LENGTH_UNIT_UM
        self._data.qpos[_OBJECT_POSITION] = np.asarray(pose.position_um) / LENGTH_UNIT_UM
        self._data.qpos[_OBJECT_QUATERNION] = pose.quaternion_wxyz
        self._data.qpos[_TIPS] = tips
        self._data.act[:] = tips
        self._data.ctrl[_ADHESION] = 1.0
        if fixed:
            self.fix_object()
        else:
            self.release_object()

    def fix_object(self) -> None:
        """Hold the object where it is, as if it stuck to its support."""
        self._resting = self._data.qpos[: _TIPS.start].copy()
        self._data.qvel[_OBJECT_VELOCITY] = 0.0
        self._model = self._fixed
        with smooth_contacts(self.world.smooth):
            mujoco.mj_forward(self._model, self._data)

    def release_object(self) -> None:
        """Let go of the object: only the fingers hold it from now on."""
        self._model = self._free
        with smooth_contacts(self.world.smooth):
            mujoco.mj_forward(self._model, self._data)

    def advance(self, command_um: ArrayLike, duration_s: float) -> None:
        """Move the commands evenly from where they are to `command_um`, and the world with them.

        Parameters
        ----------
        command_um : (3, 3) float
            Where the fingers are to be at the end, springs relaxed; station frame [µm].
        duration_s : float
            Rounded to whole steps of the integration, at least one [s].

        Raises
        ------
        RunFailed
            The engine found no finite solution.
        """
        target = np.asarray(command_um, dtype=float).reshape(AXES) / LENGTH_UNIT_UM
        numerics = self.world.numerics
        steps = max(1, round(duration_s / numerics.step_s))
        velocity = (target - self._data.act) / (steps * numerics.time_step)
        self._data.ctrl[_SPRINGS] = velocity
        self._data.ctrl[_DAMPERS] = velocity
        with smooth_contacts(self.world.smooth):
            if self._model is self._fixed:
                self._step_fixed(steps)
            else:
                mujoco.mj_step(self._model, self._data, steps)
        self._data.act[:] = target  # sums of rounding errors are forces, on stiff springs
        if not np.all(np.isfinite(self._data.qpos)):
            raise RunFailed(f'the simulation diverged at {self.time_s:.3f} s')

    def _step_fixed(self, steps: int) -> None:
        """Step with the object put back, again and again, to where it rests."""
        for done in range(0, steps, _FIXED_STEPS):
            mujoco.mj_step(self._model, self._data, min(_FIXED_STEPS, steps - done))
            self._data.qpos[: _TIPS.start] = self._resting
            self._data.qvel[_OBJECT_VELOCITY] = 0.0

    @property
    def time_s(self) -> float:
        """Time since `place` [s]."""
        return float(self._data.time) * self.world.numerics.time_unit_s

    @property
    def object_pose(self) -> Pose:
        """Where the object is, station frame."""
        return Pose(
            self._data.qpos[_OBJECT_POSITION] * LENGTH_UNIT_UM,
            self._data.qpos[_OBJECT_QUATERNION].copy(),
        )

    @property
    def object_position_um(self) -> FloatArray:
        """Origin of the object frame (3,), station frame [µm]."""
        return readonly(self._data.qpos[_OBJECT_POSITION] * LENGTH_UNIT_UM)

    @property
    def object_rotation(self) -> Rotation:
        """Orientation of the object, object frame to station frame."""
        w, x, y, z = self._data.qpos[_OBJECT_QUATERNION]
        return Rotation.from_quat((x, y, z, w))

    @property
    def tip_um(self) -> FloatArray:
        """Tip centres (3, 3), station frame [µm]."""
        return readonly(self._data.qpos[_TIPS].reshape(FINGERS, 3) * LENGTH_UNIT_UM)

    @property
    def command_um(self) -> FloatArray:
        """Commands (3, 3), station frame [µm]."""
        return readonly(self._data.act.reshape(FINGERS, 3) * LENGTH_UNIT_UM)

    def contacts(self) -> Contacts:
        """Return what the fingers feel now, in the last step of the integration."""
        return read_contacts(self._model, self._data, self.world.law)

    def draw_into(
        self, scene: mujoco.MjvScene, options: mujoco.MjvOption, camera: mujoco.MjvCamera
    ) -> None:
        """Update a scene for drawing."""
        parts = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, self._data, options, None, camera, parts, scene)


def _with_heavy_object(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model in which nothing moves the object."""
    heavy = copy.copy(model)
    heavy.body_mass[1] *= _FIXED_MASS
    heavy.body_inertia[1] *= _FIXED_MASS
    mujoco.mj_setConst(heavy, mujoco.MjData(heavy))
    return heavy
