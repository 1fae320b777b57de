# SPDX-License-Identifier: Apache-2.0
"""Runs and their figures → the words and tables of the report's page, as HTML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

from microhand_planner.core.plan import Plan
from microhand_station.analysis.findings import Findings, Worst
from microhand_station.analysis.report_data import other_name
from microhand_station.analysis.request_text import pose_text, requested
from microhand_station.analysis.run import Run

NONE = '–'
MINUS = '\u2212'


def verdict(run: Run, found: Findings) -> tuple[str, str]:
    """Return how a run went, in one sentence, and the class of that: good, bad or open."""
    if found.held is False:
        where = '' if found.lost is None else f' after {found.lost.time_s:.1f} s'
        step = None if found.lost is None else found.lost.step
        return f'The object was lost{where}{_in_step(found, step)}', 'bad'
    if found.failure:
        still = '; the object was still held' if found.held else ''
        return f'The run failed{_in_step(found, _last_step(found))}{still}', 'bad'
    if not found.complete:
        how_far = f'{run.share:.0%} of the plan' if run.share else 'no part of the plan'
        return f'The record ends early: {how_far} was executed', 'open'
    if found.held is None:
        return 'The plan was executed; whether the object was held was not judged', 'open'
    if found.final_error_deg is None:
        return 'The object was held', 'good'
    return f'The object was held, and ended {found.final_error_deg:.2f}° from its goal', 'good'


def heading(run: Run, found: Findings) -> str:
    """Return the top of the page: what run it is, and how it went."""
    sentence, kind = verdict(run, found)
    when = run.metadata.get('started', '')[:19].replace('T', ' ')
    small = ' · '.join(
        escape(part) for part in (f'Run {run.name}', when and f'{when} UTC') if part
    )
    reasons = [found.failure] if found.failure else []
    if run.object.lost_because and run.object.lost_because not in found.failure:
        reasons.append(run.object.lost_because)
    because = ''.join(f'<p class="because">{escape(reason)}</p>' for reason in reasons)
    return (
        f'<p class="eyebrow">{small} · {run.duration_s:.1f} s</p>'
        f'<h1><span class="mark {kind}" aria-hidden="true"></span>{escape(sentence)}</h1>{because}'
    )


def notices(run: Run) -> str:
    """Return what is missing or damaged; empty: nothing."""
    notes = list(run.missing)
    if run.end not in ('', 'complete'):
        notes.append(f'The recorder noted: {run.end}.')
    if run.undecodable:
        notes.append(f'{run.undecodable} messages are damaged and left out.')
    if run.deviation.source == 'commands':
        notes.append(
            'The errors of the object were worked out from the commands of the stages: '
            'the sequencer did not record them.'
        )
    items = ''.join(f'<li>{escape(note)}</li>' for note in notes)
    return f'<ul class="notices">{items}</ul>' if items else ''


def cards(run: Run, found: Findings) -> str:
    """Return what was asked, what was planned, and where it was worst."""
    return (
        '<section class="cards">'
        f'<div class="card"><h2>Asked</h2>{_pairs(_asked(run))}</div>'
        f'<div class="card"><h2>Planned</h2>{_pairs(_planned(run.plan))}</div>'
        f'<div class="card"><h2>Where it was worst</h2>{_worst_list(found)}</div>'
        '</section>'
    )


def steps_table(found: Findings, plan: Plan | None) -> str:
    """Return the table with a row for each step of the plan."""
    if plan is None:
        return '<p class="dim">There is no plan to compare with.</p>'
    head = (
        ('', 'Step'),
        ('s', 'from'),
        ('s', 'time'),
        ('µN', 'grip'),
        ('µN', 'planned'),
        ('µN', 'to the edge'),
        ('°', 'object off'),
        ('µm', 'stage off'),
        ('%', 'friction'),
        ('ms', 'skew'),
    )
    rows = []
    for step in found.steps:
        hold = plan.steps[step.number].hold
        outside = ' class="warn"' if step.room_uN is not None and step.room_uN < 0.0 else ''
        cells = (
            number(step.begin_s, 2),
            number(step.duration_s, 2),
            NONE if step.grip_uN is None else f'{step.grip_uN[0]:.2f} to {step.grip_uN[1]:.2f}',
            NONE if hold is None else f'{hold.grip_uN:.2f}',
            f'<span{outside}>{number(step.room_uN, 2)}</span>',
            number(step.object_error_deg, 2),
            number(step.tracking_error_um, 3),
            number(step.friction_use, 0, 100.0),
            number(step.skew_s, 2, 1e3),
        )
        name = f'{step.number + 1}&ensp;{escape(_signed(step.what))}'
        if step.begin_s is None or step.duration_s is None:
            label, span = f'{name} <span class="dim">not reached</span>', ''
        else:
            label = f'<button class="link">{name}</button>'
            span = f' data-begin="{step.begin_s}" data-end="{step.begin_s + step.duration_s}"'
        body = ''.join(f'<td>{cell}</td>' for cell in cells)
        rows.append(
            f'<tr{span} data-step="{step.number + 1}"><th scope="row">{label}</th>{body}</tr>'
        )
    return _table(head, rows, 'steps')


def events_table(run: Run) -> str:
    """Return the table with a row for each event."""
    if not run.events:
        return '<p class="dim">No node reported anything.</p>'
    rows = [
        f'<tr{" class=bad" if event.error_code else ""}>'
        f'<th scope="row"><button class="link" data-time="{event.time_s:.4f}">'
        f'{event.time_s:.2f}</button></th>'
        f'<td>{escape(event.source)}</td><td>{event.error_code or ""}</td>'
        f'<td>{escape(event.text)}</td></tr>'
        for event in run.events
    ]
    return _table((('s', 'Time'), ('', 'node'), ('', 'error'), ('', 'what')), rows, 'events')


def comparison(run: Run, found: Findings, other: Run, others: Findings) -> str:
    """Return the table that sets two runs side by side."""
    same = run.metadata.get('plan_hash') and run.metadata.get('plan_hash') == other.metadata.get(
        'plan_hash'
    )
    rows = []
    for label, digits, mine, theirs in _compared(run, found, other, others):
        change = (
            NONE
            if mine is None or theirs is None
            else f'{mine - theirs:+.{digits}f}'.replace('-', MINUS)
        )
        rows.append(
            f'<tr><th scope="row">{label}</th><td>{number(mine, digits)}</td>'
            f'<td>{number(theirs, digits)}</td><td>{change}</td></tr>'
        )
    for name, one, two in (
        ('held', _yes(found.held), _yes(others.held)),
        ('plan executed', _yes(found.complete), _yes(others.complete)),
    ):
        rows.insert(
            0, f'<tr><th scope="row">{name}</th><td>{one}</td><td>{two}</td><td></td></tr>'
        )
    name = other_name(run, other)
    mine_name = run.name if run.name != other.name else 'this run'
    head = (('', ''), ('', mine_name), ('', name), ('', 'difference'))
    plans = 'the same plan' if same else 'different plans'
    return (
        f'<section><h2>Compared with {escape(name)}</h2><p class="dim">Two runs of {plans}; '
        'in the plots both begin where their plans begin, and the other run is grey. '
        f'It is {escape(str(other.path))}.</p>'
        f'{_table(head, rows, "compared")}</section>'
    )


def number(value: float | None, digits: int, factor: float = 1.0) -> str:
    """Return a number with so many decimals; a dash for one that is not known."""
    if value is None or math.isnan(value):
        return NONE
    return f'{value * factor:.{digits}f}'.replace('-', MINUS)


def _compared(
    run: Run, found: Findings, other: Run, others: Findings
) -> Iterable[tuple[str, int, float | None, float | None]]:
    """Yield the figures to compare: label, decimals, and both values."""

    def value(worst: Worst | None) -> float | None:
        return None if worst is None else worst.value

    yield 'duration [s]', 2, run.duration_s, other.duration_s
    yield 'final error [°]', 3, found.final_error_deg, others.final_error_deg
    for label, digits, name in (
        ('largest error of the object [°]', 3, 'object_error_deg'),
        ('largest displacement of the object [µm]', 3, 'object_error_um'),
        ('least distance of the grip from the edge of its window [µN]', 3, 'room_uN'),
        ('largest share of friction in use', 3, 'friction_use'),
    ):
        yield label, digits, value(getattr(found, name)), value(getattr(others, name))
    for finger in sorted({*found.tracking_error, *others.tracking_error}):
        mine, theirs = found.tracking_error.get(finger), others.tracking_error.get(finger)
        yield (
            f'tracking error of finger {finger}, rms [µm]',
            3,
            None if mine is None else mine.rms_um,
            None if theirs is None else theirs.rms_um,
        )
    yield 'underruns', 0, float(found.underruns), float(others.underruns)


def _asked(run: Run) -> list[tuple[str, str]]:
    plan = run.plan
    asked = requested(run.note.request)
    if plan is None:
        return asked or [('request', 'not in the record')]
    law = plan.law
    stick = f', pull-off {law.pull_off_uN:g} µN' if law.adhesion else ', no adhesion'
    return [
        ('object', plan.object_name),
        *asked,
        ('from', pose_text(plan.start)),
        ('to', pose_text(plan.goal)),
        ('contacts', f'friction {law.friction:g}{stick}, up to {law.max_force_uN:g} µN'),
        ('tips', f'spheres of {plan.finger.radius_um:g} µm'),
        (
            'search',
            f'{plan.options.mode.value}, regrasps every {math.degrees(plan.options.step_rad):g}°',
        ),
    ]


def _planned(plan: Plan | None) -> list[tuple[str, str]]:
    if plan is None:
        return [('plan', 'not in the record')]
    turns = (
        ', '.join(f'{one.axis} {_signed(f"{one.angle_deg:+.4g}")}°' for one in plan.rotations)
        or 'none'
    )
    pairs = [
        ('rotations', turns),
        ('steps', str(len(plan.steps))),
        ('regrasps', f'{plan.reconfigurations} placements and removals'),
        ('cost', f'{plan.cost_deg:.0f}°'),
    ]
    if plan.tightest is not None:
        step, hold = plan.tightest
        pairs.append(('tightest', f'step {step + 1}: {hold.margin_uN:.2f} µN from slipping'))
    return pairs


def _worst_list(found: Findings) -> str:
    worst = max(found.tracking_error.items(), key=lambda item: item[1].max_um, default=(0, None))
    rows = [
        ('Object off its plan', found.object_error_deg, '{:.2f}°'),
        ('Friction in use', found.friction_use, '{:.0%}'),
        (
            'Grip outside its window'
            if found.room_uN is not None and found.room_uN.value < 0.0
            else 'Grip to the edge of its window',
            found.room_uN,
            '{:.2f} µN',
        ),
    ]
    items = [_jump(label, value, form, found) for label, value, form in rows]
    finger, error = worst
    if error is not None:
        at = Worst(error.max_um, error.max_at_s, _step_of(found, error.max_at_s), finger)
        items.append(_jump('Stage off its command', at, '{:.2f} µm', found))
    faults = []
    if found.underruns:
        faults.append(f'{found.underruns} underruns of setpoints')
    if found.missing_setpoints:
        faults.append(f'{found.missing_setpoints} setpoints are missing')
    items += [f'<li class="bad">{fault}</li>' for fault in faults]
    listed = ''.join(item for item in items if item)
    return f'<ul class="worst">{listed}</ul>' if listed else '<p class="dim">not known</p>'


def _jump(label: str, worst: Worst | None, form: str, found: Findings) -> str:
    """Return an entry that leads to the moment that it is about."""
    if worst is None:
        return ''
    of = f'finger {worst.finger}, ' if worst.finger else ''
    step = (
        ''
        if worst.step is None
        else f', step {worst.step + 1} ({found.steps[worst.step].what.replace("-", MINUS)})'
    )
    # a grip outside its window has less than no room
    mark = ' class="warn"' if worst.value < 0.0 else ''
    value = form.format(abs(worst.value))
    return (
        f'<li><button data-time="{worst.time_s:.4f}"><b{mark}>{value}</b>'
        f'<span>{label}</span><span class="dim">{of}{worst.time_s:.1f} s{escape(step)}</span>'
        '</button></li>'
    )


def _signed(text: str) -> str:
    """Return a text with real minus signs."""
    return text.replace('-', MINUS)


def _step_of(found: Findings, time_s: float) -> int | None:
    for step in found.steps:
        if step.begin_s is not None and step.duration_s is not None:
            if step.begin_s <= time_s <= step.begin_s + step.duration_s:
                return step.number
    return None


def _last_step(found: Findings) -> int | None:
    reached = [step.number for step in found.steps if step.begin_s is not None]
    return reached[-1] if reached else None


def _in_step(found: Findings, step: int | None) -> str:
    return '' if step is None else f', in step {step + 1} ({found.steps[step].what})'


def _pairs(pairs: Sequence[tuple[str, str]]) -> str:
    rows = ''.join(f'<dt>{escape(name)}</dt><dd>{escape(value)}</dd>' for name, value in pairs)
    return f'<dl>{rows}</dl>'


def _table(head: Sequence[tuple[str, str]], rows: Sequence[str], kind: str) -> str:
    """Lay out rows that are HTML already under heads of (unit, name)."""
    cells = ''.join(
        f'<th scope="col">{escape(name)}{f" <span>[{unit}]</span>" if unit else ""}</th>'
        for unit, name in head
    )
    return (
        f'<div class="table"><table class="{kind}"><thead><tr>{cells}</tr></thead>'
        f'<tbody>{"".join(rows)}</tbody></table></div>'
    )


def _yes(value: bool | None) -> str:
    return NONE if value is None else 'yes' if value else 'no'
