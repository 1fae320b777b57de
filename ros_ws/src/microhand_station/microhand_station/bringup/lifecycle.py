# SPDX-License-Identifier: Apache-2.0
"""Managed nodes: from unconfigured to active, or a reason why not."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.client import Client
from rclpy.node import Node

from microhand_planner.core.errors import RunFailed
from microhand_station.service_call import call

STAGE_MISSING = 300

TRY_S = 1.0
"""After so long, a question is asked again [s]."""


def activate(node: Node, managed: str, *, who: str, deadline_s: float) -> None:
    """Configure and activate a managed node, from whichever state it is in.

    Parameters
    ----------
    node : Node
        Spun by another thread.
    managed : str
        Name of the managed node, relative to the namespace of `node`.
    who : str
        Whom an error names.
    deadline_s : float
        Longest wait for the node to answer, and then for each transition [s].

    Raises
    ------
    RunFailed
        STAGE_MISSING: it is not there, or it refuses a transition.
    """
    change = node.create_client(ChangeState, f'{managed}/change_state')
    # last: its answer proves that the other will come
    state = node.create_client(GetState, f'{managed}/get_state')

    def ask(client: Client, request: Any, within_s: float = deadline_s) -> Any:
        return call(client, request, deadline_s=within_s, who=who, missing_code=STAGE_MISSING)

    try:
        present = _first_answer(lambda: ask(state, GetState.Request(), TRY_S), deadline_s)
        for begin, transition, name in (
            (State.PRIMARY_STATE_UNCONFIGURED, Transition.TRANSITION_CONFIGURE, 'configure'),
            (State.PRIMARY_STATE_INACTIVE, Transition.TRANSITION_ACTIVATE, 'activate'),
        ):
            if present == begin:
                request = ChangeState.Request(transition=Transition(id=transition))
                if not ask(change, request).success:
                    raise RunFailed(f'{who} refuses to {name}; its log says why', STAGE_MISSING)
                present = ask(state, GetState.Request()).current_state.id
        if present != State.PRIMARY_STATE_ACTIVE:
            raise RunFailed(f'{who} is in the state {present}; allowed: active', STAGE_MISSING)
    finally:
        node.destroy_client(state)
        node.destroy_client(change)


def _first_answer(ask: Callable[[], Any], deadline_s: float) -> int:
    """Ask for the state until there is an answer: DDS takes a while to forget a node that died."""
    give_up_s = time.monotonic() + deadline_s
    while True:
        try:
            present: int = ask().current_state.id
        except RunFailed:
            if time.monotonic() > give_up_s:
                raise
        else:
            return present
