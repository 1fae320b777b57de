# SPDX-License-Identifier: Apache-2.0
"""Moves: the stage protocol, a simulated piezo stage, and the driver node that streams to it."""
