# SPDX-License-Identifier: Apache-2.0
"""The physics twin: three fingers and an object in MuJoCo, a judge that knows no plan's theory."""
