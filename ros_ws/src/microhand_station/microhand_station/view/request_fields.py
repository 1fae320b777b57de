# SPDX-License-Identifier: Apache-2.0
"""The fields of the request form in one browser."""

from __future__ import annotations

from collections.abc import Sequence

from viser import GuiApi

from microhand_station.view.request_form import FormValues

MESH_FILE = 'mesh file …'
UNITS_UM = {'µm': 1.0, 'nm': 1e-3, 'mm': 1e3, 'm': 1e6}
EULER, QUATERNION = 'Euler angles', 'quaternion'
PAPER_ZYZ_DEG = (80.0, 220.0, 100.0)


class RequestFields:
    """Object, rotation and translation.

    Parameters
    ----------
    gui : GuiApi
        Of the browser; the fields come where it is now.
    names : sequence of str
        Objects of the catalogue.
    """

    def __init__(self, gui: GuiApi, names: Sequence[str]) -> None:
        options = (*sorted(names), MESH_FILE)
        first = 'ellipsoid' if 'ellipsoid' in names else options[0]
        self._object = gui.add_dropdown('Object', options, initial_value=first)
        self._path = gui.add_text(
            'File', '', hint='Path of an STL, OBJ, PLY, ... on the machine of the station'
        )
        self._unit = gui.add_dropdown('Unit', tuple(UNITS_UM))
        self._by = gui.add_dropdown('Rotation by', (EULER, QUATERNION))
        self._euler = gui.add_vector3(
            'Z Y Z (°)',
            PAPER_ZYZ_DEG,
            step=1.0,
            hint='Rz(A) Ry(B) Rz(C) in the frame of the object, degrees',
        )
        self._real = gui.add_number('w', 1.0, step=0.01, hint='Real part of the quaternion')
        self._imaginary = gui.add_vector3(
            'x y z', (0.0, 0.0, 0.0), step=0.01, hint='Object frame; its length does not matter'
        )
        self._shift = gui.add_vector3(
            'Shift (µm)', (0.0, 0.0, 0.0), step=0.5, hint='Translation in the station frame'
        )
        self._afresh = gui.add_checkbox(
            'Put afresh',
            False,
            hint='Put the object at the origin, even if the fingers hold it now',
        )
        self._object.on_update(self._take_choice)
        self._by.on_update(self._take_choice)
        self._show_what_counts()

    def values(self) -> FormValues:
        """Return what is filled in."""
        from_file = self._object.value == MESH_FILE
        return FormValues(
            object_name=self._path.value.strip() if from_file else self._object.value,
            unit_um=UNITS_UM[self._unit.value] if from_file else 0.0,
            by_quaternion=self._by.value == QUATERNION,
            euler_zyz_deg=self._euler.value,
            quaternion_wxyz=(self._real.value, *self._imaginary.value),
            translation_um=self._shift.value,
            afresh=self._afresh.value,
        )

    async def _take_choice(self, _: object) -> None:
        """Follow a choice, in the thread that sends messages."""
        self._show_what_counts()

    def _show_what_counts(self) -> None:
        """Hide the fields that do not count."""
        from_file = self._object.value == MESH_FILE
        self._path.visible = self._unit.visible = from_file
        by_quaternion = self._by.value == QUATERNION
        self._euler.visible = not by_quaternion
        self._real.visible = self._imaginary.visible = by_quaternion
