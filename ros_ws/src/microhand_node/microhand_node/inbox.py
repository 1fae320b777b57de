# SPDX-License-Identifier: Apache-2.0
"""Topics of many messages: looked through at a steady rate, instead of waited for.

For each message that arrives, rclpy's executor builds the set of all that it waits for anew, and
twice: that takes several times as long as to read the message. A node that is told of three stages
a hundred times a second looks into its inbox instead, as often as it acts on what it finds.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription


class NeverWaitedFor(CallbackGroup):
    """A group whose members no executor waits for."""

    def can_execute(self, entity: Any) -> bool:
        """Return False: somebody else looks."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return False, as `can_execute`."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Never called."""


@dataclass(frozen=True)
class _Letter:
    """A message that has been taken."""

    received_ns: int
    deliver: Callable[[], None]


class Inbox:
    """Subscriptions of a node that are emptied on demand, by any of its threads.

    Parameters
    ----------
    node : Node
        Has the subscriptions.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._group = NeverWaitedFor()
        self._boxes: list[tuple[Subscription, Callable[..., None]]] = []
        self._lock = threading.Lock()

    def subscribe(
        self,
        kind: type,
        name: str,
        callback: Callable[..., None],
        qos: QoSProfile,
        *,
        raw: bool = False,
    ) -> None:
        """Have messages of a topic kept until `empty` is called; the depth of `qos` bounds them.

        Parameters
        ----------
        kind : type
            Of the messages.
        name : str
            Of the topic.
        callback : callable
            Gets each message; if `raw`, as bytes, together with what the middleware knows of it.
        qos : QoSProfile
            Of the subscription.
        raw : bool
            Leave the messages as they came.
        """
        subscription = self._node.create_subscription(
            kind, name, lambda _: None, qos, callback_group=self._group, raw=raw
        )
        self._boxes.append((subscription, callback))

    def empty(self) -> None:
        """Hand over what has arrived, oldest first, whatever its topic."""
        with self._lock:
            letters: list[_Letter] = []
            for subscription, callback in self._boxes:
                letters += _take_all(subscription, callback)
            letters.sort(key=attrgetter('received_ns'))
            for letter in letters:
                letter.deliver()


def _take_all(subscription: Subscription, callback: Callable[..., None]) -> list[_Letter]:
    """Take all messages of one topic."""
    letters: list[_Letter] = []
    with subscription.handle:
        while True:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                return letters
            message, info = taken
            arguments = (message, info) if subscription.raw else (message,)
            letters.append(_Letter(info['received_timestamp'], partial(callback, *arguments)))
