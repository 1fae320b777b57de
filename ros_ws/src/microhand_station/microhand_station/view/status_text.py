# SPDX-License-Identifier: Apache-2.0
"""What the station does, in words and tables, as HTML of the page's left panel.

All texts that come from elsewhere are escaped: they are shown, never obeyed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import datetime
from html import escape

from microhand_planner.core.plan import Plan
from microhand_planner.core.pose import angle_between_rad
from microhand_station.sequencer.progress import Progress, describe_step
from microhand_station.sequencer.states import State
from microhand_station.view.snapshot import Contact, Note, Snapshot, Stage, Thing

GOOD, BUSY, BAD, QUIET = '#2f9e44', '#1971c2', '#e03131', '#868e96'
WAITS = '#e8890c'
FINGER_COLORS = ('#1971c2', '#e8590c', '#0b8a6a')
STATES = {
    State.IDLE: ('idle', QUIET, 'ready for a plan'),
    State.STARTING: ('starting', BUSY, 'checks plan, stages and recorder'),
    State.RUNNING: ('running', BUSY, ''),
    State.PAUSED: ('paused', WAITS, 'stands at a stable grasp'),
    State.STOPPING: ('stopping', WAITS, 'comes to rest'),
    State.EMERGENCY: ('emergency stop', BAD, 'latched: reset it to go on'),
}
SHOWN_NOTES = 7
NM_PER_UM = 1e3


def sequencer_card(snapshot: Snapshot, pausing: bool) -> str:
    """Return what the sequencer does, and how far it is."""
    if snapshot.state is None:
        return _card('Sequencer', _badge('not there', BAD), '<div>nobody executes plans</div>')
    name, color, hint = STATES[snapshot.state]
    if pausing:
        hint = 'pauses at the end of this step'
    body = f'<div>{hint}</div>' if hint else ''
    if snapshot.running and snapshot.progress.steps:
        body += _progress(snapshot.progress, snapshot.plan)
    return _card('Sequencer', _badge(name, color), body)


def object_card(snapshot: Snapshot) -> str:
    """Return how the object is."""
    thing = snapshot.thing
    plan = snapshot.plan
    name = '' if plan is None else plan.object_name
    if thing is None:
        return _card('Object', _badge('none', QUIET), '<div>nobody reports an object</div>')
    badge, hint = _held(thing)
    rows = [('name', escape(name))] if name else []
    if snapshot.off_plan is not None:
        angle_rad, distance_um = snapshot.off_plan
        rows.append(
            ('off the plan', f'{math.degrees(angle_rad):.2f}° · {NM_PER_UM * distance_um:.0f} nm')
        )
    if plan is not None:
        error_rad = angle_between_rad(thing.pose.rotation, plan.goal.rotation)
        rows.append(('to the goal', f'{math.degrees(error_rad):.2f}°'))
    x, y, z = (f'{round(value, 2) + 0.0:.2f}' for value in thing.pose.position_um)
    rows.append(('position', f'{x}, {y}, {z} µm'))
    return _card('Object', badge, f'<div>{hint}</div>{_rows(rows)}')


def fingers_card(snapshot: Snapshot) -> str:
    """Return a table of the fingers, their stages and what they feel."""
    contacts = snapshot.thing.contacts if snapshot.thing is not None else ()
    head = ''.join(
        f'<th style="text-align:{"left" if i < 2 else "right"};font-weight:500">{title}</th>'
        for i, title in enumerate(('', 'stage', 'lag', 'force', 'friction'))
    )
    rows = ''.join(
        _finger(finger, stage, contacts[finger] if contacts else None)
        for finger, stage in enumerate(snapshot.stages)
    )
    errors = ''.join(
        f'<div style="color:{BAD}">{escape(stage.error)}</div>'
        for stage in snapshot.stages
        if stage is not None and stage.error
    )
    table = (
        '<table style="width:100%;border-collapse:collapse;white-space:nowrap">'
        f'<tr style="opacity:.6">{head}</tr>{rows}</table>{errors}'
    )
    return _card('Fingers', '', table)


def notes_card(notes: Iterable[Note]) -> str:
    """Return what happened last, newest first."""
    latest = list(notes)[-SHOWN_NOTES:][::-1]
    lines = ''.join(
        f'<div style="display:flex;gap:8px;{f"color:{BAD}" if note.code else ""}">'
        f'<span style="opacity:.6;flex:none">{datetime.fromtimestamp(note.time_s):%H:%M:%S}</span>'
        f'<span>{escape(note.text)}</span></div>'
        for note in latest
    )
    return _card('Events', '', lines or '<div>nothing yet</div>')


def plan_text(plan: Plan, planning_time_s: float, goal_error_rad: float) -> str:
    """Return what a plan consists of."""
    tightest = plan.tightest
    margin = '' if tightest is None else f' Tightest margin: {tightest[1].margin_uN:.2f} µN.'
    return good_text(
        f'Planned in {planning_time_s:.1f} s: {len(plan.steps)} steps, '
        f'{plan.reconfigurations} regrasps, cost {plan.cost_deg:.0f}°, '
        f'{math.degrees(goal_error_rad):.2f}° from the goal.{margin}'
    )


def good_text(text: str) -> str:
    """Return a sentence that tells of a success."""
    return _message(text, GOOD)


def quiet_text(text: str) -> str:
    """Return a sentence about what is under way."""
    return _message(text, QUIET)


def bad_text(text: str) -> str:
    """Return a sentence that tells of a failure."""
    return _message(text, BAD)


def _held(thing: Thing) -> tuple[str, str]:
    """Return badge and sentence for how the object is held."""
    if not thing.held:
        return _badge('lost', BAD), escape(thing.lost_because)
    if thing.released:
        return _badge('held', GOOD), 'by the fingers'
    return _badge('resting', QUIET), 'where it was put; not grasped yet'


def _finger(finger: int, stage: Stage | None, contact: Contact | None) -> str:
    """Return the row of a finger, from 0."""
    dot = (
        f'<span style="display:inline-block;width:9px;height:9px;border-radius:50%;'
        f'background:{FINGER_COLORS[finger]};margin-right:6px"></span>{finger + 1}'
    )
    if stage is None:
        what, lag = f'<span style="color:{BAD}">silent</span>', '–'
    else:
        target = ' ✓' if stage.on_target and not stage.error else ''
        color = f' style="color:{BAD}"' if stage.error else ''
        what = f'<span{color}>{stage.mode.name.lower()}{target}</span>'
        lag = f'{NM_PER_UM * stage.lag_um:.0f} nm'
    force, friction = '–', '–'
    if contact is not None and contact.touching:
        force = f'{contact.normal_uN:.1f} µN'
        if not math.isnan(contact.friction_use):
            friction = f'{100 * contact.friction_use:.0f} %'
    cells = ''.join(
        f'<td style="text-align:{"left" if i < 2 else "right"};padding:1px 0">{text}</td>'
        for i, text in enumerate((dot, what, lag, force, friction))
    )
    return f'<tr>{cells}</tr>'


def _progress(progress: Progress, plan: Plan | None) -> str:
    """Return a bar, the step, and the time left."""
    percent = 100.0 * min(max(progress.share, 0.0), 1.0)
    step = f'step {progress.step + 1} of {progress.steps}'
    if plan is not None and progress.step < len(plan.steps):
        step += f': {describe_step(plan.steps[progress.step])}'
    left = '' if math.isnan(progress.time_left_s) else f'{progress.time_left_s:.0f} s left'
    return (
        '<div style="height:6px;border-radius:3px;background:#8882;margin:6px 0 4px">'
        f'<div style="height:6px;border-radius:3px;background:{BUSY};width:{percent:.1f}%"></div>'
        '</div><div style="display:flex;justify-content:space-between">'
        f'<span>{escape(step)}</span>'
        f'<span style="opacity:.6">{percent:.0f} % · {left}</span></div>'
    )


def _rows(rows: Iterable[tuple[str, str]]) -> str:
    """Return names and values, one pair a line."""
    return ''.join(
        '<div style="display:flex;justify-content:space-between">'
        f'<span style="opacity:.6">{name}</span><span>{value}</span></div>'
        for name, value in rows
    )


def _badge(text: str, color: str) -> str:
    return (
        f'<span style="background:{color};color:#fff;border-radius:9px;padding:1px 9px;'
        f'font-size:11px;font-weight:600">{text}</span>'
    )


def _card(title: str, badge: str, body: str) -> str:
    return (
        '<div style="font-size:12px;line-height:1.5;padding:6px 10px 8px;margin:4px;'
        'overflow-wrap:anywhere;'
        'border:1px solid #8883;border-radius:6px;font-variant-numeric:tabular-nums">'
        '<div style="display:flex;justify-content:space-between;align-items:center;'
        f'font-weight:600;margin-bottom:2px"><span>{title}</span>{badge}</div>{body}</div>'
    )


def _message(text: str, color: str) -> str:
    return (
        f'<div style="font-size:12px;line-height:1.4;margin:2px 10px 6px;padding:2px 8px;'
        f'overflow-wrap:anywhere;border-left:3px solid {color}">{escape(text)}</div>'
    )
