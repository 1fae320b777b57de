# SPDX-License-Identifier: Apache-2.0
"""Where the live view is to be found, and who may open it."""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass, field

from microhand_planner.core.errors import BadRequest, InvalidParameter

DEFAULT_HOST = '127.0.0.1'
DEFAULT_PORT = 8080
HIGHEST_PORT = 65535
TOKEN = re.compile(r'^[A-Za-z0-9._~-]{16,200}$')
TOKEN_RULE = '16 to 200 letters, digits or . _ ~ -'
TOKEN_VARIABLE = 'MICROHAND_VIEW_TOKEN'
"""The token goes by the environment: other users of a machine can read command lines."""
ANY_HOST = ('0.0.0.0', '::')
"""Hosts that stand for all addresses of this machine."""


@dataclass(frozen=True)
class ViewAddress:
    """Address of the live view.

    Parameters
    ----------
    host : str
        Address of this machine to listen at.
    port : int
        0: any that is free.
    token : str
        Secret that whoever opens the page must know; empty: none.

    Raises
    ------
    BadRequest
        A port or a token that is none, or a host that others reach without a token.
    """

    host: str = DEFAULT_HOST
    port: int = DEFAULT_PORT
    token: str = field(default='', repr=False)

    def __post_init__(self) -> None:
        """Check the ranges, and that nobody else gets in without a token."""
        if not 0 <= self.port <= HIGHEST_PORT:
            raise InvalidParameter('view-port', self.port, f'0 to {HIGHEST_PORT}; 0: any free')
        if not self.host:
            raise BadRequest('view-host', 'empty', f'an address of this machine, {DEFAULT_HOST}')
        if self.token and not TOKEN.match(self.token):
            raise BadRequest('view-token', f'of {len(self.token)} characters', TOKEN_RULE)
        if not self.token and not is_loopback(self.host):
            raise BadRequest(
                'view-host',
                f'{self.host}, which other machines reach, and view-token is not given',
                f'{DEFAULT_HOST}, or a view-token of {TOKEN_RULE}',
            )

    def url(self, port: int) -> str:
        """Return what to type into a browser when the view listens at `port`."""
        host = socket.gethostname() if self.host in ANY_HOST else self.host
        shown = f'[{host}]' if ':' in host else host
        return f'http://{shown}:{port}/'


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine, and nobody else reaches it.

    Examples
    --------
    >>> [is_loopback(host) for host in ('127.0.0.1', '::1', 'localhost', '0.0.0.0', 'lab')]
    [True, True, True, False, False]
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'
