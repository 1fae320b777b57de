# SPDX-License-Identifier: Apache-2.0
"""Reports of three stages, at different times and rates, say where all tips were."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from microhand_twin.ros.tip_tracks import STANDSTILL_S, TipTracks

times = st.lists(st.floats(1e-3, 0.05), min_size=2, max_size=40).map(np.cumsum)


def way_um(finger, time_s):
    """Return where a finger is: straight, so that interpolation is exact."""
    return np.array([10.0 * time_s, 3.0 - finger * time_s, float(finger)])


def filled(reports_s):
    """Return tracks with reports of all fingers."""
    tracks = TipTracks()
    for finger, finger_s in enumerate(reports_s):
        for time_s in finger_s:
            tracks.add(finger, float(time_s), way_um(finger, float(time_s)))
    return tracks


@settings(deadline=None, derandomize=True, max_examples=60)
@given(reports_s=st.tuples(times, times, times), share=st.floats(0.0, 1.0))
def test_tips_are_where_all_reports_together_say(reports_s, share):
    """At any time that all reports cover, the tips are on their ways; also after forgetting."""
    tracks = filled(reports_s)
    latest_s = [float(finger_s[-1]) for finger_s in reports_s]
    if max(latest_s) - min(latest_s) < STANDSTILL_S:
        assert tracks.until_s == min(latest_s)
    begin_s = max(float(finger_s[0]) for finger_s in reports_s)
    if begin_s > min(latest_s):
        return
    at_s = begin_s + share * (min(latest_s) - begin_s)
    expected = [way_um(finger, at_s) for finger in range(3)]
    np.testing.assert_allclose(tracks.at(at_s), expected, atol=1e-9)
    tracks.forget_before(at_s)
    np.testing.assert_allclose(tracks.at(at_s), expected, atol=1e-9)
    assert tracks.until_s is not None


def test_beyond_the_reports_the_tips_stand():
    """Before the first report and after the last one nothing is made up."""
    tracks = filled([np.array([1.0, 1.1])] * 3)
    np.testing.assert_array_equal(tracks.at(0.0), [way_um(f, 1.0) for f in range(3)])
    np.testing.assert_array_equal(tracks.at(9.0), [way_um(f, 1.1) for f in range(3)])


def test_nothing_is_known_before_all_have_reported():
    """The fingers that are silent are named, from 1."""
    tracks = TipTracks()
    tracks.add(1, 0.0, np.zeros(3))
    assert tracks.until_s is None
    assert tracks.silent == [1, 3]


def test_a_report_that_came_late_changes_nothing():
    """Time does not go back, as after the restart of a driver with another clock."""
    tracks = filled([np.array([1.0, 1.1])] * 3)
    tracks.add(0, 1.05, np.full(3, 99.0))
    np.testing.assert_allclose(tracks.at(1.05)[0], way_um(0, 1.05))


def test_a_finger_that_fell_silent_is_waited_for_and_then_taken_to_stand():
    """Up to a second the others' time waits for it, then it goes on without it."""
    tracks = filled([np.array([1.0, 1.1])] * 3)
    for finger in (0, 1):
        tracks.add(finger, 1.1 + 0.9 * STANDSTILL_S, np.zeros(3))
    assert tracks.until_s == 1.1
    for finger in (0, 1):
        tracks.add(finger, 1.2 + STANDSTILL_S, np.zeros(3))
    assert tracks.until_s == 1.2 + STANDSTILL_S
