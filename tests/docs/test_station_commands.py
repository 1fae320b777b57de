# SPDX-License-Identifier: Apache-2.0
"""What pages with a running station tell people to type, the tutorial first, is typed here."""

import pytest

from tests.docs.shown_commands import shown_commands
from tests.docs.test_commands import PAGES, runs_on


@pytest.mark.timeout(300)  # a page of commands, one after the other
@pytest.mark.parametrize('page', list(filter(runs_on, PAGES)), ids=lambda page: page.stem)
def test_commands_do_what_the_page_says(terminal, page):
    """In order, in one folder: each ends as shown; the station ends well, too."""
    for shown in shown_commands(page):
        terminal.run(shown)
    assert set(terminal.close()) == {0}
