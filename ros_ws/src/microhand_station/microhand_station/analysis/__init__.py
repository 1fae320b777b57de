# SPDX-License-Identifier: Apache-2.0
"""What a recorded run says, without ROS: `Run.open` reads it, ``report`` shows it."""

from microhand_station.analysis.run import Run

__all__ = ['Run']
