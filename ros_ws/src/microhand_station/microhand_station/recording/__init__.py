# SPDX-License-Identifier: Apache-2.0
"""What is kept of a run: written while it lasts, read back afterwards.

In the order of the data: ``recorded_topics``, ``ros2msg_schema``, ``setpoint_tally``,
``run_writer``, ``recorder_node`` while the station runs; ``record_scan``, ``recover``,
``run_reader``, ``report`` afterwards, without ROS.
"""
