# SPDX-License-Identifier: Apache-2.0
"""Nodes of many messages, without rclpy's own listeners for events of their topics.

By default rclpy looks after two events of each publisher and subscription, to warn of a QoS or a
type that does not fit. For every message that arrives its executor goes through all of them: a
third of what a recorder does. Publishers and subscribers of a station state their QoS in one
place (`qos`), and what does not fit is told by the other side.
"""

from __future__ import annotations

from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription


class LeanNode(Node):
    """A node, or the first base of one, whose topics have no event handlers unless given."""

    def create_publisher(self, *arguments: Any, **options: Any) -> Publisher:
        """As `rclpy.node.Node.create_publisher`."""
        options.setdefault('event_callbacks', PublisherEventCallbacks(use_default_callbacks=False))
        return super().create_publisher(*arguments, **options)

    def create_subscription(self, *arguments: Any, **options: Any) -> Subscription:
        """As `rclpy.node.Node.create_subscription`."""
        options.setdefault(
            'event_callbacks', SubscriptionEventCallbacks(use_default_callbacks=False)
        )
        return super().create_subscription(*arguments, **options)
