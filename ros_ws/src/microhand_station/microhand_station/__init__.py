# SPDX-License-Identifier: Apache-2.0
"""Run a station: sequencer, recorder, launch files and the microhand command."""
