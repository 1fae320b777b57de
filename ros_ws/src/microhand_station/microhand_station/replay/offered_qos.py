# SPDX-License-Identifier: Apache-2.0
"""QoS of a publisher, as a record keeps it → the profile to publish with again."""

from __future__ import annotations

from typing import Any

import yaml
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

_DEFAULT_DEPTH = 10
# rosbag2 wrote the numbers of rmw before version 9 of its metadata, and the names since.
_HISTORY = {
    'keep_last': HistoryPolicy.KEEP_LAST,
    'keep_all': HistoryPolicy.KEEP_ALL,
    1: HistoryPolicy.KEEP_LAST,
    2: HistoryPolicy.KEEP_ALL,
}
_RELIABILITY = {
    'reliable': ReliabilityPolicy.RELIABLE,
    'best_effort': ReliabilityPolicy.BEST_EFFORT,
    1: ReliabilityPolicy.RELIABLE,
    2: ReliabilityPolicy.BEST_EFFORT,
}
_DURABILITY = {
    'transient_local': DurabilityPolicy.TRANSIENT_LOCAL,
    'volatile': DurabilityPolicy.VOLATILE,
    1: DurabilityPolicy.TRANSIENT_LOCAL,
    2: DurabilityPolicy.VOLATILE,
}


def offered_qos(text: str) -> QoSProfile:
    """Return the profile that offers what the publishers offered.

    Of several publishers the strongest offer counts: reliable, and transient local. Deadlines,
    lifespans and liveliness are left out: a replay need not keep them. What is not there or
    damaged is reliable, volatile, the last ten.

    Parameters
    ----------
    text : str
        YAML as rosbag2 writes it: a list with a profile for each publisher.

    Examples
    --------
    >>> profile = offered_qos('- {history: keep_last, depth: 1, durability: transient_local}')
    >>> profile.depth, profile.durability.name
    (1, 'TRANSIENT_LOCAL')
    """
    profiles = [profile for profile in _profiles(text) if isinstance(profile, dict)]

    def offers(field: str, names: dict[Any, Any], wanted: Any) -> bool:
        return any(names.get(_plain(profile.get(field))) is wanted for profile in profiles)

    depths = [_plain(profile.get('depth')) for profile in profiles]
    depth = max((d for d in depths if isinstance(d, int) and 0 < d < 1 << 31), default=0)
    unreliable = offers('reliability', _RELIABILITY, ReliabilityPolicy.BEST_EFFORT)
    reliable = offers('reliability', _RELIABILITY, ReliabilityPolicy.RELIABLE)
    keeps = offers('durability', _DURABILITY, DurabilityPolicy.TRANSIENT_LOCAL)
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL
        if offers('history', _HISTORY, HistoryPolicy.KEEP_ALL)
        else HistoryPolicy.KEEP_LAST,
        depth=depth or _DEFAULT_DEPTH,
        reliability=ReliabilityPolicy.BEST_EFFORT
        if unreliable and not reliable
        else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if keeps else DurabilityPolicy.VOLATILE,
    )


def _profiles(text: str) -> list[Any]:
    try:
        found = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError):
        return []
    return found if isinstance(found, list) else []


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int) else None
