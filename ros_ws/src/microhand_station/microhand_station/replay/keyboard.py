# SPDX-License-Identifier: Apache-2.0
"""Single keys from the terminal, as soon as they are pressed; none where there is no terminal."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from types import TracebackType


class Keyboard:
    """Reads keys while it is entered."""

    def __init__(self) -> None:
        self._before: list[object] | None = None

    def __enter__(self) -> Keyboard:
        """Take keys one by one instead of line by line."""
        if sys.stdin is not None and sys.stdin.isatty():
            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the terminal as it was."""
        if self._before is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)  # type: ignore[arg-type]

    def key(self, wait_s: float) -> str:
        """Return the next key, or an empty text when the time is over."""
        wait_s = max(wait_s, 0.0)
        if self._before is None:
            time.sleep(wait_s)
            return ''
        ready, _, _ = select.select([sys.stdin], [], [], wait_s)
        return os.read(sys.stdin.fileno(), 1).decode('ascii', 'replace') if ready else ''
