# SPDX-License-Identifier: Apache-2.0
"""The commands that a page shows, with what it says that they print.

A ``console`` block has commands, after ``$ ``, each followed by what it prints. A comment on the
line before says what is special: ``<!-- not here: why -->``, ``<!-- exit status 4 -->``, or
``<!-- background until: TEXT -->``: then it runs on to the end of the page.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

BLOCK = re.compile(
    r'(?:^<!-- (?P<mark>[^\n]*) -->\n)?^```console\n(?P<body>.*?)^```$', re.MULTILINE | re.DOTALL
)
NUMBER = re.compile(r'(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?')


@dataclass
class Shown:
    """One command: what is typed, what is printed, how it ends."""

    command: str
    printed: list[str] = field(default_factory=list)
    status: int = 0
    until: str = ''


def shown_commands(page: Path) -> list[Shown]:
    """Return the commands of a page, in order, without those that are not to be run."""
    found: list[Shown] = []
    for block in BLOCK.finditer(page.read_text(encoding='utf-8')):
        mark = block['mark'] or ''
        if mark.startswith('not here: '):
            continue
        status, until = 0, ''
        if mark.startswith('exit status '):
            status = int(mark.removeprefix('exit status '))
        elif mark.startswith('background until: '):
            until = mark.removeprefix('background until: ')
        elif mark:
            raise ValueError(f'{page.name}: what is "{mark}"?')
        for line in block['body'].splitlines():
            if line.startswith('$ '):
                found.append(Shown(line[2:], status=status, until=until))
            elif found[-1].command.endswith('\\'):
                found[-1].command = found[-1].command[:-1] + line.strip()
            else:
                found[-1].printed.append(line)
    return found


def missing_lines(shown: list[str], printed: str) -> list[str]:
    """Return the shown lines that were not printed, in their order; ``...`` stands for anything.

    Words must be the same; numbers may be off by half of themselves, or by 1.
    """
    lines = printed.splitlines()
    missing, place = [], 0
    for line in filter(lambda text: text.strip(' .'), shown):
        fits = (i for i in range(place, len(lines)) if agree(line, lines[i]))
        found = next(fits, None)
        if found is None:
            missing.append(line)
        else:
            place = found + 1
    return missing


def agree(shown: str, printed: str) -> bool:
    """Return whether a line is as it is shown."""
    pieces = [re.escape(' '.join(NUMBER.sub('#', piece).split())) for piece in shown.split('...')]
    words = ' '.join(NUMBER.sub('#', printed).split())
    if not re.fullmatch(' ?.*? ?'.join(pieces), words):
        return False
    if '...' in shown[:-3].rstrip():
        return True  # which numbers belong together is open
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=False)
    return all(abs(float(a) - float(b)) <= max(1.0, 0.5 * abs(float(a))) for a, b in pairs)
