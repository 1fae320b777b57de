# SPDX-License-Identifier: Apache-2.0
"""The server of the page: viser, behind the gate."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable, Iterator
from typing import Any

import viser
import websockets.asyncio.server
from websockets import Headers
from websockets.http11 import Request, Response

from microhand_planner.core.errors import BadRequest, RunFailed
from microhand_station.view.address import ViewAddress
from microhand_station.view.gate import NEVER_FRAMED, Answer, Gate

BACKLOG = 100
DO_S = 30.0
"""Longest wait for a change of the page [s]: usually a millisecond."""

Process = Callable[[Any, Request], Response | None]


class PageServer(viser.ViserServer):
    """A server of viser that nobody can make share the page with the world."""

    def do(self, work: Callable[[], None]) -> None:
        """Have the thread that sends messages change the page, and return when it has.

        viser lets every thread do so, but wakes its own from there by an `asyncio.Event`, which
        is for one thread: now and then "deque mutated during iteration" would end the caller.
        Not to be called by that thread itself.
        """
        asyncio.run_coroutine_threadsafe(_done(work), self.get_event_loop()).result(DO_S)

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Share nothing: any browser may ask for it."""
        del verbose
        return None


async def _done(work: Callable[[], None]) -> None:
    work()


def open_page_server(address: ViewAddress, label: str) -> PageServer:
    """Listen at an address, and serve what is put on the page.

    Parameters
    ----------
    address : ViewAddress
        Where, and who may come.
    label : str
        Title of the page's main panel.

    Raises
    ------
    BadRequest
        Nothing can listen there.
    """
    # whoever breaks off a request is no trouble of the station
    logging.getLogger('websockets.server').setLevel(logging.CRITICAL)
    listening = _listen(address)
    port = listening.getsockname()[1]
    with _guarded(Gate(address.token, port), listening) as served:
        server = PageServer(host=address.host, port=port, label=label, verbose=False)
    if not served:
        raise RunFailed('viser did not open its server as it used to: nobody guards the page')
    return server


def _listen(address: ViewAddress) -> socket.socket:
    """Return a socket that listens."""
    try:
        family, _, _, _, where = socket.getaddrinfo(
            address.host, address.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except OSError as error:
        raise BadRequest(
            'view-host', f'{address.host} ({error.strerror})', 'an address of this machine'
        ) from error
    try:
        return socket.create_server(where, family=family, backlog=BACKLOG)
    except OSError as error:
        reason = str(error.strerror).partition(' (')[0]
        raise BadRequest(
            'view-port',
            f'{address.port} of {address.host} ({reason})',
            'a free port of this machine; 0: any',
        ) from error


@contextlib.contextmanager
def _guarded(gate: Gate, listening: socket.socket) -> Iterator[list[str]]:
    """Within, a server that viser opens listens at `listening`, behind the gate.

    viser has no place of its own for this. It opens its server by `websockets`, which lets a
    function look at the head of each request, and takes a socket that listens already.
    """
    original = websockets.asyncio.server.serve
    served: list[str] = []

    def serve(handler: Any, host: str, port: int, *, process_request: Process, **options: Any):  # type: ignore[no-untyped-def]
        def guard(connection: Any, request: Request) -> Response | None:
            answer = gate.judge(request.path, dict(request.headers.raw_items()))
            if answer is not None:
                return _response(answer)
            page = process_request(connection, request)
            if page is not None:
                page.headers.update(NEVER_FRAMED)
            return page

        served.append(f'{host}:{port}')
        return original(handler, sock=listening, process_request=guard, **options)

    websockets.asyncio.server.serve = serve  # type: ignore[assignment,misc]
    try:
        yield served
    finally:
        websockets.asyncio.server.serve = original  # type: ignore[misc]


def _response(answer: Answer) -> Response:
    """Return an answer as `websockets` sends it."""
    body = f'microhand: {answer.text}\n'.encode()
    headers = Headers(
        [
            ('Content-Type', 'text/plain; charset=utf-8'),
            ('Content-Length', str(len(body))),
            ('Connection', 'close'),
            *NEVER_FRAMED,
            *answer.headers,
        ]
    )
    return Response(answer.status, answer.status.phrase, headers, body)
