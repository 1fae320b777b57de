# SPDX-License-Identifier: Apache-2.0
"""Judging what the twin says: silent, lost, or too far from the plan."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from microhand_msgs_py.msg import ErrorCode
from scipy.spatial.transform import Rotation

from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import Pose
from microhand_station.contact_config import TwinConfig
from microhand_station.sequencer import object_watch
from microhand_station.sequencer.contact_reference import NO_CONTACT
from microhand_station.sequencer.object_watch import ObjectReport, check_held, deviation

GOOD = ObjectReport(
    arrived_s=10.0, stamp_ns=5, pose=Pose(), held=True, released=True, lost_because=''
)


def failure(check):
    """Return code and sentence of what a check raises."""
    with pytest.raises(RunFailed) as error:
        check()
    return error.value.code, str(error.value)


def test_an_object_that_is_held_passes():
    """A recent report of a held object, released or still fixed, says nothing against going on."""
    check_held(GOOD, now_s=10.4)
    check_held(dataclasses.replace(GOOD, released=False), now_s=10.4)


def test_a_silent_twin_and_a_lost_object_are_two_things():
    """No report is TWIN_MISSING, a loss is OBJECT_LOST with the twin's reason."""
    code, text = failure(lambda: check_held(None, now_s=10.0))
    assert (code, text) == (ErrorCode.TWIN_MISSING, 'the twin is silent')
    code, text = failure(lambda: check_held(GOOD, now_s=11.0))
    assert code == ErrorCode.TWIN_MISSING
    assert text == 'the twin has been silent for 1.00 s; allowed: up to 0.9 s'
    lost = dataclasses.replace(GOOD, held=False, lost_because='no finger touches it')
    code, text = failure(lambda: check_held(lost, now_s=10.1))
    assert (code, text) == (ErrorCode.OBJECT_LOST, 'the object is lost: no finger touches it')


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    turn=st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
    off_deg=st.floats(0.001, 179.0),
    off_um=st.floats(0.0, 50.0),
)
def test_the_deviation_is_what_the_object_was_moved_by(turn, off_deg, off_um):
    """Turned and displaced from any planned pose: the angle and the distance come back."""
    planned = Pose.of((1.0, -2.0, 3.0), Rotation.from_rotvec(turn))
    away = Rotation.from_rotvec(np.radians([0.0, off_deg, 0.0]))
    moved = Pose.of((1.0, -2.0 + 0.6 * off_um, 3.0 + 0.8 * off_um), planned.rotation * away)
    off = deviation(dataclasses.replace(GOOD, pose=moved), planned)
    assert np.degrees(off.angle_rad) == pytest.approx(off_deg, abs=1e-6)
    assert off.distance_um == pytest.approx(off_um, abs=2e-6)  # poses are whole picometres
    assert off.stamp_ns == GOOD.stamp_ns


def test_a_deviation_beyond_the_tolerance_is_a_loss_that_says_how_far():
    """Just inside passes, just outside is OBJECT_LOST with amount and limit."""
    tolerance = TwinConfig(object_tolerance_deg=4.0, object_tolerance_um=1.5)
    object_watch.Deviation(0, np.radians(3.9), 1.4).check(tolerance)
    turned = object_watch.Deviation(0, np.radians(4.16), 0.0)
    code, text = failure(lambda: turned.check(tolerance))
    assert code == ErrorCode.OBJECT_LOST
    assert text.endswith('turned 4.2° away from where the plan has it; allowed: 4°')
    displaced = object_watch.Deviation(0, 0.0, 1.61)
    code, text = failure(lambda: displaced.check(tolerance))
    assert text.endswith('1.61 µm away from where the plan has it; allowed: 1.5 µm')


def test_codes_are_those_of_the_messages():
    """The pure part repeats constants of the interfaces; here they are kept in step."""
    assert object_watch.OBJECT_LOST == ErrorCode.OBJECT_LOST
    assert object_watch.TWIN_MISSING == ErrorCode.TWIN_MISSING
    assert NO_CONTACT == ErrorCode.NO_CONTACT
