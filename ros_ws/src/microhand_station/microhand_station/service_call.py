# SPDX-License-Identifier: Apache-2.0
"""Call a service from a thread that does not spin, and wait no longer than allowed."""

from __future__ import annotations

import threading
import time
from typing import Any

from rcl_interfaces.srv import ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from microhand_planner.core.errors import RunFailed

POLL_S = 0.02
"""How often a service that is not there yet is looked for [s]."""
ASK_AGAIN_S = 1.0
"""A first answer that takes longer than this has been lost [s]."""
GONE_S = 0.5
"""A service does not look ready for a moment, shorter than this, when a node of the same name
begins, or is forgotten [s]."""


def call(
    client: Client,
    request: Any,
    *,
    deadline_s: float,
    who: str,
    missing_code: int,
    repeatable: bool = False,
) -> Any:
    """Return the response of a service; its node is spun by another thread.

    Parameters
    ----------
    client : Client
        Of the service.
    request : message
        What to send.
    deadline_s : float
        Longest wait, for the service and for its answer together [s].
    who : str
        Whom the error names.
    missing_code : int
        Code of the error if nobody answers.
    repeatable : bool
        Served twice it does no harm: it is sent again when no answer comes, as happens when the
        server has only just been started, see `greet`.

    Raises
    ------
    RunFailed
        The service is not there, or does not answer in time.
    """
    give_up_s = time.monotonic() + deadline_s
    while not client.service_is_ready():
        if time.monotonic() > give_up_s:
            raise RunFailed(f'{who} is not there', missing_code)
        time.sleep(POLL_S)
    answered = threading.Event()
    answers: list[Any] = []

    def keep(future: Future) -> None:
        answers.append(future.result())
        answered.set()

    def send() -> Future:
        future = client.call_async(request)
        future.add_done_callback(keep)
        return future

    future, ask_again_s = send(), time.monotonic() + ASK_AGAIN_S
    seen_s = time.monotonic()
    try:
        while not answered.wait(POLL_S):
            if time.monotonic() > give_up_s:
                raise RunFailed(f'{who} does not answer within {deadline_s:g} s', missing_code)
            if client.service_is_ready():
                seen_s = time.monotonic()
            elif time.monotonic() > seen_s + GONE_S:
                raise RunFailed(f'{who} is gone', missing_code)
            if repeatable and time.monotonic() > ask_again_s:
                client.remove_pending_request(future)
                future, ask_again_s = send(), time.monotonic() + ASK_AGAIN_S
    finally:
        client.remove_pending_request(future)
    return answers[0]


def greet(node: Node, server: str, *, deadline_s: float, who: str, missing_code: int) -> None:
    """Return when another node is known to answer this one.

    Right after a process has appeared, its services can look ready while it does not know yet
    where to send the answers of a client: it serves the request, and the answer is lost for good.
    So the first question is one that may be asked again. Endpoints are announced in the order in
    which they were made: an answer to the youngest client proves the older ones of the node.

    Parameters
    ----------
    node : Node
        Has the clients that will be used; spun by another thread.
    server : str
        Name of the other node, relative to the namespace.
    deadline_s, who, missing_code
        As in `call`.

    Raises
    ------
    RunFailed
        The other node does not answer in time.
    """
    give_up_s = time.monotonic() + deadline_s
    client = node.create_client(ListParameters, f'{server}/list_parameters')
    try:
        while time.monotonic() < give_up_s:
            if not client.service_is_ready():
                time.sleep(POLL_S)
                continue
            answered = threading.Event()
            future = client.call_async(ListParameters.Request())
            future.add_done_callback(lambda _, answered=answered: answered.set())
            if answered.wait(ASK_AGAIN_S):
                return
            client.remove_pending_request(future)
    finally:
        node.destroy_client(client)
    raise RunFailed(f'{who} is not there', missing_code)
