# SPDX-License-Identifier: Apache-2.0
"""Every source that is cited can be looked up; links of the first pages lead somewhere."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINK = re.compile(r'\]\(([^)\s]+)\)')
KEY = re.compile(r'\[([A-Z][a-z]+(?:19|20)\d\d)\]')


def test_every_key_is_in_the_references_and_every_reference_is_cited() -> None:
    """Keys such as [Kumar2021] in code and documents are those of docs/references.md."""
    listed = set(KEY.findall((ROOT / 'docs/references.md').read_text(encoding='utf-8')))
    cited = set()
    for folder in ('ros_ws/src', 'docs', 'benchmarks', 'examples', 'tests'):
        for file in (ROOT / folder).rglob('*'):
            if file.suffix in ('.py', '.md') and file.name not in (
                'references.md',
                Path(__file__).name,
            ):
                cited |= set(KEY.findall(file.read_text(encoding='utf-8')))
    assert cited == listed


@pytest.mark.parametrize('page', ['README.md', 'CONTRIBUTING.md', 'CHANGELOG.md'])
def test_links_of_pages_outside_the_site_lead_to_files(page: str) -> None:
    """What the site does not check: each relative link, and each picture, is a file or folder."""
    text = (ROOT / page).read_text(encoding='utf-8')
    links = {link.partition('#')[0] for link in LINK.findall(text) if '://' not in link}
    assert [link for link in sorted(links) if not (ROOT / link).exists()] == []
