# SPDX-License-Identifier: Apache-2.0
"""To a GCS controller over TCP: bytes there, replies back, within a stated time."""

from __future__ import annotations

import re
import socket
import time
from typing import Protocol

from stage_driver_sim.errors import InvalidParameter, StageSilent
from stage_driver_sim.gcs.syntax import ReplySplitter

CONNECT_S = 1.0
"""Longest time for the controller to accept a connection [s]."""
GREETING_S = 2.0
"""Longest time for its first answers [s]: nothing moves yet, and it may just have started."""
ANSWER_S = 0.4
"""Longest time for it to answer after that [s]; usually it takes one or two milliseconds."""
PORT = 50_000
"""Of PI's controllers."""

ADDRESS = re.compile(r'^(?P<host>[A-Za-z0-9._-]+)(:(?P<port>[0-9]{1,5}))?$')


class Connection(Protocol):
    """Carries commands to a controller, and its replies back."""

    def exchange(self, data: bytes, replies: int, now_s: float) -> list[list[str]]:
        """Send commands, and return the lines of the replies that they have.

        Parameters
        ----------
        data : bytes
            Complete commands.
        replies : int
            How many of them are answered.
        now_s : float
            Present time [s], for a controller that has no clock of its own.

        Raises
        ------
        StageSilent
            No answer in time, or the connection broke: it is of no use any more.
        """

    def close(self) -> None:
        """End the connection."""


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of ``host:port`` or ``host``.

    Raises
    ------
    InvalidParameter
        It is neither.

    Examples
    --------
    >>> parse_address('192.168.168.10'), parse_address('stage-2.lab:5001')
    (('192.168.168.10', 50000), ('stage-2.lab', 5001))
    """
    found = ADDRESS.match(text)
    port = int(found['port'] or PORT) if found else 0
    if found is None or not 1 <= port <= 65_535:
        raise InvalidParameter(
            f'gcs_address is {text!r}; allowed: host:port, port 1 to 65535, by default {PORT}'
        )
    return found['host'], port


class TcpConnection:
    """A connection over TCP; see `Connection`.

    Parameters
    ----------
    host : str
        Name or address.
    port : int
        Of the controller.

    Raises
    ------
    StageSilent
        Nobody accepts the connection within `CONNECT_S`.
    """

    def __init__(self, host: str, port: int) -> None:
        self._name = f'{host}:{port}'
        self._replies = ReplySplitter()
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
        except OSError as error:
            raise StageSilent(f'no controller at {self._name}: {_reason(error)}') from error
        self._greeted_s = time.monotonic() + GREETING_S
        # Small packets, each of them awaited by the other side: nothing to gather.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def exchange(self, data: bytes, replies: int, now_s: float) -> list[list[str]]:
        """Send commands, and return the lines of the replies that they have."""
        begin_s = time.monotonic()
        give_up_s = max(begin_s + ANSWER_S, self._greeted_s)
        received: list[list[str]] = []
        try:
            self._socket.settimeout(give_up_s - begin_s)
            self._socket.sendall(data)
            while len(received) < replies:
                left_s = give_up_s - time.monotonic()
                if left_s <= 0.0:
                    raise TimeoutError
                self._socket.settimeout(left_s)
                arrived = self._socket.recv(4096)
                if not arrived:
                    raise StageSilent(f'{self._name} closed the connection')
                received += self._replies.feed(arrived)
        except TimeoutError:
            asked = data.decode('latin-1').strip()
            raise StageSilent(
                f'{self._name} did not answer {asked[:40]!r} within {give_up_s - begin_s:.1f} s'
            ) from None
        except OSError as error:
            raise StageSilent(f'{self._name}: {_reason(error)}') from error
        if len(received) > replies or not self._replies.empty:
            raise StageSilent(f'{self._name} answers what it was not asked')
        return received

    def close(self) -> None:
        """End the connection."""
        self._socket.close()


def _reason(error: OSError) -> str:
    """Return why a socket failed, in a few words."""
    if isinstance(error, TimeoutError):
        return f'no answer within {CONNECT_S:g} s'
    return error.strerror or str(error)
