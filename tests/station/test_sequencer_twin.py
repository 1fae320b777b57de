# SPDX-License-Identifier: Apache-2.0
"""The sequencer and the object: fingers that feel for it, a twin that judges it."""

import dataclasses

import numpy as np
import pytest
from microhand_msgs_py.msg import ErrorCode, SequencerState

from microhand_station.client import StationError


def test_only_fingers_that_come_to_the_object_are_guarded(first_run):
    """Two streams of the plan are guarded: fingers 1 and 2, then 3; each meets what it should."""
    guarded = {finger: set() for finger in (1, 2, 3)}
    for finger, chunks in first_run.chunks.items():
        for stream in {chunk.stream for chunk in chunks}:
            flags = {chunk.guarded for chunk in chunks if chunk.stream == stream}
            assert len(flags) == 1
            if flags.pop():
                guarded[finger].add(stream)
    assert guarded[1] == guarded[2]
    assert [len(guarded[finger]) for finger in (1, 2, 3)] == [1, 1, 1]
    assert min(guarded[1]) < min(guarded[3])
    met = [text for text in first_run.events if 'met the object' in text]
    assert [text[:8] for text in met] == ['finger 1', 'finger 2', 'finger 3']


def test_the_object_is_held_and_ends_at_its_goal(first_run):
    """The twin judged the whole run: held, within a tenth of a degree."""
    assert first_run.result.held
    assert first_run.result.final_error_rad < np.radians(0.1)
    last = first_run.object
    assert (last.held, last.released, last.lost_because) == (True, True, '')
    assert [contact.in_contact for contact in last.contacts] == [True, True, False]


def test_a_finger_that_is_not_where_it_seems_still_presses_as_planned(bench, sphere_plan):
    """Finger 3 is 0.2 µm nearer than the station believes: it is met early, and all goes well."""
    nearer = [-1e-4, -1e-4 - 0.2e-6, -1e-4]
    bench.tell_twin(finger_3__base=nearer)
    try:
        result = bench.execute(sphere_plan(10.0))
    finally:
        bench.tell_twin(finger_3__base=[-1e-4] * 3)
    assert result.held
    assert result.final_error_rad < np.radians(0.1)
    (text,) = [text for text in bench.watcher.events if text.startswith('finger 3 met')]
    assert float(text.split()[5]) == pytest.approx(200.0, abs=40.0)


@pytest.mark.parametrize(
    ('off_um', 'message'),
    [(-0.4, r'finger 3 met the object 0\.[34]\d µm too early'), (3.0, 'finger 3 met nothing')],
)
def test_an_object_that_is_not_met_where_it_should_be_ends_the_run(
    bench, sphere_plan, off_um, message
):
    """NO_CONTACT names the finger; the stages stand, and the object was not lost by it."""
    bench.tell_twin(finger_3__base=[-1e-4, -1e-4 + 1e-6 * off_um, -1e-4])
    try:
        with pytest.raises(StationError, match=message) as error:
            bench.execute(sphere_plan(10.0))
    finally:
        bench.tell_twin(finger_3__base=[-1e-4] * 3)
    assert error.value.code == ErrorCode.NO_CONTACT
    assert error.value.execution.held
    bench.watcher.wait(lambda: all(s.on_target for s in bench.watcher.stages.values()))


def test_an_object_that_slips_is_lost_and_never_reported_as_held(bench, sphere_plan):
    """Almost no friction: OBJECT_LOST, on a ramp, exit status 4."""
    bench.tell_twin(friction=0.001)
    try:
        with pytest.raises(StationError, match='the object is lost') as error:
            bench.execute(sphere_plan(30.0))
    finally:
        bench.tell_twin(friction=-1.0)
    assert (error.value.code, error.value.exit_status) == (ErrorCode.OBJECT_LOST, 4)
    assert error.value.execution.held is False
    bench.watcher.wait_state(SequencerState.IDLE)
    bench.watcher.wait(lambda: all(s.on_target for s in bench.watcher.stages.values()))


def test_an_object_other_than_the_plans_is_refused_and_nothing_moves(bench, sphere_plan):
    """The twin compares hashes before anything moves."""
    with pytest.raises(StationError, match='twin: object_hash is 0') as error:
        bench.client.execute(
            dataclasses.replace(sphere_plan(10.0), object_sha256='0' * 64), object_name=bench.mesh
        )
    assert error.value.code == ErrorCode.INVALID_PLAN
    with pytest.raises(StationError, match='twin: object is sphere; allowed: a name of the cat'):
        bench.client.execute(sphere_plan(10.0))
    assert not any(bench.watcher.chunks.values())
