# SPDX-License-Identifier: Apache-2.0
"""The twin as a node: stands in for the object in a simulated station."""
