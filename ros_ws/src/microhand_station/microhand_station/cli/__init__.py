# SPDX-License-Identifier: Apache-2.0
"""The command line `microhand`: one module per command."""
