# SPDX-License-Identifier: Apache-2.0
"""Runs → what the scripts of the report's page draw: a scene over time, plots, steps, events."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from microhand_planner.core.plan import FINGERS
from microhand_station.analysis.findings import Findings, holding_friction
from microhand_station.analysis.object_mesh import simplified
from microhand_station.analysis.run import Run
from microhand_station.analysis.run_progress import planned_at
from microhand_station.analysis.thinned import thinned

FloatArray = NDArray[np.float64]

_MOST_FACES = 20_000
_MOST_POSES = 4000
_PARTS = 500
_AXES = 'xyz'


def report_data(run: Run, found: Findings, other: Run | None = None) -> str:
    """Return the data of the page as JSON that can stand inside of HTML.

    Parameters
    ----------
    run : Run
        The run that the page is about.
    found : Findings
        Of this run.
    other : Run or None
        A run to compare with; both are drawn from the beginning of their plans.
    """
    shift_s = 0.0 if other is None else plan_begin_s(run) - plan_begin_s(other)
    data = {
        'duration': run.duration_s,
        'radius': None if run.plan is None else run.plan.finger.radius_um,
        'mesh': _mesh(run),
        'scene': _scene(run),
        'other': None
        if other is None
        else {'name': other_name(run, other)} | _scene(other, shift_s),
        'plots': _plots(run, other, shift_s),
        'steps': [
            {'number': step.number + 1, 'what': step.what, 'kind': step.kind.value}
            | {'begin': step.begin_s, 'end': step.begin_s + step.duration_s}
            for step in found.steps
            if step.begin_s is not None and step.duration_s is not None
        ],
        'events': [
            {'time': event.time_s, 'text': event.text, 'bad': bool(event.error_code)}
            for event in run.events
        ],
        'lost': None if found.lost is None else found.lost.time_s,
    }
    # "</script>" in a text must not end the script that it is in.
    return json.dumps(data, allow_nan=False, separators=(',', ':')).replace('<', '\\u003c')


def other_name(run: Run, other: Run) -> str:
    """Return how to call the run to compare with: by its name, if that tells it from the first."""
    return other.name if other.name != run.name else 'other run'


def plan_begin_s(run: Run) -> float:
    """Return when the plan began, since the start of the run [s]; 0: it is not known."""
    if run.progress is None or not len(run.progress.time_s):
        return 0.0
    return float(run.progress.time_s[0])


def _packed(values: ArrayLike, kind: str = '<f4') -> dict[str, str]:
    """Return an array as the page unpacks it: float32, or uint32 for indices."""
    raw = np.ascontiguousarray(values, dtype=kind).tobytes()
    return {'f32' if kind == '<f4' else 'u32': base64.b64encode(raw).decode('ascii')}


def _mesh(run: Run) -> dict[str, Any] | None:
    if run.mesh is None:
        return None
    mesh = simplified(run.mesh, _MOST_FACES)
    return {'vertices': _packed(mesh.vertices_um), 'faces': _packed(mesh.faces, '<u4')}


def _scene(run: Run, shift_s: float = 0.0) -> dict[str, Any]:
    """Return poses over time: of the object, of its plan, of the tips; and forces."""
    time_s = _scene_times_s(run)
    scene: dict[str, Any] = {'time': _packed(time_s + shift_s)}
    body = run.object
    if len(body) > 1:
        at_s = np.clip(time_s, body.time_s[0], body.time_s[-1])
        position, quaternion = _pose_at(body.time_s, body.position_um, body.quaternion_wxyz, at_s)
        scene['object'] = {'position': _packed(position), 'quaternion': _packed(quaternion)}
    if run.progress is not None and len(run.progress.time_s):
        position, quaternion = planned_at(run.progress, time_s)
        scene['plan'] = {'position': _packed(position), 'quaternion': _packed(quaternion)}
    force_uN = _forces_at(run, time_s)
    if force_uN is not None:
        scene['force'] = _packed(force_uN)
    tips_um = _tips_at(run, time_s, force_uN)
    if tips_um is not None:
        scene['tips'] = _packed(tips_um)
    return scene


def _scene_times_s(run: Run) -> FloatArray:
    """Return the times at which the scene is known; the page interpolates."""
    known = [run.object.time_s, *(finger.state_time_s for finger in run.fingers.values())]
    time_s = next((np.unique(times) for times in known if len(times) > 1), np.zeros(0))
    if len(time_s) > _MOST_POSES:
        time_s = time_s[np.linspace(0, len(time_s) - 1, _MOST_POSES).astype(int)]
    return time_s


def _pose_at(
    time_s: FloatArray, position: FloatArray, wxyz: FloatArray, at_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    times, first = np.unique(time_s, return_index=True)
    if len(times) < 2:
        return np.tile(position[0], (len(at_s), 1)), np.tile(wxyz[0], (len(at_s), 1))
    turned = Slerp(times, Rotation.from_quat(wxyz[first][:, [1, 2, 3, 0]]))(at_s).as_quat()
    moved = np.stack([np.interp(at_s, times, position[first, axis]) for axis in range(3)], axis=1)
    return moved, turned[:, [3, 0, 1, 2]]


def _forces_at(run: Run, time_s: FloatArray) -> FloatArray | None:
    """Return the forces on the object that were reported last, (n, 9) [µN]."""
    body = run.object
    if not len(body) or not np.isfinite(body.force_uN).any():
        return None
    row = np.clip(np.searchsorted(body.time_s, time_s, side='right') - 1, 0, len(body) - 1)
    return np.nan_to_num(body.force_uN[row]).reshape(-1, 9)


def _tips_at(run: Run, time_s: FloatArray, force_uN: FloatArray | None) -> FloatArray | None:
    """Return where the tips were, (n, 9) [µm]: at the stages, less how far fingers bend."""
    base_um, stiffness = run.note.base_um, run.note.stiffness_uN_per_um
    states = [run.fingers[n] for n in range(1, FINGERS + 1) if n in run.fingers]
    if base_um is None or stiffness is None or len(states) < FINGERS:
        return None
    if not all(len(finger.state_time_s) for finger in states):
        return None
    tips_um = np.stack(
        [
            np.interp(time_s, finger.state_time_s, finger.measured_um[:, axis]) + base[axis]
            for finger, base in zip(states, base_um, strict=True)
            for axis in range(3)
        ],
        axis=1,
    )
    return tips_um if force_uN is None else tips_um - force_uN / np.repeat(stiffness, 3)


def _plots(run: Run, other: Run | None, shift_s: float) -> list[dict[str, Any]]:
    """Return the plots that there is anything for, in the order of the page."""
    plots = [_error_plot(run), _grip_plot(run), _friction_plot(run), _tracking_plot(run)]
    if other is not None:
        name = other_name(run, other)
        theirs = (_error_plot(other), _grip_plot(other), _friction_plot(other), None)
        for plot, more in zip(plots, theirs, strict=True):
            if plot is not None and more is not None:
                plot['lines'] += _of_other(more['lines'], name, shift_s)
        if plots[3] is not None:
            plots[3]['lines'] += _of_other(_worst_tracking(other), name, shift_s)
    plots += [_position_plot(run, finger) for finger in sorted(run.fingers)]
    for plot in (plot for plot in plots if plot is not None):
        for line in plot['lines']:
            line['time'] = _packed(line['time'])
            line['values'] = _packed(line['values'])
    return [plot for plot in plots if plot is not None]


def _line(
    label: str, colour: str, time_s: FloatArray, values: FloatArray, kind: str = 'thin'
) -> dict[str, Any]:
    """Return one line of a plot, not yet thinned out nor packed."""
    kept = thinned(values[:, None], _PARTS)
    return {
        'label': label,
        'colour': colour,
        'kind': kind,
        'time': time_s[kept],
        'values': values[kept],
    }


def _of_other(lines: list[dict[str, Any]], name: str, shift_s: float) -> list[dict[str, Any]]:
    """Return the first line as the one to compare with."""
    return [
        {
            **line,
            'label': name,
            'colour': 'other',
            'kind': 'dashed',
            'time': line['time'] + shift_s,
        }
        for line in lines[:1]
    ]


def _error_plot(run: Run) -> dict[str, Any] | None:
    off = run.deviation
    if not len(off):
        return None
    return {
        'id': 'object_error',
        'title': 'Object: orientation error against the plan',
        'unit': '°',
        'lines': [_line('error', 'object', off.time_s, off.angle_deg)],
    }


def _grip_plot(run: Run) -> dict[str, Any] | None:
    grip = run.grip
    if grip is None:
        return None
    return {
        'id': 'grip',
        'title': 'Grip of the two fingers that hold, inside its window',
        'unit': 'µN',
        'lines': [
            _line('measured', 'object', grip.time_s, grip.measured_uN),
            _line('planned', 'plan', grip.time_s, grip.planned_uN, 'dashed'),
            _line('window from', 'window', grip.time_s, grip.low_uN, 'low'),
            _line('to', 'window', grip.time_s, np.minimum(grip.high_uN, _ceiling(grip)), 'high'),
        ],
    }


def _ceiling(grip: Any) -> float:
    """Return the grip above which a window is of no interest, so that the rest can be seen."""
    both = np.concatenate([grip.measured_uN, grip.planned_uN])
    return 1.6 * float(np.nanmax(both))


def _friction_plot(run: Run) -> dict[str, Any] | None:
    use = holding_friction(run)
    if not np.isfinite(use).any():
        return None
    return {
        'id': 'friction',
        'title': 'Friction in use; at 1 a contact slips',
        'unit': '',
        'lines': [
            _line(f'finger {finger + 1}', f'finger{finger + 1}', run.object.time_s, use[:, finger])
            for finger in range(FINGERS)
        ],
    }


def _tracking_plot(run: Run) -> dict[str, Any] | None:
    lines = [
        _line(
            f'finger {number}',
            f'finger{number}',
            finger.state_time_s,
            np.where(finger.streaming, finger.off_um, np.nan),
        )
        for number, finger in sorted(run.fingers.items())
        if len(finger.state_time_s)
    ]
    if not lines:
        return None
    return {
        'id': 'tracking',
        'title': 'Stages: tracking error',
        'unit': 'µm',
        'lines': lines,
    }


def _worst_tracking(run: Run) -> list[dict[str, Any]]:
    """Return the line of the finger that was worst."""
    errors = {
        number: error.max_um
        for number, finger in run.fingers.items()
        if (error := finger.tracking_error) is not None
    }
    if not errors:
        return []
    finger = run.fingers[max(errors, key=lambda number: errors[number])]
    off_um = np.where(finger.streaming, finger.off_um, np.nan)
    return [_line('', 'other', finger.state_time_s, off_um)]


def _position_plot(run: Run, number: int) -> dict[str, Any] | None:
    finger = run.fingers[number]
    if not len(finger.state_time_s):
        return None
    base_um = np.zeros(3) if run.note.base_um is None else run.note.base_um[number - 1]
    frame = 'stage' if run.note.base_um is None else 'station'
    lines = []
    for kind, values, name in (
        ('wide', finger.commanded_um, 'commanded'),
        ('thin', finger.measured_um, 'measured'),
    ):
        for axis, letter in enumerate(_AXES):
            shown = values[:, axis] + base_um[axis]
            lines.append(_line(f'{letter} {name}', letter, finger.state_time_s, shown, kind))
    return {
        'id': f'position_{number}',
        'title': f'Finger {number}: position, {frame} frame, commanded (wide) and measured (thin)',
        'unit': 'µm',
        'lines': lines,
    }
