# SPDX-License-Identifier: Apache-2.0
"""The planner on ROS: messages to values and back, and the node `planner`."""
