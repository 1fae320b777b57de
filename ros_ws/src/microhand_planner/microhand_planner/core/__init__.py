# SPDX-License-Identifier: Apache-2.0
"""The planner's core: µm, µN, rad and s, and no ROS."""
