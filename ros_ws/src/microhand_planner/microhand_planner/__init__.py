# SPDX-License-Identifier: Apache-2.0
"""Plan the reorientation of a micro-object held by three fingers, under adhesion."""
