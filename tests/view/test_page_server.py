# SPDX-License-Identifier: Apache-2.0
"""The server of the page, as browsers and others reach it: by HTTP and by websocket."""

import http.client
import socket
from http import HTTPStatus

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from microhand_planner.core.errors import BadRequest
from microhand_station.view.address import ViewAddress
from microhand_station.view.page_server import open_page_server

TOKEN = 'a-secret.of_25~characters'
WAIT_S = 10.0
VISER = Subprotocol(f'viser-v{viser.__version__}')


@pytest.fixture(scope='module')
def server():
    """Serve a page to this machine."""
    server = open_page_server(ViewAddress(port=0), 'open')
    yield server
    server.stop()


@pytest.fixture(scope='module')
def guarded():
    """Serve a page to whoever knows the token."""
    server = open_page_server(ViewAddress('0.0.0.0', 0, TOKEN), 'guarded')
    yield server
    server.stop()


def get(server, path='/', **headers):
    """Return status, headers and body of a page."""
    connection = http.client.HTTPConnection('127.0.0.1', server.get_port(), timeout=WAIT_S)
    try:
        connection.request('GET', path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()
    finally:
        connection.close()


def speak(server, **headers):
    """Open a websocket as the page does, and return the first that it hears."""
    url = f'ws://127.0.0.1:{server.get_port()}'
    with connect(
        url, subprotocols=[VISER], additional_headers=headers, open_timeout=WAIT_S
    ) as socket_:
        return socket_.recv(timeout=WAIT_S)


def refused(server, **headers):
    """Return the status with which a websocket is refused."""
    with pytest.raises(InvalidStatus) as error:
        speak(server, **headers)
    return error.value.response.status_code


def test_this_machine_gets_the_page_which_is_never_framed(server):
    """The page of viser, with headers that keep other pages from showing it inside of them."""
    status, headers, body = get(server)
    assert status == HTTPStatus.OK
    assert headers['X-Frame-Options'] == 'DENY'
    assert len(body) > 100_000
    assert speak(server)


def test_pages_of_others_are_refused_by_http_and_by_websocket(server):
    """Both ways lead through the gate."""
    assert get(server, Origin='http://evil.org')[0] == HTTPStatus.FORBIDDEN
    assert get(server, Host='evil.org')[0] == HTTPStatus.FORBIDDEN
    assert refused(server, Origin='http://evil.org') == HTTPStatus.FORBIDDEN


def test_without_the_token_nothing_is_served_and_with_its_cookie_all(guarded):
    """401 in words for page and websocket; the address with the token gives the cookie."""
    status, headers, body = get(guarded)
    assert (status, headers['X-Frame-Options']) == (HTTPStatus.UNAUTHORIZED, 'DENY')
    assert b'a token is needed' in body
    assert get(guarded, '/?token=wrong')[0] == HTTPStatus.UNAUTHORIZED
    assert refused(guarded) == HTTPStatus.UNAUTHORIZED
    assert refused(guarded, Cookie='microhand_view=1') == HTTPStatus.UNAUTHORIZED
    status, headers, _ = get(guarded, f'/?token={TOKEN}')
    assert (status, headers['Location']) == (HTTPStatus.SEE_OTHER, '/')
    cookie = headers['Set-Cookie'].partition(';')[0]
    assert get(guarded, Cookie=cookie)[0] == HTTPStatus.OK
    assert speak(guarded, Cookie=cookie)


def test_files_beside_the_page_are_not_served(server):
    """Neither by dots nor by escapes."""
    for path in ('/../../__init__.py', '/%2e%2e/%2e%2e/__init__.py', '/..%5c..%5c__init__.py'):
        assert get(server, path)[0] == HTTPStatus.NOT_FOUND


def test_no_browser_can_make_the_server_share_the_page(server):
    """By itself viser opens a tunnel to the world for whoever asks."""
    assert server.request_share_url() is None
    assert server._share_tunnel is None


def test_a_port_that_is_taken_and_a_host_that_is_not_here_are_refused_by_name(server):
    """One sentence each; nothing is opened elsewhere instead."""
    with pytest.raises(BadRequest, match=r'view-port is .*already in use\); allowed: a free'):
        open_page_server(ViewAddress(port=server.get_port()), '')
    with pytest.raises(BadRequest, match=r'view-port is 0 of 192\.0\.2\.1'):
        open_page_server(ViewAddress('192.0.2.1', 0, TOKEN), '')
    with pytest.raises(BadRequest, match=r'view-host is no-such-host\.invalid'):
        open_page_server(ViewAddress('no-such-host.invalid', 0, TOKEN), '')


def test_who_breaks_off_or_talks_nonsense_disturbs_nobody(server):
    """Half a request, no HTTP at all, a frame that is none: the page is served as before."""
    for nonsense in (b'', b'GET / HT', b'\x16\x03\x01\x02\x00', b'GET / HTTP/1.1\r\n\r\n'):
        with socket.create_connection(('127.0.0.1', server.get_port()), timeout=WAIT_S) as raw:
            raw.sendall(nonsense)
    url = f'ws://127.0.0.1:{server.get_port()}'
    with connect(url, subprotocols=[VISER], open_timeout=WAIT_S) as page:
        page.send(b'\xc1 not a message')
    assert get(server)[0] == HTTPStatus.OK
    assert speak(server)
