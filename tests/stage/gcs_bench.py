# SPDX-License-Identifier: Apache-2.0
"""A GCS server in this process or in its own, and a wire to it that can be disturbed."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stage_driver_sim.gcs.server import GcsServer
from stage_driver_sim.gcs.simulated_controller import SimulatedController
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.simulated_stage import SimulatedStage

DEADLINE_S = 15.0
SERVER = Path(sys.executable).with_name('gcs_server')

Disturbance = Callable[[bytes], 'list[bytes]']


def make_server(
    port: int = 0,
    name: str = 'bench',
    travel_um: float = 100.0,
    home_um: tuple[float, float, float] = (50.0, 50.0, 50.0),
) -> GcsServer:
    """Return a server, started, whose stage stands at its home."""
    stage = SimulatedStage(
        [replace(axis, upper_um=travel_um) for axis in REPRESENTATIVE_100_UM_XYZ],
        home_um=np.array(home_um),
        rng=np.random.default_rng(4),
        now_s=time.monotonic(),
        hardware_id=name,
    )
    server = GcsServer(SimulatedController(stage), port=port)
    server.start()
    return server


@contextlib.contextmanager
def running_server(port: int = 0, name: str = 'bench', **stage: Any) -> Iterator[GcsServer]:
    """Run a server as long as the context lasts."""
    server = make_server(port, name, **stage)
    try:
        yield server
    finally:
        server.close()


class ServerProcess:
    """The command ``gcs_server``, on any port that is free."""

    def __init__(self, *arguments: str) -> None:
        self._process = subprocess.Popen(
            [str(SERVER), '--port=0', *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.port = int(self._process.stdout.readline().rpartition(':')[2])

    def tell(self, command: str) -> None:
        """Send it a command, by a connection of its own."""
        with socket.create_connection(('127.0.0.1', self.port), timeout=DEADLINE_S) as talk:
            talk.sendall(f'{command}\nFLT?\n'.encode())
            with talk.makefile() as answers:
                assert answers.readline()  # by then it has been executed

    def close(self) -> None:
        """End it as an operator does; it has to end without complaints."""
        self._process.terminate()
        _, complaints = self._process.communicate(timeout=DEADLINE_S)
        assert (self._process.returncode, complaints) == (0, '')


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait for other threads; fail after `DEADLINE_S`."""
    give_up_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < give_up_s, f'not within {DEADLINE_S} s: {what}'
        time.sleep(0.002)


class DisturbedWire:
    """Passes on what a client and a server say; what the server says goes through `disturb`."""

    def __init__(self, server: GcsServer) -> None:
        self.disturb: Disturbance = lambda data: [data]
        self._server = server
        self._listener = socket.create_server(('127.0.0.1', 0))
        self._ends: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    @property
    def port(self) -> int:
        """Where a client finds it."""
        return int(self._listener.getsockname()[1])

    def close(self) -> None:
        """Cut the wire."""
        self._listener.shutdown(socket.SHUT_RDWR)
        self._threads[0].join()
        for end in self._ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()
        for end in [self._listener, *self._ends]:
            end.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                server = socket.create_connection(('127.0.0.1', self._server.port))
                self._ends += [client, server]
                for args in ((client, server, False), (server, client, True)):
                    self._threads.append(threading.Thread(target=self._pass_on, args=args))
                    self._threads[-1].start()

    def _pass_on(self, source: socket.socket, sink: socket.socket, disturbed: bool) -> None:
        sink.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with contextlib.suppress(OSError):
            while data := source.recv(4096):
                for piece in self.disturb(data) if disturbed else [data]:
                    sink.sendall(piece)
            sink.shutdown(socket.SHUT_RDWR)
