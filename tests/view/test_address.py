# SPDX-License-Identifier: Apache-2.0
"""Where the live view listens, and who needs a token."""

import pytest

from microhand_planner.core.errors import BadRequest
from microhand_station.view.address import ViewAddress

TOKEN = 'a-secret.of_25~characters'


@pytest.mark.parametrize('host', ['127.0.0.1', '127.1.2.3', '::1', 'localhost'])
def test_on_this_machine_no_token_is_needed(host):
    """The loopback addresses are open without a token, and keep one that is given."""
    assert ViewAddress(host).token == ''
    assert ViewAddress(host, token=TOKEN).token == TOKEN


@pytest.mark.parametrize('host', ['0.0.0.0', '::', '192.168.0.7', 'lab-pc', 'localhost.evil.org'])
def test_what_other_machines_reach_needs_a_token(host):
    """Refused in one sentence that names both fields; accepted with a token."""
    with pytest.raises(BadRequest, match=r'view-host is .* and view-token is not given') as error:
        ViewAddress(host)
    assert error.value.exit_status == 2
    assert ViewAddress(host, token=TOKEN).host == host


@pytest.mark.parametrize(
    ('field', 'changes'),
    [
        ('view-port', {'port': -1}),
        ('view-port', {'port': 65536}),
        ('view-host', {'host': ''}),
        ('view-token', {'token': 'short'}),
        ('view-token', {'token': 'with spaces and more'}),
        ('view-token', {'token': TOKEN + '\nSet-Cookie: x=y'}),
        ('view-token', {'token': 201 * 'x'}),
    ],
)
def test_what_is_no_address_is_refused_by_name(field, changes):
    """The error names the field; a token is never repeated in it."""
    with pytest.raises(BadRequest) as error:
        ViewAddress(**changes)
    assert error.value.field == field
    assert changes.get('token', 'nothing') not in str(error.value)


def test_the_token_is_not_printed_with_the_address():
    """Logs may show an address."""
    assert TOKEN not in repr(ViewAddress(token=TOKEN))
    assert TOKEN not in ViewAddress(token=TOKEN).url(8080)


def test_the_url_can_be_typed_into_a_browser():
    """IPv6 addresses are bracketed; "any address" becomes the name of this machine."""
    assert ViewAddress().url(8080) == 'http://127.0.0.1:8080/'
    assert ViewAddress('::1').url(9) == 'http://[::1]:9/'
    url = ViewAddress('0.0.0.0', token=TOKEN).url(80)
    assert url.startswith('http://')
    assert '0.0.0.0' not in url
