# SPDX-License-Identifier: Apache-2.0
"""Every source that is cited can be looked up."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
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
