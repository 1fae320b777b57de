#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Put the workspace in the environment, then become the command, so that signals reach it.
set -e
source /microhand/ros_ws/install/setup.bash
exec "$@"
