# SPDX-License-Identifier: Apache-2.0
"""Bring-up: starts the nodes of a station as processes, and ends them all."""
