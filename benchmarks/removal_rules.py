# SPDX-License-Identifier: Apache-2.0
"""What margins cost: how many removals are left by which rule, and what plans become of it.

    python benchmarks/removal_rules.py [--goals 30]

All removals on the paper's ellipse, by Eq. 4 and by preloads with less and less friction; and the
cheapest plans for random goals. The figures go to ``results/removal_rules.json``.
"""

from __future__ import annotations

import argparse
import itertools
import math

import numpy as np
from record import write
from rich.progress import track
from scipy.spatial.transform import Rotation

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.catalogue import find_part
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import ROBUST_RULES, ContactLaw, Finger, SearchOptions
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.preload import preload_window_uN
from microhand_planner.core.removal import grip_window_uN
from microhand_planner.core.section import XY_PLANE
from microhand_planner.core.section_curves import section_curves
from microhand_planner.evaluation.price_of_margin import price_of_margin
from microhand_planner.evaluation.table3 import CONTACTS, ELLIPSE_UM

LAW, RULES = ContactLaw(), ROBUST_RULES[0]
FACTORS = (1.0, 0.9, 0.8, 0.7, 0.6)
LEAST = f'm* >= {RULES.least_margin_uN:g} µN at {RULES.margin_factor:g} µ'
TOLERANT = {
    rules: f'{LEAST}, for grips off by {rules.grip_tolerance_uN:g} µN'
    for rules in reversed(ROBUST_RULES)
}
OBJECTS = ('ellipsoid', 'convex', 'concave')


def removals() -> list[dict[str, object]]:
    """Count the removals on the paper's ellipse that each rule allows."""
    curve = offset_curve(ellipse_section(*ELLIPSE_UM, XY_PLANE), Finger().radius_um)
    at = curve.at(np.arange(CONTACTS) * (curve.length_rad / CONTACTS))
    apart = np.linalg.norm(at.centre_um[:, None] - at.centre_um, axis=-1) >= 9.0
    triples = [
        (one, other, leave)
        for one, other in itertools.combinations(range(CONTACTS), 2)
        for leave in range(CONTACTS)
        if leave not in (one, other) and apart[one, other] and apart[[one, other], leave].all()
    ]
    force = (LAW.pull_off_uN, LAW.max_force_uN)
    by_rule: dict[str, list[bool]] = {'Eq. 4': []}
    for factor in FACTORS:
        by_rule[f'm* >= 0 at {factor:g} µ'] = []
    by_rule |= {LEAST: [], **{rule: [] for rule in TOLERANT.values()}}
    for one, other, leave in triples:
        stay = [one, other]
        case = (at.contact_um[stay], at.normal[stay], at.contact_um[leave], at.normal[leave])
        low, high = grip_window_uN(*case, LAW.friction, *force)
        by_rule['Eq. 4'].append(low <= high)
        for factor in FACTORS:
            low, high = preload_window_uN(*case, factor * LAW.friction, *force, 0.0)
            by_rule[f'm* >= 0 at {factor:g} µ'].append(low <= high)
        low, high = preload_window_uN(
            *case, RULES.margin_factor * LAW.friction, *force, RULES.least_margin_uN
        )
        by_rule[LEAST].append(low <= high)
        for rules, rule in TOLERANT.items():
            by_rule[rule].append(high - low >= 2.0 * rules.grip_tolerance_uN)
    paper = np.array(by_rule['Eq. 4'])
    return [
        {
            'what': 'removals',
            'rule': rule,
            'of': len(triples),
            'allowed': int(np.sum(allowed)),
            'and by Eq. 4': int(np.sum(paper & allowed)),
        }
        for rule, allowed in by_rule.items()
    ]


def prices(goals: int) -> list[dict[str, object]]:
    """Plan random goals with several margin factors."""
    rows: list[dict[str, object]] = []
    for name in OBJECTS:
        geometry = section_curves(find_part(name), Finger(clearance_um=0.5))
        for seed in track(range(goals), name):
            goal = Pose.of((0.0, 0.0, 0.0), Rotation.random(random_state=seed))
            prices = price_of_margin(
                lambda rules, goal=goal, geometry=geometry: plan_reorientation(
                    geometry, Pose(), goal, geometry.finger, LAW, SearchOptions(), rules
                ),
                ROBUST_RULES,
                [20.0] * 3,
                FACTORS,
            )
            rows += [
                {'what': 'price', 'object': name, 'seed': seed, **vars(price)} for price in prices
            ]
    return rows


def summary(rows: list[dict[str, object]]) -> None:
    """Print medians; goals without a plan count as infinitely dear."""
    for name, factor in itertools.product(OBJECTS, FACTORS):
        own = [row for row in rows if row.get('object') == name and row['margin_factor'] == factor]
        found = [row for row in own if row['cost_deg'] is not None]
        medians = [
            np.median([row[key] for row in found]) if found else math.nan
            for key in ('cost_deg', 'reconfigurations', 'motion_s')
        ]
        print(
            f'{name:10} {factor:4g}  {len(found):3d}/{len(own)}', *(f'{m:8.1f}' for m in medians)
        )


def main() -> None:
    """Measure, and write the results."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument('--goals', type=int, default=30, help='random goals per object')
    goals = arguments.parse_args().goals
    rows = removals()
    for row in rows:
        print(row)
    plans = prices(goals)
    summary(plans)
    print(write('removal_rules', [*rows, *plans], ('microhand_planner',)))


if __name__ == '__main__':
    main()
