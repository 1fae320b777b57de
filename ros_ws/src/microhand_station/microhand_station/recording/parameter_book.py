# SPDX-License-Identifier: Apache-2.0
"""Nodes of the station → all their parameters, as they are now."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rclpy.task import Future

LOOK_S = 0.5
"""How often new nodes are looked for [s]."""
ASK_AGAIN_S = 1.0
"""A fresh node may lose its first answers: it is asked again after this time [s]."""


@dataclass
class _Page:
    """What is known of one node."""

    listing: Client
    getting: Client
    values: dict[str, Any] = field(default_factory=dict)
    complete: bool = False
    asked_s: float = -math.inf


class ParameterBook:
    """Keeps the parameters of all nodes below the namespace of a node.

    Each node is asked once, when it appears; later changes come by ``/parameter_events``.

    Parameters
    ----------
    node : Node
        Asks and listens, in its own callbacks.
    steady_s : callable
        Steady clock [s].
    """

    def __init__(self, node: Node, steady_s: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._steady_s = steady_s
        self._pages: dict[str, _Page] = {}
        node.create_subscription(
            ParameterEvent, '/parameter_events', self._change, qos_profile_parameter_events
        )
        node.create_timer(LOOK_S, self._look)

    def text(self) -> dict[str, str]:
        """Return what is known: parameters of each node as a JSON object."""
        return {
            name: json.dumps(page.values, sort_keys=True)
            for name, page in sorted(self._pages.items())
            if page.complete
        }

    def _look(self) -> None:
        """Ask nodes that have not answered yet; forget those that are gone."""
        below = self._node.get_namespace().rstrip('/') + '/'
        names = {
            f'{namespace.rstrip("/")}/{name}'
            for name, namespace in self._node.get_node_names_and_namespaces()
            if not name.startswith('_')
        }
        here = {name for name in names if name.startswith(below)}
        for missing in self._pages.keys() - here:
            if self._pages[missing].listing.service_is_ready():
                continue  # it was cut off for a while: ROS forgot its name, but it is there
            page = self._pages.pop(missing)
            self._node.destroy_client(page.listing)
            self._node.destroy_client(page.getting)
        for name in here - self._pages.keys():
            self._pages[name] = _Page(
                self._node.create_client(ListParameters, f'{name}/list_parameters'),
                self._node.create_client(GetParameters, f'{name}/get_parameters'),
            )
        for page in self._pages.values():
            if not page.complete and self._steady_s() - page.asked_s > ASK_AGAIN_S:
                self._ask(page)

    def _ask(self, page: _Page) -> None:
        """Ask a node which parameters it has."""
        if page.listing.service_is_ready() and page.getting.service_is_ready():
            page.asked_s = self._steady_s()
            future = page.listing.call_async(ListParameters.Request())
            future.add_done_callback(partial(self._ask_values, page))

    def _ask_values(self, page: _Page, listed: Future) -> None:
        """Ask a node for the values of all its parameters."""
        names = list(listed.result().result.names)
        future = page.getting.call_async(GetParameters.Request(names=names))
        future.add_done_callback(partial(self._fill, page, names))

    def _fill(self, page: _Page, names: list[str], answered: Future) -> None:
        """Note the values."""
        values = map(parameter_value_to_python, answered.result().values)
        page.values = dict(zip(names, map(_plain, values), strict=False))
        page.complete = True

    def _change(self, event: ParameterEvent) -> None:
        """Note what has changed."""
        page = self._pages.get(event.node)
        if page is None:
            return
        for parameter in (*event.new_parameters, *event.changed_parameters):
            page.values[parameter.name] = _plain(parameter_value_to_python(parameter.value))
        for parameter in event.deleted_parameters:
            page.values.pop(parameter.name, None)


def _plain(value: Any) -> Any:
    """Return a value that JSON has; a number that it has not, as text."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, str | int | float) or value is None:
        return value
    return [_plain(item) for item in value]
