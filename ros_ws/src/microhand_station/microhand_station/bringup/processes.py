# SPDX-License-Identifier: Apache-2.0
"""Processes of a station: started apart from the terminal, logged, and ended in good order."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

END_S = 20.0
"""Longest time that a process gets to end by itself [s]: a recorder may be packing its file."""
POLL_S = 0.02


class NodeProcess:
    """A node in a process and a session of its own: Ctrl-C in the terminal does not reach it.

    Must be made by a thread that lives as long as the node: the process ends with that thread.

    Parameters
    ----------
    name : str
        For people.
    module : str
        Its ``main`` runs the node.
    arguments : sequence of str
        Command line of the node.
    log : Path
        Gets what the node prints.
    environment : mapping
        Added to that of this process.
    """

    def __init__(
        self,
        name: str,
        module: str,
        arguments: Sequence[str],
        log: Path,
        environment: Mapping[str, str],
    ) -> None:
        self.name = name
        self.log = log
        self._start = (module, tuple(arguments), dict(environment))
        with log.open('ab') as output:
            self._process = subprocess.Popen(
                [
                    *(sys.executable, '-m', 'microhand_station.bringup.child'),
                    *(str(os.getpid()), module, *arguments),
                ],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env={**os.environ, **environment},
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    @property
    def exit_status(self) -> int | None:
        """None while it runs; negative: the signal that ended it."""
        return self._process.poll()

    def interrupt(self) -> None:
        """Ask the process to end."""
        if self.exit_status is None:
            self._process.send_signal(signal.SIGINT)

    def kill(self) -> None:
        """End the process, and whatever it started."""
        if self.exit_status is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def again(self) -> NodeProcess:
        """Start the same node anew; its log goes on."""
        module, arguments, environment = self._start
        return NodeProcess(self.name, module, arguments, self.log, environment)

    def last_words(self) -> str:
        """Return the last line of its log."""
        lines = self.log.read_text(encoding='utf-8', errors='replace').strip().splitlines()
        return lines[-1].strip() if lines else 'it left no message'


def end_processes(processes: Iterable[NodeProcess]) -> list[str]:
    """Interrupt processes, wait for them, and kill those that do not end.

    Returns
    -------
    list of str
        What did not go well: one sentence per process.
    """
    asked = [process for process in processes if process.exit_status is None]
    for process in asked:
        process.interrupt()
    give_up_s = time.monotonic() + END_S
    while any(process.exit_status is None for process in asked):
        if time.monotonic() > give_up_s:
            break
        time.sleep(POLL_S)
    troubles = []
    for process in asked:
        if process.exit_status is None:
            process.kill()
            troubles.append(f'{process.name} did not end within {END_S:g} s and was killed')
        elif process.exit_status:
            troubles.append(
                f'{process.name} ended with status {process.exit_status}; see {process.log}'
            )
    return troubles
