# SPDX-License-Identifier: Apache-2.0
"""The live view: a page in the browser that shows a running station, and asks it for runs."""
