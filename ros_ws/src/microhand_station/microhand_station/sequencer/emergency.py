# SPDX-License-Identifier: Apache-2.0
"""All stages at once: have they stopped, and release them again."""

from __future__ import annotations

import time
from collections.abc import Sequence

from rclpy.task import Future

from microhand_planner.core.errors import RunFailed
from microhand_station.sequencer.stage_link import StageLink
from microhand_station.sequencer.stage_watch import STAGE_MISSING

STOP_ANSWER_S = 0.5
"""Longest wait for the stages to confirm that they stop [s]."""
RESET_ANSWER_S = 4.0
"""Longest wait for a stage to answer a reset [s]."""
POLL_S = 0.005


def confirm_stop(asked: Sequence[Future | None]) -> None:
    """Wait until all stages have confirmed that they stop.

    Parameters
    ----------
    asked : sequence of 3 Future or None
        What `StageLink.ask_to_stop` returned for fingers 1, 2, 3.

    Raises
    ------
    RunFailed
        STAGE_MISSING: names the fingers that did not confirm. The others have been stopped.
    """
    give_up_s = time.monotonic() + STOP_ANSWER_S
    while any(future is not None and not future.done() for future in asked):
        if time.monotonic() > give_up_s:
            break
        time.sleep(POLL_S)
    silent = [
        str(finger)
        for finger, future in enumerate(asked, start=1)
        if future is None or not future.done() or future.result().error_code
    ]
    if silent:
        raise RunFailed(f'not confirmed by finger {", ".join(silent)}', STAGE_MISSING)


def release_stages(stages: Sequence[StageLink]) -> None:
    """Clear stops and faults of all stages; each is asked, whatever the others answer.

    Raises
    ------
    RunFailed
        What the first stage that failed says.
    """
    failures = []
    for stage in stages:
        try:
            stage.reset(RESET_ANSWER_S)
        except RunFailed as error:
            failures.append(error)
    if failures:
        raise failures[0]
