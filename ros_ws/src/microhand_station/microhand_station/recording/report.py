# SPDX-License-Identifier: Apache-2.0
"""A recorded run and what was asked → one plain HTML page that needs nothing else to be read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microhand_planner.core.errors import BadRequest
from microhand_station.recording.run_reader import FingerRecord, ObjectRecord, Run

_NOT_JUDGED = 'not judged'
_AXES = 'xyz'
_POINTS_PER_LINE = 800
_WIDTH, _HEIGHT = 400, 240
_LEFT, _RIGHT, _TOP, _BOTTOM = 42, 8, 10, 34

_STYLE = """
:root{--ink:#1b1f24;--dim:#5c6670;--page:#fff;--card:#f4f6f8;--line:#d5dae0;--bad:#b3261e;
--x:#0072b2;--y:#c44e00;--z:#008060}
@media(prefers-color-scheme:dark){:root{--ink:#e6e9ec;--dim:#9aa4ae;--page:#14171a;--card:#1e2327;
--line:#3a4148;--bad:#ff8a80;--x:#56b4e9;--y:#f0915a;--z:#3fc79a}}
body{margin:0 auto;padding:1rem;max-width:76rem;color:var(--ink);background:var(--page);
font:1rem/1.5 system-ui,sans-serif}
h1{font-size:1.4rem;margin:.2rem 0}h2{font-size:1.1rem;margin:1.6rem 0 .5rem}
.grid{display:grid;gap:.6rem;grid-template-columns:repeat(auto-fit,minmax(9.5rem,1fr))}
.plots{grid-template-columns:repeat(auto-fit,minmax(min(20rem,100%),1fr))}
.grid>div,figure{background:var(--card);border-radius:.4rem;padding:.6rem .8rem;margin:0}
.grid b{display:block;font-size:1.25rem}.grid span,figcaption,.dim{color:var(--dim)}
.wide{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .8rem .25rem 0;text-align:right;border-bottom:1px solid var(--line)}
th{color:var(--dim);font-weight:normal}th:first-child,td:first-child,.text td{text-align:left}
.text th{text-align:left}.bad{color:var(--bad)}code{overflow-wrap:anywhere}
svg{width:100%;height:auto;display:block}svg text{font-size:11px;fill:var(--dim)}
.command{stroke-width:4;opacity:.3;fill:none}.measured{stroke-width:1.2;fill:none}
.x{stroke:var(--x)}.y{stroke:var(--y)}.z{stroke:var(--z)}.axis{stroke:var(--line)}
@media(max-width:40rem){table{font-size:.8rem}th,td{padding-right:.5rem;vertical-align:bottom}}
.key{font-weight:bold}.key.x{color:var(--x)}.key.y{color:var(--y)}.key.z{color:var(--z)}
"""


def write_report(run: Run, path: Path, summary: Mapping[str, Any]) -> None:
    """Write the page.

    Parameters
    ----------
    run : Run
        The record.
    path : Path
        Of the page; an existing one is replaced.
    summary : Mapping
        What the record does not hold, by the keys of ``microhand plan --json`` and of
        ``microhand demo --json``, each optional: ``object``, ``request`` (texts), ``cost_deg``,
        ``reconfigurations``, ``goal_error_deg``, ``planning_time_s``, ``rotations`` (list of
        mappings), ``held``, ``final_error_deg``. The last two are "not judged" where None.

    Raises
    ------
    BadRequest
        The page cannot be written there.
    """
    name = run.metadata.get('run', run.path.stem)
    parts = [
        f'<h1>Run {escape(name)}</h1>',
        f'<p class="dim">{_text(summary.get("object"))} · {_text(summary.get("request"))}</p>',
        _warning(run),
        _tiles(run, summary),
        '<h2>Rotations</h2>',
        _rotations(summary.get('rotations') or []),
        '<h2>Object</h2><p class="dim">How far it was from where the plan had it.</p>',
        _object_plots(run.object),
        '<h2>Fingers</h2>',
        _fingers(run.fingers),
        '<h2>Position of the stages</h2><p class="dim">Wide: commanded, thin: measured; '
        + ', '.join(f'<span class="key {axis}">{axis}</span>' for axis in _AXES)
        + ' in the frame of each stage.</p><div class="grid plots">',
        *(_plot(finger, record) for finger, record in run.fingers.items()),
        '</div><h2>Events</h2>',
        _events(run),
        f'<h2>Record</h2><p><code>{escape(str(run.path))}</code></p>',
    ]
    page = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<title>Run {escape(name)}</title><style>{_STYLE}</style></head>'
        f'<body>{"".join(parts)}</body></html>\n'
    )
    try:
        Path(path).write_text(page, encoding='utf-8')
    except OSError as error:
        raise BadRequest(
            'report', path, f'a file that can be written ({error.strerror})'
        ) from error


def _warning(run: Run) -> str:
    notes = [] if run.finished else ['The record was not finished: this is what could be read.']
    if run.end not in ('', 'complete'):
        notes.append(f'End of the record: {run.end}.')
    if run.undecodable:
        notes.append(f'{run.undecodable} messages are damaged and left out.')
    return ''.join(f'<p class="bad">{escape(note)}</p>' for note in notes)


def _tiles(run: Run, summary: Mapping[str, Any]) -> str:
    held = summary.get('held')
    tiles = {
        'object held': _NOT_JUDGED if held is None else 'yes' if held else 'no: lost',
        'final error': _number(summary.get('final_error_deg'), '°', _NOT_JUDGED),
        'cost': _number(summary.get('cost_deg'), '°'),
        'reconfigurations': _number(summary.get('reconfigurations'), ''),
        'error of the plan': _number(summary.get('goal_error_deg'), '°'),
        'planning': _number(summary.get('planning_time_s'), ' s'),
        'duration': _number(run.duration_s, ' s'),
    }
    cells = (f'<div><span>{label}</span><b>{value}</b></div>' for label, value in tiles.items())
    return f'<div class="grid">{"".join(cells)}</div>'


def _rotations(rotations: Sequence[Mapping[str, Any]]) -> str:
    keys = {
        'angle_deg': 'angle [°]',
        'cost_deg': 'cost [°]',
        'reconfigurations': 'reconfigurations',
        'expanded': 'expanded',
        'time_s': 'search [s]',
    }
    rows = (
        [_text(rotation.get('axis')), *(_number(rotation.get(key), '') for key in keys)]
        for rotation in rotations
    )
    return _table(['axis', *keys.values()], rows)


def _fingers(fingers: Mapping[int, FingerRecord]) -> str:
    rows = []
    for finger, record in fingers.items():
        error = record.tracking_error
        rows.append(
            [
                str(finger),
                str(len(record.setpoint_um)),
                str(record.missing),
                str(record.out_of_order),
                '–' if error is None else f'{error.rms_um:.4f}',
                '–' if error is None else f'{error.max_um:.4f}',
            ]
        )
    head = [
        'finger',
        'setpoints',
        'missing',
        'out of order',
        'tracking error, rms [µm]',
        'max [µm]',
    ]
    return _table(head, rows)


def _events(run: Run) -> str:
    rows = (
        [
            f'{event.time_s:.3f}',
            escape(event.source),
            f'<span class="bad">{event.error_code}</span>' if event.error_code else '',
            escape(event.text),
        ]
        for event in run.events
    )
    return _table(['time [s]', 'node', 'error', 'what'], rows, 'text')


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], kind: str = '') -> str:
    """Lay out cells that are HTML already; a table without rows says so."""
    body = ''.join('<tr>' + ''.join(f'<td>{cell}</td>' for cell in row) + '</tr>' for row in rows)
    if not body:
        return '<p class="dim">none</p>'
    top = ''.join(f'<th>{label}</th>' for label in head)
    return f'<div class="wide"><table class="{kind}"><tr>{top}</tr>{body}</table></div>'


def _plot(finger: int, record: FingerRecord) -> str:
    """Draw commanded and measured position over time."""
    both_um = np.hstack([record.commanded_um, record.measured_um])
    kinds = [f'{kind} {axis}' for kind in ('command', 'measured') for axis in _AXES]
    return _figure(f'finger {finger}, position [µm]', record.state_time_s, both_um, kinds)


def _object_plots(record: ObjectRecord) -> str:
    """Draw how far the object was from its plan."""
    if not len(record.time_s):
        return '<p class="dim">nothing watched it</p>'
    figures = (
        _figure(f'away from the plan [{unit}]', record.time_s, values[:, np.newaxis], [kind])
        for unit, values, kind in (
            ('°', record.angle_deg, 'measured x'),
            ('µm', record.distance_um, 'measured y'),
        )
    )
    return f'<div class="grid plots">{"".join(figures)}</div>'


def _figure(
    caption: str, time_s: NDArray[np.float64], values: NDArray[np.float64], kinds: Sequence[str]
) -> str:
    """Draw columns of values over time, one line of a kind for each."""
    finite = np.flatnonzero(np.isfinite(values).all(axis=1))
    if not len(finite):
        return f'<figure><figcaption>{caption}: nothing recorded</figcaption></figure>'
    # A stage that moves for a minute has far more samples than a screen has pixels.
    shown = finite[np.unique(np.linspace(0, len(finite) - 1, _POINTS_PER_LINE).astype(int))]
    values, time_s = values[shown], time_s[shown]
    x_ticks = _ticks(float(time_s.min()), float(time_s.max()), 5)
    y_ticks = _ticks(float(values.min()), float(values.max()), 4)
    x_px = _scale(time_s, x_ticks, _LEFT, _WIDTH - _RIGHT)
    lines = []
    for column, kind in zip(values.T, kinds, strict=True):
        y_px = _scale(column, y_ticks, _HEIGHT - _BOTTOM, _TOP)
        points = ' '.join(f'{x:.1f},{y:.1f}' for x, y in zip(x_px, y_px, strict=True))
        lines.append(f'<polyline class="{kind}" points="{points}"/>')
    for value, x in zip(x_ticks, _scale(x_ticks, x_ticks, _LEFT, _WIDTH - _RIGHT), strict=True):
        lines.append(f'<text x="{x:.1f}" y="{_HEIGHT - 19}" text-anchor="middle">{value:g}</text>')
    for value, y in zip(y_ticks, _scale(y_ticks, y_ticks, _HEIGHT - _BOTTOM, _TOP), strict=True):
        lines.insert(0, f'<path class="axis" d="M{_LEFT} {y:.1f}H{_WIDTH - _RIGHT}"/>')
        lines.append(f'<text x="{_LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    lines.append(
        f'<text x="{_WIDTH - _RIGHT}" y="{_HEIGHT - 4}" text-anchor="end">time [s]</text>'
    )
    return (
        f'<figure><figcaption>{caption}</figcaption>'
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" '
        f'aria-label="{caption} over time">{"".join(lines)}</svg></figure>'
    )


def _ticks(low: float, high: float, about: int) -> NDArray[np.float64]:
    """Choose round values from at or below `low` to at or above `high`."""
    raw = max(high - low, 1e-3) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * (1 - 1e-9))
    count = max(1, math.ceil(high / step - 1e-9) - math.floor(low / step + 1e-9))
    return np.round((math.floor(low / step + 1e-9) + np.arange(count + 1)) * step, 9)


def _scale(
    values: NDArray[np.float64], ticks: NDArray[np.float64], first_px: float, last_px: float
) -> NDArray[np.float64]:
    return first_px + (values - ticks[0]) / (ticks[-1] - ticks[0]) * (last_px - first_px)


def _number(value: object, unit: str, none: str = '–') -> str:
    if value is None:
        return none
    if not isinstance(value, float):
        return f'{escape(str(value))}{unit}'
    return f'{value:.0f}{unit}' if abs(value) >= 1e4 else f'{value:.4g}{unit}'


def _text(value: object) -> str:
    return '–' if value is None else escape(str(value))
