# SPDX-License-Identifier: Apache-2.0
"""What is kept of a run: written while it lasts, read back afterwards.

In the order of the data: ``recorded_topics``, ``ros2msg_schema``, ``setpoint_tally``,
``run_writer``, ``recorder_node`` while the station runs; ``record_scan``, ``recover`` afterwards,
without ROS. What a record says is the business of ``microhand_station.analysis``.
"""
