# SPDX-License-Identifier: Apache-2.0
"""The ramp behind every stop, against school physics."""

from __future__ import annotations

import numpy as np
import pytest

from stage_driver_sim.brake import Brake

BEGIN_UM = np.array([10.0, 20.0, 30.0])
VELOCITY_UM_S = np.array([300.0, -400.0, 1200.0])  # 1300 µm/s along the path
BRAKE = Brake(5.0, BEGIN_UM, VELOCITY_UM_S, deceleration_um_s2=1e5)


def test_stopping_distance_and_time() -> None:
    """The way is v²/2a along the direction of motion, the time v/a."""
    way_um = BRAKE.position_at(99.0) - BEGIN_UM
    assert np.linalg.norm(way_um) == pytest.approx(1300.0**2 / 2e5)
    np.testing.assert_allclose(way_um / np.linalg.norm(way_um), VELOCITY_UM_S / 1300.0)
    assert BRAKE.end_s == pytest.approx(5.0 + 1300.0 / 1e5)


def test_velocity_falls_linearly_from_the_first_to_zero() -> None:
    """Finite differences of the position give v(t) = v0 (1 - t/T): no jump at either end."""
    step_s = 1e-6
    for share in (0.0, 0.25, 0.5, 0.9):
        t = 5.0 + share * (BRAKE.end_s - 5.0)
        slope_um_s = (BRAKE.position_at(t + step_s) - BRAKE.position_at(t)) / step_s
        np.testing.assert_allclose(slope_um_s, VELOCITY_UM_S * (1.0 - share), atol=0.2)


def test_at_rest_there_is_nothing_to_brake() -> None:
    """Without velocity the brake ends when it begins, where it begins."""
    still = Brake(5.0, BEGIN_UM, np.zeros(3), deceleration_um_s2=1e5)
    assert still.end_s == 5.0
    np.testing.assert_array_equal(still.position_at(6.0), BEGIN_UM)
