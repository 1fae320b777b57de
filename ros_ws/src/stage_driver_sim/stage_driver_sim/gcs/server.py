# SPDX-License-Identifier: Apache-2.0
"""A simulated GCS controller on the network: one thread, any number of clients.

``gcs_server --help`` says what can be set. It listens on this machine alone unless told otherwise.
"""

from __future__ import annotations

import selectors
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass, field

from stage_driver_sim.faults import FaultSettings
from stage_driver_sim.gcs.simulated_controller import SimulatedController
from stage_driver_sim.gcs.syntax import CommandSplitter

SEND_S = 0.2
"""A client that does not take its replies for so long is let go [s]."""
IDLE_S = 0.1


@dataclass(eq=False)
class _Client:
    """A connection, and what has arrived of its next command."""

    socket: socket.socket
    commands: CommandSplitter = field(default_factory=CommandSplitter)


class GcsServer:
    """Serves a controller over TCP until it is closed.

    Parameters
    ----------
    controller : SimulatedController
        Owned from now on.
    host : str
        Address to listen on.
    port : int
        0: any that is free, see `port`.

    Raises
    ------
    OSError
        The address cannot be used.
    """

    def __init__(
        self, controller: SimulatedController, host: str = '127.0.0.1', port: int = 0
    ) -> None:
        self._controller = controller
        self._lock = threading.Lock()
        self.answer_delay_s = 0.0
        """How long every reply is held back [s]."""
        self._delayed: deque[tuple[float, _Client, bytes]] = deque()
        self._selector = selectors.DefaultSelector()
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._stopping = threading.Event()
        self._disconnecting = threading.Event()
        self._thread = threading.Thread(target=self.serve, name='gcs server')

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._listener.getsockname()[1])

    def start(self) -> None:
        """Serve in a thread of its own."""
        self._thread.start()

    def close(self) -> None:
        """Close all connections and end the thread."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._let_go_of_all()
        self._selector.close()
        self._listener.close()

    def stop_soon(self) -> None:
        """Let `serve` return; may be called by a signal handler."""
        self._stopping.set()

    def set_fault(self, settings: FaultSettings) -> None:
        """Let something go wrong with the stage from now on, or nothing any more."""
        with self._lock:
            self._controller.set_fault(settings, time.monotonic())

    def disconnect(self) -> None:
        """Let go of all clients soon, as a controller that is switched off and on."""
        self._disconnecting.set()

    def serve(self) -> None:
        """Serve until `close` or `stop_soon`."""
        while not self._stopping.is_set():
            for key, _ in self._selector.select(self._patience_s()):
                if key.data is None:
                    self._accept()
                else:
                    self._answer(key.data)
            while self._delayed and self._delayed[0][0] <= time.monotonic():
                _, client, reply = self._delayed.popleft()
                self._send(client, reply)
            if self._disconnecting.is_set():
                self._disconnecting.clear()
                self._let_go_of_all()

    def _patience_s(self) -> float:
        if not self._delayed:
            return IDLE_S
        return min(max(self._delayed[0][0] - time.monotonic(), 0.0), IDLE_S)

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.settimeout(SEND_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._selector.register(connection, selectors.EVENT_READ, _Client(connection))

    def _answer(self, client: _Client) -> None:
        """Execute what has arrived."""
        try:
            data = client.socket.recv(4096)
        except OSError:
            data = b''
        if not data:
            self._let_go(client)
            return
        with self._lock:
            now_s = time.monotonic()
            replies = [
                self._controller.handle(command, now_s) for command in client.commands.feed(data)
            ]
        reply = b''.join(replies)
        if reply and self.answer_delay_s > 0.0:
            self._delayed.append((time.monotonic() + self.answer_delay_s, client, reply))
        elif reply:
            self._send(client, reply)

    def _send(self, client: _Client, reply: bytes) -> None:
        try:
            client.socket.sendall(reply)
        except OSError:
            self._let_go(client)

    def _let_go(self, client: _Client) -> None:
        if client.socket.fileno() >= 0:
            self._selector.unregister(client.socket)
            client.socket.close()

    def _let_go_of_all(self) -> None:
        for key in list(self._selector.get_map().values()):
            if isinstance(key.data, _Client):
                self._let_go(key.data)
