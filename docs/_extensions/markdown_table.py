# SPDX-License-Identifier: Apache-2.0
"""Rows to a Markdown table."""

from collections.abc import Iterable, Sequence


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table; nothing if it has no rows."""
    lines = ['| ' + ' | '.join(_cell(cell) for cell in row) + ' |' for row in rows]
    if not lines:
        return ''
    head = '| ' + ' | '.join(heads) + ' |'
    return '\n'.join([head, '|' + ' --- |' * len(heads), *lines]) + '\n'


def code(text: object) -> str:
    """Return a text as code; nothing for nothing."""
    return f'`{text}`' if str(text) else ''


def _cell(text: object) -> str:
    return ' '.join(str(text).split()).replace('|', r'\|')
