# SPDX-License-Identifier: Apache-2.0
"""What margins cost: more margin is never cheaper, and too much of it has no plan."""

import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import InvalidParameter, NoPlanExists
from microhand_planner.core.force_check import check_forces
from microhand_planner.core.parameters import ContactLaw, Finger, GripRules, Mode, SearchOptions
from microhand_planner.core.plan_file import plan_to_dict
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_planner.core.section_curves import section_curves

FINGER = Finger(clearance_um=0.5)
EULER_DEG = (40.0, 110.0, 30.0)


@pytest.fixture(scope='module', params=['ellipsoid', 'convex'])
def geometry(request):
    """Return the sections of an object of the catalogue."""
    return section_curves(find_part(request.param), FINGER)


def planned(geometry, rules, euler_deg=EULER_DEG, mode=Mode.ROBUST, **more):
    """Return a plan by some rules."""
    turn = Rotation.from_euler('ZYZ', euler_deg, degrees=True)
    return plan_reorientation(
        geometry,
        Pose(),
        Pose.of((0.0, 0.0, 0.0), turn),
        FINGER,
        ContactLaw(),
        SearchOptions(math.radians(20.0), mode),
        rules,
        **more,
    )


def cost_deg(geometry, rules, euler_deg=EULER_DEG):
    """Return what a plan costs, infinity if there is none."""
    try:
        return planned(geometry, rules, euler_deg).cost_deg
    except NoPlanExists:
        return math.inf


angles = st.tuples(*[st.integers(-9, 9).map(lambda n: 20.0 * n)] * 3)


@settings(derandomize=True, max_examples=12, deadline=None)
@given(angles)
def test_more_margin_is_never_cheaper(geometry, euler_deg):
    """Costs rise, or stay, with the share of friction that is held back, and then there is none.

    Every plan by more margin is also one by less, and the search finds the cheapest.
    """
    costs = [
        cost_deg(geometry, GripRules(margin_factor=factor), euler_deg)
        for factor in (1.0, 0.9, 0.8, 0.7, 0.6)
    ]
    assert costs == sorted(costs)
    assert math.isfinite(costs[0])


@pytest.mark.parametrize(
    ('name', 'values'),
    [
        ('least_margin_uN', (0.001, 0.05, 0.15, 0.25, 0.35)),
        ('grip_tolerance_uN', (0.01, 0.5, 1.0, 2.0, 4.0)),
    ],
)
def test_larger_margins_in_micronewtons_are_never_cheaper(geometry, name, values):
    """The same for the distance to slipping, and for what grips may be off by."""
    costs = [cost_deg(geometry, GripRules(**{name: value})) for value in values]
    assert costs == sorted(costs)
    assert costs[0] < costs[-1], 'the values do not try both ends'


def test_margins_that_no_contact_has_are_no_plan(geometry):
    """A tenth of the friction, or a margin of ten micronewtons: proven impossible, not cut off."""
    for rules in (GripRules(margin_factor=0.1), GripRules(least_margin_uN=10.0)):
        with pytest.raises(NoPlanExists, match='no plan exists: the search was exhaustive') as no:
            planned(geometry, rules)
        assert no.value.exit_status == 3
        assert no.value.expanded > 0


def test_plans_keep_the_margin_that_was_asked_for(geometry):
    """The tightest removal leaves at least the least margin, at the share of friction given."""
    for least_uN in (0.01, 0.05, 0.1):
        plan = planned(geometry, GripRules(least_margin_uN=least_uN))
        margins = [step.hold.margin_uN for step in plan.steps if step.kind.value == 'remove']
        assert margins
        assert min(margins) >= least_uN - 1e-6
        assert plan.tightest[1].margin_uN == min(
            step.hold.margin_uN for step in plan.steps if step.hold is not None
        )
        check_forces(plan)


def test_the_paper_knows_no_margins(geometry):
    """In paper mode the rules of grips do not change what is planned, only what is pressed."""
    one, other = (
        planned(geometry, rules, (40.0, 120.0, 20.0), Mode.PAPER)
        for rules in (GripRules(), GripRules(margin_factor=0.1, least_margin_uN=10.0))
    )
    assert one.cost_deg == other.cost_deg
    assert one.tightest is other.tightest is None


def test_equal_requests_are_equal_byte_for_byte(geometry):
    """Forces, windows and margins included: two plans as files differ in nothing but the times."""

    def text():
        content = plan_to_dict(planned(geometry, GripRules(), clock=lambda: 0.0))
        return json.dumps(content, allow_nan=False)

    assert text() == text()


@pytest.mark.parametrize(
    ('changes', 'field'),
    [
        ({'margin_factor': 0.0}, 'margin'),
        ({'margin_factor': 1.2}, 'margin'),
        ({'roll_factor': -0.1}, 'roll-margin'),
        ({'least_margin_uN': 0.0}, 'least-margin'),
        ({'nominal_grip_uN': -5.0}, 'grip'),
        ({'grip_tolerance_uN': 0.0}, 'grip-tolerance'),
    ],
)
def test_rules_that_are_none_are_refused(changes, field):
    """Shares above one, and forces of zero and less, are named as the user writes them."""
    with pytest.raises(InvalidParameter, match=f'^{field} is .*; allowed: a number > 0'):
        GripRules(**changes)
