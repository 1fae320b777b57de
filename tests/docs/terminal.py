# SPDX-License-Identifier: Apache-2.0
"""A terminal in which the commands of a page are typed."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from tests.docs.shown_commands import missing_lines

TOP = Path(__file__).parents[2]
DEADLINE_S = 100.0


class Terminal:
    """A folder with the examples, and the commands of this environment on the path."""

    def __init__(self, folder):
        self.folder = folder
        (folder / 'examples').symlink_to(TOP / 'examples')
        path = f'{Path(sys.executable).parent}{os.pathsep}{os.environ["PATH"]}'
        self._environment = {**os.environ, 'PATH': path, 'COLUMNS': '100'}
        self._background = []
        self._readers = []

    def run(self, shown):
        """Type a command, and compare what it prints and how it ends with what is shown."""
        process = subprocess.Popen(
            ['bash', '-c', f'exec 2>&1; {"exec " if shown.until else ""}{shown.command}'],
            cwd=self.folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        if shown.until:
            self._background.append(process)
            self._wait_for(process, shown.until)
            return
        try:
            printed, _ = process.communicate(timeout=DEADLINE_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            raise
        assert process.returncode == shown.status, f'{shown.command}\n{printed}'
        missing = missing_lines(shown.printed, printed)
        assert not missing, f'{shown.command} did not print {missing} but\n{printed}'

    def _wait_for(self, process, text):
        """Read until a line has the text; later lines are read on, so that nobody waits."""
        seen, lines = threading.Event(), []

        def read():
            for line in process.stdout:
                lines.append(line)
                if text in line:
                    seen.set()
            seen.set()

        reader = threading.Thread(target=read)
        self._readers.append(reader)
        reader.start()
        assert seen.wait(DEADLINE_S), lines
        assert any(text in line for line in lines), lines

    def close(self):
        """End what runs in the background as Ctrl-C does; return the exit statuses."""
        for process in self._background:
            process.send_signal(signal.SIGINT)
        statuses = [process.wait(DEADLINE_S) for process in self._background]
        for process, reader in zip(self._background, self._readers, strict=True):
            reader.join(DEADLINE_S)
            process.stdout.close()
        return statuses
