# SPDX-License-Identifier: Apache-2.0
"""Quality of service of every topic of microhand, stated here and nowhere else.

Publisher and subscriber of a topic use the same profile; all are reliable, nothing is sampled.
Only a display may look at STATE topics by the profile DISPLAY.
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


SETPOINTS = _reliable(100, DurabilityPolicy.VOLATILE)
"""``finger_N/setpoints``. Volatile: old setpoints must not reach a driver that starts late."""

STATE = _reliable(100, DurabilityPolicy.VOLATILE)
"""``finger_N/state``: one second at the default rate, 100 Hz."""

CONTACT = _reliable(100, DurabilityPolicy.VOLATILE)
"""``finger_N/contact``: only the latest counts, but the one that says "touched" must arrive."""

EVENTS = _reliable(100, DurabilityPolicy.TRANSIENT_LOCAL)
"""``events``. A recorder that joins late still gets what happened before."""

LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Topics that carry a present state, e.g. ``sequencer/state``: a late subscriber sees it."""

DIAGNOSTICS = _reliable(10, DurabilityPolicy.VOLATILE)
"""``/diagnostics``, as the tools of ROS expect it."""

DISPLAY = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""Of those who only look: the latest state, and no publisher ever waits for them."""
