# SPDX-License-Identifier: Apache-2.0
"""Cutting a trajectory into chunks: nothing lost, nothing reordered, stoppable on its path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microhand_planner.core.trajectory import Pace, time_steps
from microhand_station.sequencer.setpoint_stream import SetpointStream

PACE = Pace()


@pytest.fixture(scope='module')
def trajectory(sphere_plan):
    """Return the trajectory of a small plan."""
    return time_steps(sphere_plan(20.0).steps, PACE)


def drain(stream, size=25):
    """Take all chunks that are left."""
    chunks = []
    while not stream.finished:
        chunks.append(stream.next_chunk(size))
    return chunks


def joined(chunks):
    """Put the setpoints of chunks together."""
    return (
        np.concatenate([chunk.tip_um for chunk in chunks]),
        np.concatenate([chunk.velocity_um_s for chunk in chunks]),
    )


@settings(deadline=None, derandomize=True, max_examples=30)
@given(size=st.integers(1, 400), begin_step=st.integers(0, 2))
def test_chunks_put_together_are_the_trajectory(trajectory, size, begin_step):
    """Whatever the chunk size and the beginning, every setpoint comes once, in order."""
    begin = int(trajectory.step_end[begin_step])
    chunks = drain(SetpointStream(trajectory, begin), size)
    tip, velocity = joined(chunks)
    np.testing.assert_array_equal(tip, trajectory.tip_um[begin:])
    np.testing.assert_array_equal(velocity, trajectory.velocity_um_s[begin:])
    firsts = np.cumsum([0, *(len(chunk.tip_um) for chunk in chunks)])
    assert [chunk.first for chunk in chunks] == firsts[:-1].tolist()
    assert [chunk.last for chunk in chunks] == [False] * (len(chunks) - 1) + [True]
    assert all(0 < len(chunk.tip_um) <= size for chunk in chunks)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(chunks_before=st.integers(0, 60))
def test_a_paused_stream_ends_with_its_step_and_resumes_without_a_gap(trajectory, chunks_before):
    """The two parts meet at the end of a step, at rest, and together are the whole trajectory."""
    first = SetpointStream(trajectory)
    taken = [first.next_chunk() for _ in range(chunks_before) if not first.finished]
    first.pause()
    tip, velocity = joined(taken + drain(first))
    assert first.position in trajectory.step_end
    np.testing.assert_array_equal(velocity[-1], 0.0)
    second = joined(drain(SetpointStream(trajectory, first.position)))
    np.testing.assert_array_equal(
        np.concatenate([tip, second[0][1:]]), trajectory.tip_um[: len(tip) + len(second[0]) - 1]
    )
    assert len(tip) + len(second[0]) - 1 == len(trajectory)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(chunks_before=st.integers(0, 80), duration_s=st.floats(0.02, 0.5))
def test_a_ramp_brakes_along_the_path_and_stands(trajectory, chunks_before, duration_s):
    """After a ramp everything stands, no setpoint left the path or was faster than planned."""
    stream = SetpointStream(trajectory)
    taken = [stream.next_chunk() for _ in range(chunks_before) if not stream.finished]
    sent = stream.sent
    stream.ramp_down(duration_s)
    if sent == len(trajectory):
        assert stream.finished
        return
    tip, velocity = joined(taken + drain(stream))
    np.testing.assert_array_equal(tip[:sent], trajectory.tip_um[:sent])
    np.testing.assert_array_equal(velocity[-1], 0.0)
    assert len(tip) - sent <= max(2, round(duration_s / PACE.period_s))
    # on the path: each setpoint of the ramp lies on the polyline of the planned setpoints
    planned = trajectory.tip_um[max(sent - 1, 0) :].reshape(-1, 9)
    a, chord = planned[:-1], np.diff(planned, axis=0)
    length2 = np.maximum(np.sum(chord**2, axis=1), 1e-30)
    for setpoint in tip[sent:].reshape(-1, 9):
        share = np.clip(np.sum((setpoint - a) * chord, axis=1) / length2, 0.0, 1.0)
        assert np.linalg.norm(setpoint - a - share[:, None] * chord, axis=1).min() < 5e-3
    limit = np.abs(trajectory.velocity_um_s).max() * (1 + 1e-9)
    assert np.abs(velocity).max() <= limit
    assert np.abs(np.diff(tip, axis=0)).max(initial=0.0) / PACE.period_s <= limit * (1 + 1e-6)


def test_a_ramp_slows_down_smoothly(trajectory):
    """Velocities of the ramp are the derivative of its positions and begin at full speed."""
    fastest = int(np.argmax(np.abs(trajectory.velocity_um_s).max(axis=(1, 2))))
    stream = SetpointStream(trajectory)
    taken = [stream.next_chunk(fastest)]
    stream.ramp_down(0.1)
    tip, velocity = joined(taken + drain(stream))
    difference = (tip[2:] - tip[:-2]) / (2 * PACE.period_s)
    scale = np.abs(trajectory.velocity_um_s).max()
    near = slice(fastest - 5, None)
    assert np.abs(difference - velocity[1:-1])[near].max() < 0.05 * scale
    assert np.abs(np.diff(velocity, axis=0))[near].max() < 0.1 * scale


def test_a_ramp_before_the_first_chunk_moves_nothing(trajectory):
    """A stream that is stopped at once is one setpoint at rest."""
    stream = SetpointStream(trajectory)
    stream.ramp_down(0.2)
    chunk = stream.next_chunk()
    assert stream.finished
    assert chunk.last
    np.testing.assert_array_equal(chunk.tip_um, trajectory.tip_um[:1])
    np.testing.assert_array_equal(chunk.velocity_um_s, 0.0)
