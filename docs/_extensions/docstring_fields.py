# SPDX-License-Identifier: Apache-2.0
"""What the numpy docstring of a class says about its fields."""

from __future__ import annotations

import inspect
import re


def docstring_fields(documented: type) -> dict[str, tuple[str, str]]:
    """Return type and meaning of each name in the section 'Parameters'."""
    text = inspect.getdoc(documented) or ''
    found: dict[str, tuple[str, str]] = {}
    section = re.search(r'^Parameters\n-+\n(.*?)(?=^\w[^\n]*\n-+\n|\Z)', text, re.M | re.S)
    if section is None:
        return found
    names: list[str] = []
    for line in section[1].splitlines():
        if line and not line[0].isspace():
            left, _, kind = line.partition(' : ')
            names = [name.strip() for name in left.split(',')]
            found.update(dict.fromkeys(names, (kind, '')))
        else:
            for name in names:
                kind, meaning = found[name]
                found[name] = kind, f'{meaning} {line.strip()}'.strip()
    return found
