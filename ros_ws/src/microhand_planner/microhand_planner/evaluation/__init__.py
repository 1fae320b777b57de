# SPDX-License-Identifier: Apache-2.0
"""The planner measured: the tables of [Kumar2021] beside ours, and how long plans take."""
