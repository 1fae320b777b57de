# SPDX-License-Identifier: Apache-2.0
"""What the nodes of a station have in common: how they start, live, listen, work and end."""
