# SPDX-License-Identifier: Apache-2.0
"""What guides tell people to type is typed here, and does what they say."""

from pathlib import Path

import pytest

from tests.docs.shown_commands import agree, missing_lines, shown_commands

DOCS = Path(__file__).parents[2] / 'docs'


def runs_on(page):
    """Return whether something runs in the background of a page."""
    return any(shown.until for shown in shown_commands(page))


PAGES = sorted(page for page in DOCS.rglob('*.md') if shown_commands(page))


@pytest.mark.timeout(300)  # a page of commands, one after the other
@pytest.mark.parametrize(
    'page', [page for page in PAGES if not runs_on(page)], ids=lambda page: page.stem
)
def test_commands_do_what_the_page_says(terminal, page):
    """In order, in one folder: each ends as shown, and prints the lines that are shown."""
    for shown in shown_commands(page):
        terminal.run(shown)


def test_the_comparison_sees_other_words_and_other_numbers():
    """A page that says something else than the command is found out."""
    assert agree('cost 2480°, 4 placements', 'cost  2320°, 4 placements')
    assert not agree('cost 2480°, 4 placements', 'cost 240°, 4 placements')
    assert not agree('held: off by 0.01°', 'lost: off by 0.01°')
    assert agree('held: ...', 'held: off by 0.01°')
    assert agree('record: ...first.mcap', 'record: runs/x/first.mcap')
    assert missing_lines(['...', 'b', 'a'], 'a\nb') == ['a']
    assert not missing_lines(['a', '', 'c ...'], 'a\nb\nc 1')
