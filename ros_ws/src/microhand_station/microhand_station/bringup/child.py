# SPDX-License-Identifier: Apache-2.0
"""One node as a process that does not outlive the one that started it.

Run as ``python -m microhand_station.bringup.child PARENT MODULE [ARGUMENT ...]``, where PARENT is
the id of the process that starts it; calls ``MODULE.main()``.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import signal
import sys

PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def main() -> int:
    """Tie this process to its parent, then become the node."""
    parent, module, *arguments = sys.argv[1:]
    # the kernel sends the signal when the parent dies, whatever kills it
    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM) != 0:
        raise OSError(ctypes.get_errno(), 'prctl(PR_SET_PDEATHSIG)')
    if os.getppid() != int(parent):
        return 0  # it died before
    sys.argv = [module, *arguments]
    return importlib.import_module(module).main() or 0


if __name__ == '__main__':
    sys.exit(main())
