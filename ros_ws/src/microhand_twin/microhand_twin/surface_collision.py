# SPDX-License-Identifier: Apache-2.0
"""Lets MuJoCo ask us where tips touch a smooth surface.

MuJoCo keeps a table of collision functions, one for each pair of geometry types, that programs
may change (``mjCOLLISIONFUNC`` of its C interface). Ours stands in the place for a sphere and a
box while the twin steps its worlds, and only then: other models in the same process never meet
it. In the twin's worlds a box is what carries a smooth surface; the surface itself is the first
custom number field of the model, as `surface_table` wrote it.
"""

from __future__ import annotations

import ctypes
import functools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numba as nb
import numpy as np
from numba.core import cgutils
from numba.extending import intrinsic

from microhand_planner.core.pose import FloatArray
from microhand_twin.nearest_point import MOST_CONTACTS, touched_places
from microhand_twin.surface_table import HEADER, NODE, ROW

_SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)
_BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
_TYPES = int(mujoco.mjtGeom.mjGEOM_SDF) + 1
_CONTACT = 10  # numbers of an mjPreContact: distance, position, normal, tangent
_WORD = 8
_PAGE = 64 * _WORD
_FARTHEST = 1 << 20


@contextmanager
def smooth_contacts(active: bool) -> Iterator[None]:
    """Let smooth surfaces take part in collisions within the block. Any thread may.

    Parameters
    ----------
    active : bool
        False: do nothing.
    """
    if not active:
        yield
        return
    _users.enter()
    try:
        yield
    finally:
        _users.leave()


class _Users:
    """Counts who is within `smooth_contacts`: the first changes the table, the last restores."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._number = 0
        self._usual: int | None = None

    def enter(self) -> None:
        """Put our function into the table, if nobody has done so."""
        table, ours = _collision_table(), _collision_function().address
        with self._lock:
            if not self._number:
                self._usual = table[_SPHERE][_BOX]
                table[_SPHERE][_BOX] = ours
            self._number += 1

    def leave(self) -> None:
        """Put MuJoCo's own function back, if nobody else needs ours."""
        with self._lock:
            self._number -= 1
            if not self._number:
                _collision_table()[_SPHERE][_BOX] = self._usual


_users = _Users()


@functools.cache
def _collision_table() -> Any:
    """Return MuJoCo's table of collision functions."""
    (library,) = Path(mujoco.__file__).parent.glob('libmujoco.so.*')
    rows = (ctypes.c_void_p * _TYPES) * _TYPES
    return rows.in_dll(ctypes.CDLL(str(library)), 'mjCOLLISIONFUNC')


@functools.cache
def _collision_function() -> Any:
    """Compile the collision function, or take it from numba's cache."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><custom><numeric name="n" data="1"/></custom>'
        '<worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    return _compiled(
        _offset_of(model, model.numeric_data),
        _offset_of(data, data.geom_xpos),
        _offset_of(data, data.geom_xmat),
    )


def _offset_of(owner: Any, array: FloatArray) -> int:
    """Return where in the C struct of a model or its data the pointer to an array is, in words.

    The bindings show arrays, not the structs. Searching for the pointer holds for every version.
    An empty array has the address of the next one, and comes before it: the last match counts.
    """
    wanted = array.__array_interface__['data'][0]
    found = None
    for start in range(0, _FARTHEST, _PAGE):
        page = (ctypes.c_uint64 * (_PAGE // _WORD)).from_address(owner._address + start)  # noqa: SLF001 - the struct
        matches = np.flatnonzero(np.ctypeslib.as_array(page) == wanted)
        if len(matches):
            found = start // _WORD + int(matches[-1])
        elif found is not None:
            return found
    raise RuntimeError(f'MuJoCo {mujoco.__version__} lays out its data in an unknown way')


@intrinsic
def _pointer(typing_context: Any, address: Any) -> tuple[Any, Callable[..., Any]]:
    """Turn an address, an integer, into a pointer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return nb.types.voidptr(nb.uintp), generate


def _compiled(surface_at: int, positions_at: int, matrices_at: int) -> Any:
    """Compile a collision function for a layout of MuJoCo's data."""
    signature = nb.int32(
        nb.types.voidptr, nb.types.voidptr, nb.types.voidptr, nb.int32, nb.int32, nb.float64
    )

    @nb.cfunc(signature, cache=True)
    def collide(model, data, contacts, sphere, box, margin):  # type: ignore[no-untyped-def]  # pragma: no cover
        model_words = nb.carray(model, surface_at + 1, nb.uintp)
        data_words = nb.carray(data, matrices_at + 1, nb.uintp)
        header = nb.carray(_pointer(model_words[surface_at]), HEADER, nb.float64)
        leaves = int(header[1])
        size = HEADER + leaves * (2 * NODE + ROW)
        table = nb.carray(_pointer(model_words[surface_at]), size, nb.float64)
        positions = nb.carray(
            _pointer(data_words[positions_at]), 3 * (max(sphere, box) + 1), nb.float64
        )
        matrices = nb.carray(_pointer(data_words[matrices_at]), 9 * (box + 1), nb.float64)
        centre = np.zeros(3)
        for i in range(3):
            for k in range(3):
                offset = positions[3 * sphere + k] - positions[3 * box + k]
                centre[i] += matrices[9 * box + 3 * k + i] * offset
        found = np.zeros((MOST_CONTACTS, 4))
        number = touched_places(table, centre, header[2] + margin, found)
        result = nb.carray(contacts, (MOST_CONTACTS, 10), nb.float64)
        for c in range(number):
            distance = found[c, 0]
            result[c, 0] = distance - header[2]
            for i in range(3):
                normal = 0.0
                place = positions[3 * box + i]
                for k in range(3):
                    turned = matrices[9 * box + 3 * i + k]
                    normal += turned * (found[c, 1 + k] - centre[k]) / distance
                    place += turned * found[c, 1 + k]
                result[c, 1 + i] = place - 0.5 * result[c, 0] * normal
                result[c, 4 + i] = normal
                result[c, 7 + i] = 0.0
        return number

    return collide
