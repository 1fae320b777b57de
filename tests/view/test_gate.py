# SPDX-License-Identifier: Apache-2.0
"""Who gets into the live view: its user, and no page or machine of somebody else's."""

import hashlib
from http import HTTPStatus
from http.cookies import SimpleCookie

import pytest
from hypothesis import given
from hypothesis import strategies as st

from microhand_station.view.gate import Gate

TOKEN = 'a-secret.of_25~characters'
OPEN, GUARDED = Gate('', 8080), Gate(TOKEN, 8080)
HERE = {'Host': '127.0.0.1:8080'}


def status(gate, path='/', **headers):
    """Return the status of the refusal; None: the request passes."""
    answer = gate.judge(path, {name.replace('_', '-'): text for name, text in headers.items()})
    return None if answer is None else answer.status


@pytest.mark.parametrize(
    'host', ['127.0.0.1:8080', 'localhost:8080', '[::1]:8080', 'LOCALHOST', '127.0.0.1']
)
def test_without_a_token_this_machine_gets_in_by_its_own_names(host):
    """Also by the port of a tunnel, and with the origin that a browser sends."""
    assert status(OPEN, Host=host) is None
    assert status(OPEN, host=host, origin=f'http://{host}') is None


@pytest.mark.parametrize(
    'host', ['evil.org', 'evil.org:8080', '127.0.0.1.evil.org', '192.168.0.7:8080', '', '[', '@']
)
def test_without_a_token_names_that_were_bent_to_this_machine_are_refused(host):
    """DNS rebinding: the browser believes that evil.org is 127.0.0.1, and says so in Host."""
    assert status(OPEN, Host=host) == HTTPStatus.FORBIDDEN
    assert status(OPEN) == HTTPStatus.FORBIDDEN


@pytest.mark.parametrize('gate', [OPEN, GUARDED])
@pytest.mark.parametrize(
    'origin',
    ['http://evil.org', 'null', 'http://127.0.0.1:8081', 'http://127.0.0.1', 'file://', ''],
)
def test_a_page_of_somebody_elses_cannot_talk_to_the_view(gate, origin):
    """Another origin is refused, also one on another port of this machine, also with the token."""
    path = f'/?token={TOKEN}'
    assert status(gate, path, **HERE, Origin=origin) == HTTPStatus.FORBIDDEN


@pytest.mark.parametrize('gate', [OPEN, GUARDED])
def test_the_page_cannot_be_made_to_obey_another_server(gate):
    """The page's own parameter for that is refused."""
    path = f'/?token={TOKEN}&websocket=ws://evil.org'
    assert status(gate, path, **HERE) == HTTPStatus.FORBIDDEN


def test_the_token_opens_the_view_once_and_its_cookie_from_then_on():
    """The right token is answered by a cookie and the way to the page, without the token."""
    assert status(GUARDED, **HERE) == HTTPStatus.UNAUTHORIZED
    answer = GUARDED.judge(f'/?token={TOKEN}', HERE)
    headers = dict(answer.headers)
    assert (answer.status, headers['Location']) == (HTTPStatus.SEE_OTHER, '/')
    (cookie,) = SimpleCookie(headers['Set-Cookie']).values()
    assert cookie['httponly']
    assert cookie['samesite'] == 'Strict'
    assert TOKEN not in headers['Set-Cookie']
    sent = f'other=1; {cookie.key}={cookie.value}; more=2'
    assert status(GUARDED, **HERE, Cookie=sent) is None
    # over the network, by any name that leads here
    assert status(GUARDED, Host='lab:8080', Origin='http://lab:8080', Cookie=sent) is None
    # a browser sends it to all ports of a host: another view has another token
    other = Gate('another-secret-of-the-lab', 8080)
    assert status(other, **HERE, Cookie=sent) == HTTPStatus.UNAUTHORIZED


@given(st.text(max_size=40).filter(lambda text: text != TOKEN))
def test_every_other_token_and_cookie_is_refused(text):
    """Whatever else is sent, and however it is damaged: 401, and no exception."""
    assert status(GUARDED, f'/?token={text}', **HERE) != HTTPStatus.SEE_OTHER
    cookie = f'microhand_view_8080={text}'
    assert status(GUARDED, **HERE, Cookie=cookie) == HTTPStatus.UNAUTHORIZED
    assert status(GUARDED, **HERE, Cookie=text) == HTTPStatus.UNAUTHORIZED


def test_the_cookie_is_not_a_plain_digest_of_the_token():
    """A digest of the bare token might be found elsewhere."""
    set_cookie = dict(GUARDED.judge(f'/?token={TOKEN}', HERE).headers)['Set-Cookie']
    assert hashlib.sha256(TOKEN.encode()).hexdigest() not in set_cookie
