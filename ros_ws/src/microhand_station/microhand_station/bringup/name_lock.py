# SPDX-License-Identifier: Apache-2.0
"""Names of a station on this machine: taken by one bring-up at a time, free when it ends."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from microhand_planner.core.errors import BadRequest


@contextlib.contextmanager
def names_taken(namespace: str, domain_id: int | None) -> Iterator[None]:
    """Hold the names of a station; the kernel lets go of them however the process ends.

    Discovery alone cannot tell: it may take seconds to show a station that runs already.

    Parameters
    ----------
    namespace : str
        Of the station.
    domain_id : int or None
        ROS domain; None: that of the environment.

    Raises
    ------
    BadRequest
        Another station on this machine has these names.
    """
    domain = os.environ.get('ROS_DOMAIN_ID', '0') if domain_id is None else str(domain_id)
    name = f'microhand_{os.getuid()}_{domain}_{namespace.strip("/").replace("/", ".")}.lock'
    with (Path(tempfile.gettempdir()) / name).open('w', encoding='utf-8') as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BadRequest(
                'namespace',
                f'{namespace!r} in domain {domain}, where a station runs already',
                'another --namespace or another --domain-id',
            ) from error
        yield
