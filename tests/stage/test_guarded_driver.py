# SPDX-License-Identifier: Apache-2.0
"""Guarded streams of a driver in a process of its own: the test is the contact sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest
from geometry_msgs.msg import Point
from microhand_msgs_py.msg import ErrorCode, SetpointChunk, StageState, TipContact
from numpy.typing import NDArray

from microhand_node import qos

if TYPE_CHECKING:
    from tests.stage.conftest import DriverClient

PERIOD_S = 0.002
LEAD_NS = 200_000_000
SPEED_M_S = 5e-6
COUNT = 400

MakeChunk = Callable[..., SetpointChunk]


def xyz(point: Point) -> NDArray[np.float64]:
    """Return the coordinates of a message [m]."""
    return np.array([point.x, point.y, point.z])


class Wall:
    """A sensor that answers each state with whether the tip was beyond `x_m` then."""

    def __init__(self, client: DriverClient) -> None:
        self.x_m = np.inf
        self.silent = False
        finger = client.setpoints.topic_name.rpartition('/')[0]
        self._node = client.node
        self._reports = client.node.create_publisher(TipContact, f'{finger}/contact', qos.CONTACT)
        self._states = client.node.create_subscription(
            StageState, f'{finger}/state', self._answer, qos.STATE
        )
        client.wait(lambda: self._reports.get_subscription_count() == 1, 'the driver to listen')

    def _answer(self, state: StageState) -> None:
        if not self.silent:
            touching = state.position.x >= self.x_m
            self._reports.publish(TipContact(header=state.header, in_contact=touching))

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_subscription(self._states)
        self._node.destroy_publisher(self._reports)


@pytest.fixture
def wall(active: DriverClient) -> Iterator[Wall]:
    """Return a sensor that reports no contact yet."""
    wall = Wall(active)
    yield wall
    wall.close()


def approach(
    active: DriverClient, make_chunk: MakeChunk, count: int = COUNT
) -> NDArray[np.float64]:
    """Send a guarded way along x, by default 4 µm in 0.8 s; return its positions [m]."""
    way_m = SPEED_M_S * PERIOD_S * np.arange(count)
    wanted_m = xyz(active.state.command) + np.outer(way_m, [1.0, 0.0, 0.0])
    active.setpoints.publish(
        make_chunk(
            active.now_ns() + LEAD_NS,
            wanted_m,
            period_s=PERIOD_S,
            stream=active.state.stream + 1,
            last=True,
            guarded=True,
        )
    )
    return wanted_m


def test_a_guarded_approach_ends_at_the_wall(
    active: DriverClient, wall: Wall, make_chunk: MakeChunk
) -> None:
    """It is held behind the wall; the contact is where the first touching state was measured."""
    wall.x_m = active.state.command.x + 1e-6
    wanted_m = approach(active, make_chunk)
    end = active.wait_state(
        lambda state: state.guard_tripped and state.on_target, 'the guard to trip'
    )
    assert (end.mode, end.error_code) == (StageState.HOLDING, ErrorCode.SUCCESS)
    assert (end.stream, end.received) == (1, COUNT)
    first = next(state for state in active.states if state.position.x >= wall.x_m)
    np.testing.assert_allclose(xyz(end.contact_position), xyz(first.position), atol=1e-12)
    assert end.contact_position.x < end.command.x < wanted_m[-1, 0]

    tripped_at = len(active.states)
    active.wait(lambda: len(active.states) > tripped_at + 60, 'further states')
    np.testing.assert_array_equal(xyz(active.state.command), xyz(end.command))
    assert active.state.guard_tripped


def test_an_approach_that_meets_nothing_ends_where_it_should(
    active: DriverClient, wall: Wall, make_chunk: MakeChunk
) -> None:
    """No contact: the whole way, no trip, and no contact position."""
    wanted_m = approach(active, make_chunk)
    active.wait_state(lambda state: state.received == COUNT, 'the setpoints')
    end = active.wait_rest()
    assert not end.guard_tripped
    assert np.isnan(xyz(end.contact_position)).all()
    np.testing.assert_allclose(xyz(end.command), wanted_m[-1], atol=1e-12)


def test_a_sensor_that_falls_silent_stops_the_approach(
    active: DriverClient, wall: Wall, make_chunk: MakeChunk
) -> None:
    """A second without a report: NO_CONTACT names the finger, the stage stands."""
    wanted_m = approach(active, make_chunk, count=3000)
    active.wait_state(lambda state: state.command.x > wanted_m[20, 0], 'motion')
    wall.silent = True
    end = active.wait_mode(StageState.FAULT)
    assert end.error_code == ErrorCode.NO_CONTACT
    assert 'finger_2: the latest contact report is' in end.error_msg
    assert end.command.x < wanted_m[-1, 0]
