# SPDX-License-Identifier: Apache-2.0
"""A record → the same messages on ROS topics again, in their order and at their pace."""
