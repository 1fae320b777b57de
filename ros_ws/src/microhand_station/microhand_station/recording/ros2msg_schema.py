# SPDX-License-Identifier: Apache-2.0
"""Message type → the text that lets any reader of an mcap file decode it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

_SEPARATOR = '=' * 80
_PRIMITIVES = frozenset(
    'bool byte char float32 float64 int8 uint8 int16 uint16 int32 uint32 int64 uint64'
    ' string wstring'.split()
)
# Type at the start of a line: `pkg/Type`, `pkg/msg/Type` or `Type`, before a bound or brackets.
_FIELD_TYPE = re.compile(r'^\s*([A-Za-z]\w*(?:/\w+){0,2})(?:<=\d+)?(?:\[[^\]]*\])?\s+\w+')


def installed_definition(package: str, name: str) -> str:
    """Text of an installed ``.msg`` file.

    Parameters
    ----------
    package, name : str
        As in ``package/msg/name``.

    Raises
    ------
    LookupError
        The package is not in the ament index, or it has no such message.
    """
    path = Path(get_package_share_directory(package)) / 'msg' / f'{name}.msg'
    if not path.is_file():
        raise LookupError(f'package {package} has no message {name}: {path} is missing')
    return path.read_text(encoding='utf-8')


def installed_type_hash(type_name: str) -> str:
    """Hash of an installed message type, as ROS computes it; empty: it is not told.

    Parameters
    ----------
    type_name : str
        ``package/msg/Type``.
    """
    package, kind, name = type_name.split('/')
    path = Path(get_package_share_directory(package)) / kind / f'{name}.json'
    try:
        hashes = json.loads(path.read_text(encoding='utf-8'))['type_hashes']
    except (OSError, ValueError, KeyError):
        return ''
    return next((str(h['hash_string']) for h in hashes if h['type_name'] == type_name), '')


def ros2msg_schema(
    type_name: str, definition: Callable[[str, str], str] = installed_definition
) -> str:
    """Full schema text of a message type, as the mcap profile ``ros2`` wants it.

    The definition itself, then each type it depends on, once, in the order of first use, after a
    line of 80 ``=`` and a line ``MSG: package/Type``.

    Parameters
    ----------
    type_name : str
        ``package/msg/Type``.
    definition : callable
        Gives the text of a ``.msg`` file from package and type.

    Returns
    -------
    str
        Schema text for the schema encoding ``ros2msg``.

    Raises
    ------
    LookupError
        The type, or one that it depends on, is not installed.

    Examples
    --------
    >>> files = {'Pair': 'Item[2] items', 'Item': 'float64 x  # [m]'}
    >>> print(ros2msg_schema('demo_msgs/msg/Pair', lambda _, name: files[name]).splitlines()[2])
    MSG: demo_msgs/Item
    """
    package, _, name = type_name.split('/')
    root = (package, name)
    texts = {root: definition(package, name)}
    waiting = [root]
    while waiting:
        used_by = waiting.pop(0)
        for used in _types_used(texts[used_by], used_by[0]):
            if used not in texts:
                texts[used] = definition(*used)
                waiting.append(used)
    dependencies = (
        f'{_SEPARATOR}\nMSG: {used[0]}/{used[1]}\n{text}'
        for used, text in texts.items()
        if used != root
    )
    return '\n'.join(text.rstrip('\n') for text in (texts[root], *dependencies)) + '\n'


def _types_used(text: str, package: str) -> list[tuple[str, str]]:
    """Message types that a definition names, in order; bare names lie in `package`."""
    matches = (_FIELD_TYPE.match(line) for line in text.splitlines())
    names = [match.group(1) for match in matches if match]
    parts = [name.split('/') for name in names if name not in _PRIMITIVES]
    return [(part[0] if len(part) > 1 else package, part[-1]) for part in parts]
