# SPDX-License-Identifier: Apache-2.0
"""Messages, services, actions and error codes, as they are in their files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from markdown_table import code, markdown_table

from microhand_planner.core import errors

FOLDER = Path(__file__).parents[2] / 'ros_ws' / 'src' / 'microhand_msgs_py'
KINDS = {
    'action': ('Actions', ('Goal', 'Result', 'Feedback')),
    'srv': ('Services', ('Request', 'Response')),
    'msg': ('Messages', ('',)),
}
LINE = re.compile(
    r'(?P<type>[\w/]+(\[\d*\])?)\s+(?P<name>\w+)\s*(=\s*(?P<value>\S+))?\s*(#\s*(?P<text>.*))?$'
)
CLASSES = {
    0: ('done', 0),
    1: ('bad request: nothing moved; change the request', errors.BadRequest.exit_status),
    2: ('no plan to return', errors.NoPlan.exit_status),
    3: ('the run did not finish', errors.RunFailed.exit_status),
    9: ('a defect of microhand', errors.MicrohandError.exit_status),
}
"""Meaning and exit status of the hundreds."""


@dataclass(frozen=True)
class Entry:
    """A field or, with a value, a constant."""

    kind: str
    name: str
    value: str
    text: str


def entries(lines: list[str]) -> Iterator[Entry]:
    """Return fields and constants; a line that is neither, nor a comment, is an error."""
    for line in lines:
        if not line.strip() or line.startswith('#'):
            continue
        found = LINE.match(line)
        if found is None:
            raise ValueError(f'cannot read "{line}"')
        yield Entry(found['type'], found['name'], found['value'] or '', found['text'] or '')


def comment(lines: list[str]) -> str:
    """Return the comment that a definition begins with."""
    first = []
    for line in lines:
        if not line.startswith('#'):
            break
        first.append(line.lstrip('# '))
    return ' '.join(first)


def interfaces() -> str:
    """Return all definitions, actions first."""
    parts = []
    for folder, (title, sections) in KINDS.items():
        parts.append(f'## {title}\n')
        for path in sorted((FOLDER / folder).iterdir()):
            lines = path.read_text(encoding='utf-8').splitlines()
            parts.append(f'### {path.stem}\n\n{comment(lines)}\n')
            for section, text in zip(sections, '\n'.join(lines).split('\n---'), strict=True):
                if section:
                    parts.append(f'**{section}**\n')
                parts.append(_definition(text.splitlines()) or 'Nothing.\n')
    return '\n'.join(parts)


def _definition(lines: list[str]) -> str:
    """Return the constants and fields of one section as tables."""
    found = list(entries(lines))
    constants = markdown_table(
        ('constant', 'value', 'meaning'),
        ((code(e.name), e.value, e.text) for e in found if e.value),
    )
    fields = markdown_table(
        ('field', 'type', 'meaning'),
        ((code(e.name), code(e.kind), e.text) for e in found if not e.value),
    )
    return '\n'.join(filter(None, (constants, fields)))


def error_codes() -> str:
    """Return the codes with their meaning, by class."""
    lines = (FOLDER / 'msg' / 'ErrorCode.msg').read_text(encoding='utf-8').splitlines()
    by_class: dict[int, list[Entry]] = {}
    for entry in entries(lines):
        by_class.setdefault(int(entry.value) // 100, []).append(entry)
    raised = {
        error.code: error.__name__ for error in vars(errors).values() if isinstance(error, type)
    }
    parts = []
    for hundred, found in by_class.items():
        meaning, status = CLASSES[hundred]
        parts.append(f'## {hundred}xx: {meaning}' if hundred else '## 0: done')
        parts.append(f'\nExit status of `microhand`: {status}.\n')
        rows = ((e.value, code(e.name), e.text, code(raised.get(int(e.value), ''))) for e in found)
        parts.append(markdown_table(('code', 'name', 'meaning', 'raised in Python as'), rows))
    return '\n'.join(parts)
