# SPDX-License-Identifier: Apache-2.0
"""The sequencer: takes a plan, checks it, and streams it to the stages."""
