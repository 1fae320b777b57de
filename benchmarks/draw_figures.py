# SPDX-License-Identifier: Apache-2.0
"""The figures of the documentation: from the planner itself and from results/growth.json.

python benchmarks/draw_figures.py
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import matplotlib

matplotlib.use('svg')
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Wedge
from matplotlib.ticker import ScalarFormatter
from record import RESULTS

from microhand_planner.core.analytic_sections import ellipse_section, waisted_section
from microhand_planner.core.offset_curve import OffsetCurve, offset_curve
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules
from microhand_planner.core.preload import contact_margin_uN, preload
from microhand_planner.core.removal import contact_lines, grip_window_uN
from microhand_planner.core.section import XY_PLANE
from microhand_planner.evaluation.table3 import CONTACTS, ELLIPSE_UM

FIGURES = Path(__file__).parent.parent / 'docs' / 'explanation' / 'figures'
OBJECT, TIP, WEAK, ACCENT = '#d9d4c7', '#31688e', '#9a9a9a', '#c8553d'
PRELOADS = (((1, 34), 20), ((7, 40), 25))
"""Contacts that stay, and the one that goes: a removal with a window, and one without."""
STYLE = {
    'svg.hashsalt': 'microhand',  # the same figure, the same file
    'svg.fonttype': 'none',
    'font.family': 'sans-serif',
    'font.size': 9.0,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'legend.frameon': False,
}


def save(name: str) -> None:
    """Write the present figure."""
    plt.savefig(FIGURES / f'{name}.svg', metadata={'Date': None}, bbox_inches='tight')
    plt.close()


def draw_section(axes: Axes, curve: OffsetCurve, contacts: int) -> None:
    """Draw an object's section, the path of the tips' centres, and the contact points."""
    phase = np.linspace(0.0, curve.length_rad, 400)
    around = curve.at(phase)
    axes.fill(*around.contact_um.T, color=OBJECT)
    axes.plot(*around.centre_um.T, color=TIP, lw=0.8)
    points = curve.at(np.arange(contacts) * (curve.length_rad / contacts))
    axes.plot(*points.centre_um.T, '.', color=TIP, ms=2.5)
    axes.plot(*points.contact_um.T, '.', color='black', ms=2.5)
    axes.set_aspect('equal')
    axes.axis('off')
    reach_um = np.abs(around.centre_um).max(axis=0) + curve.finger_radius_um + 0.5
    axes.set(xlim=(-reach_um[0], reach_um[0]), ylim=(-reach_um[1], reach_um[1]))


def draw_tip(axes: Axes, curve: OffsetCurve, phase_rad: float, **style: object) -> np.ndarray:
    """Draw a tip on the object and return its centre."""
    centre = curve.at(phase_rad).centre_um[0]
    axes.add_patch(Circle(tuple(centre), curve.finger_radius_um, **style))
    return centre


def offset_curves() -> None:
    """Contacts are equidistant on the path of the centre; a narrow waist stops a roll."""
    _, (left, right) = plt.subplots(1, 2, figsize=(9.0, 4.0), width_ratios=(1, 1.25))
    curve = offset_curve(ellipse_section(*ELLIPSE_UM, XY_PLANE), Finger().radius_um)
    draw_section(left, curve, CONTACTS)
    step = curve.length_rad / CONTACTS
    for phase, text in ((0.0, 'I'), (curve.phase_of_joint_j, 'J')):
        centre = draw_tip(left, curve, phase, fill=False, ec=WEAK, ls=':')
        left.annotate(text, centre, ha='center', va='center', color=WEAK)
    before = draw_tip(left, curve, 15 * step, fc='white', ec=TIP, alpha=0.9)
    after = draw_tip(left, curve, 11 * step, fc='white', ec=ACCENT, alpha=0.9)
    left.annotate('x', before, ha='center', va='center')
    left.annotate('x − θ', after, ha='center', va='center', color=ACCENT)
    left.set_title('rolling by θ = 80° is four steps of 20°', fontsize=9)

    curve = offset_curve(waisted_section(36.5, 16.0, 120.0, XY_PLANE), 9.0)
    draw_section(right, curve, round(curve.length_rad / math.radians(20.0)))
    outline = waisted_section(36.5, 16.0, 120.0, XY_PLANE).points_um
    right.fill(*outline[::8].T, color=OBJECT, zorder=0)
    for phase in curve.kinks_rad:
        draw_tip(right, curve, float(phase), fc='none', ec=ACCENT)
    right.set_title('a kink: the tip touches two places, and cannot roll on', fontsize=9)
    save('offset_curve')


def removals() -> None:
    """Whether a finger can be removed depends on the line between the two that stay."""
    curve = offset_curve(ellipse_section(*ELLIPSE_UM, XY_PLANE), Finger().radius_um)
    law = ContactLaw()
    step = curve.length_rad / CONTACTS
    _, panels = plt.subplots(1, 3, figsize=(10.0, 3.0))
    for axes, (stay, leave) in zip(
        panels, (((0, 37), 20), ((10, 47), 3), ((10, 47), 28)), strict=True
    ):
        draw_section(axes, curve, CONTACTS)
        phases = np.array([*stay, leave]) * step
        points = curve.at(phases)
        window = grip_window_uN(
            points.contact_um[:2].copy(), points.normal[:2].copy(),
            points.contact_um[2].copy(), points.normal[2].copy(),
            law.friction, law.pull_off_uN, law.max_force_uN,
        )  # fmt: skip
        for phase in phases[:2]:
            draw_tip(axes, curve, phase, fc='white', ec=TIP)
        draw_tip(axes, curve, phases[2], fc='white', ec=ACCENT, ls='--')
        axes.plot(*points.contact_um[:2].T, color=TIP, lw=1)
        half = math.degrees(math.atan(law.friction))
        for contact, normal in zip(points.contact_um[:2], points.normal[:2], strict=True):
            inward = math.degrees(math.atan2(-normal[1], -normal[0]))
            wedge = Wedge(tuple(contact), 9.0, inward - half, inward + half, color=TIP, alpha=0.25)
            axes.add_patch(wedge)
        pull = 7.0 * points.normal[2]
        axes.annotate(
            '', points.contact_um[2] + pull, points.contact_um[2],
            arrowprops={'arrowstyle': '->', 'color': ACCENT, 'lw': 1.5},
        )  # fmt: skip
        low, high = window
        can = f'can go: grip force {low:.1f} to {high:.1f} µN' if low <= high else 'cannot go'
        axes.set_title(can, fontsize=9)
    save('removal')


def margin_of(case: tuple[np.ndarray, ...], grips_uN: np.ndarray, pull: float) -> np.ndarray:
    """Return the margin of both contacts that stay, for each grip, at a share of the pull."""
    law, friction = ContactLaw(), GripRules().margin_factor * ContactLaw().friction
    lines = contact_lines(*case, law.pull_off_uN)
    return np.array(
        [
            min(
                contact_margin_uN(
                    pull * line[0] + grip * line[2], pull * line[1] + grip * line[3], friction, law
                )
                for line in lines
            )
            for grip in grips_uN
        ]
    )


def preloads() -> None:
    """One grip must do before a finger pulls and while it does: margin against grip force."""
    curve = offset_curve(ellipse_section(*ELLIPSE_UM, XY_PLANE), Finger().radius_um)
    step = curve.length_rad / CONTACTS
    law, rules = ContactLaw(), GripRules()
    _, (top, bottom) = plt.subplots(
        2, 2, figsize=(9.0, 5.4), height_ratios=(1.0, 1.25), gridspec_kw={'hspace': 0.25}
    )
    for where, axes, (stay, leave) in zip(top, bottom, PRELOADS, strict=True):
        phases = np.array([*stay, leave]) * step
        points = curve.at(phases)
        case = (
            points.contact_um[:2].copy(), points.normal[:2].copy(),
            points.contact_um[2].copy(), points.normal[2].copy(),
        )  # fmt: skip
        draw_section(where, curve, CONTACTS)
        for phase in phases[:2]:
            draw_tip(where, curve, phase, fc='white', ec=TIP)
        draw_tip(where, curve, phases[2], fc='white', ec=ACCENT, ls='--')
        where.plot(*points.contact_um[:2].T, color=TIP, lw=1)
        where.annotate(
            '', points.contact_um[2] + 7.0 * points.normal[2], points.contact_um[2],
            arrowprops={'arrowstyle': '->', 'color': ACCENT, 'lw': 1.5},
        )  # fmt: skip

        grips_uN = np.linspace(-2.0, 12.0, 561)
        still, pulled = (margin_of(case, grips_uN, pull) for pull in (0.0, 1.0))
        axes.plot(grips_uN, still, color=TIP, lw=1, label='no pull')
        axes.plot(grips_uN, pulled, color=ACCENT, lw=1, ls='--', label='pull of 1.5 µN')
        axes.plot(grips_uN, np.minimum(still, pulled), color='black', lw=2, label='less of both')
        axes.axhline(rules.least_margin_uN, color=WEAK, lw=0.6, ls=':')
        hold = preload(*case, law, rules)
        if hold.low_uN <= hold.high_uN:
            axes.axvspan(hold.low_uN, hold.high_uN, color=OBJECT, alpha=0.6, lw=0)
            reach_uN = rules.grip_tolerance_uN
            axes.errorbar(
                hold.grip_uN, hold.margin_uN, xerr=reach_uN, fmt='o', color='black', ms=4,
                capsize=3, lw=1,
            )  # fmt: skip
            axes.set_title(
                f'window {hold.low_uN:.1f} to {hold.high_uN:.1f} µN, preload {hold.grip_uN:.1f}',
                fontsize=9,
            )
        else:
            friction = rules.margin_factor * law.friction
            low, high = grip_window_uN(*case, friction, law.pull_off_uN, law.max_force_uN)
            axes.set_title(
                f'no window, though Eq. 4 would allow {low:.1f} to {high:.1f} µN', fontsize=9
            )
        axes.set(xlim=(-2.0, 12.0), ylim=(-0.6, 0.8), xlabel='grip force F [µN]')
    bottom[0].set_ylabel('margin to slipping [µN]')
    bottom[1].legend(loc='upper right')
    save('preload')


def growth() -> None:
    """How planning time grows: with finer steps, larger parts, dearer goals."""
    content = json.loads((RESULTS / 'growth.json').read_text(encoding='utf-8'))
    rows = content['rows']
    _, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6))
    styles = {'ellipsoid': ('o-', TIP), 'convex': ('s-', ACCENT), 'concave': ('^-', 'black')}
    for name, (marker, colour) in styles.items():
        own = [row for row in rows if row['what'] == 'step' and row['object'] == name]
        left.loglog(
            [20.0 / row['step_deg'] for row in own], [1e3 * row['median_s'] for row in own],
            marker, color=colour, ms=4, lw=1, label=name,
        )  # fmt: skip
    dear = [row for row in rows if row['what'] == 'dearest']
    left.loglog(
        [20.0 / row['step_deg'] for row in dear], [1e3 * row['median_s'] for row in dear],
        'x--', color=WEAK, ms=5, lw=1, label="one rotation, Table 3's dearest goal",
    )  # fmt: skip
    left.set_xlabel('20° / Δθ')
    left.set_ylabel('processor time [ms]')
    left.legend()
    size = [row for row in rows if row['what'] == 'size']
    right.loglog(
        [row['scale'] for row in size], [1e3 * row['median_s'] for row in size],
        'o-', color=TIP, ms=4, lw=1,
    )  # fmt: skip
    right.set_xlabel('length of the ellipsoid / 32 µm, at Δθ = 20°')
    for axes in (left, right):
        axes.grid(which='both', lw=0.3)
        axes.xaxis.set_major_formatter(ScalarFormatter())
    save('growth')


def main() -> None:
    """Draw all figures."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(STYLE):
        offset_curves()
        removals()
        preloads()
        growth()
    print(FIGURES)


if __name__ == '__main__':
    main()
