# SPDX-License-Identifier: Apache-2.0
"""Which requests the live view answers.

Whoever opens the page can move the station. So a page of somebody else's must not be able to talk
to it through the browser of a user (`Origin`, and `Host` against names that were bent to this
machine), and other machines must know the token. It comes once in the address, as
``/?token=...``, and from then on in a cookie.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from microhand_station.view.address import is_loopback

NEVER_FRAMED = (
    ('X-Frame-Options', 'DENY'),
    ('Referrer-Policy', 'no-referrer'),
    ('Cache-Control', 'no-store'),
)
"""Headers of all answers: the page may not be shown inside another one."""


@dataclass(frozen=True)
class Answer:
    """What a request gets instead of the page.

    Parameters
    ----------
    status : HTTPStatus
        Of the answer.
    text : str
        One sentence for people.
    headers : tuple of (str, str)
        Besides those of every answer.
    """

    status: HTTPStatus
    text: str
    headers: tuple[tuple[str, str], ...] = ()


class Gate:
    """Judges requests by their heads.

    Parameters
    ----------
    token : str
        Empty: the view is for this machine alone.
    port : int
        At which the view listens; browsers send cookies to all ports of a host.
    """

    def __init__(self, token: str, port: int) -> None:
        self._token = token
        self._cookie_name = f'microhand_view_{port}'
        self._cookie = hashlib.sha256(f'microhand view {token}'.encode()).hexdigest()

    def judge(self, path: str, headers: Mapping[str, str]) -> Answer | None:
        """Return what to answer instead of the page; None: the request may pass.

        Parameters
        ----------
        path : str
            With its query.
        headers : mapping
            Of the request; names in any case.
        """
        sent = {name.lower(): value for name, value in headers.items()}
        host = sent.get('host', '')
        if not self._token and not is_loopback(_hostname(host)):
            return _refuse(f'the host is {host or "not named"}; allowed: this machine')
        origin = sent.get('origin')
        if origin is not None and urlsplit(origin).netloc != host:
            return _refuse(f'the request comes from a page of {origin}; allowed: the view itself')
        query = parse_qs(urlsplit(path).query)
        if 'websocket' in query:  # would let the page show, and obey, another server
            return _refuse('the address names another server; allowed: the view itself')
        return self._judge_token(query.get('token'), sent.get('cookie', ''))

    def _judge_token(self, given: list[str] | None, cookies: str) -> Answer | None:
        """Return None if the cookie is right, and a cookie if the token in the address is."""
        if not self._token:
            return None
        if given is not None:
            if not hmac.compare_digest(given[-1].encode(), self._token.encode()):
                return Answer(HTTPStatus.UNAUTHORIZED, 'the token is wrong')
            cookie = f'{self._cookie_name}={self._cookie}; Path=/; HttpOnly; SameSite=Strict'
            return Answer(
                HTTPStatus.SEE_OTHER, 'welcome', (('Location', '/'), ('Set-Cookie', cookie))
            )
        if not hmac.compare_digest(self._cookie_in(cookies).encode(), self._cookie.encode()):
            return Answer(
                HTTPStatus.UNAUTHORIZED, 'a token is needed: open the view with /?token=...'
            )
        return None

    def _cookie_in(self, cookies: str) -> str:
        """Return the value of the view's cookie; empty: it is not there."""
        try:
            found = SimpleCookie(cookies).get(self._cookie_name)
        except CookieError:
            return ''
        return '' if found is None else found.value


def _hostname(host: str) -> str:
    """Return the name in a ``Host`` header, without the port; empty: it is none."""
    try:
        return urlsplit(f'//{host}').hostname or ''
    except ValueError:
        return ''


def _refuse(reason: str) -> Answer:
    return Answer(HTTPStatus.FORBIDDEN, reason)
