# SPDX-License-Identifier: Apache-2.0
"""The text of a message type, with its comments → the unit of each field.

Definitions of microhand begin the comment of each field with its unit in brackets:
``float64 period   # [s] time between two setpoints``. A field that holds a message hands its unit
down to that message's fields, and the message types of ROS have the units of REP 103.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

_SEPARATOR = re.compile(r'^=+\s*$', re.MULTILINE)
_TYPE_OF_PART = re.compile(r'^MSG: (\S+)\s*$', re.MULTILINE)
_FIELD = re.compile(
    r'^\s*(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+(?P<name>[a-z]\w*)'
    r'(?!\s*=)[^#\n]*(?:#\s*(?:\[(?P<unit>[^\]]+)\])?.*)?$'
)
_BY_TYPE = {
    'builtin_interfaces/Time': 's',
    'builtin_interfaces/Duration': 's',
}
_OF_FIELDS = {
    'geometry_msgs/Pose': {'position': 'm'},
    'geometry_msgs/Transform': {'translation': 'm'},
}


def schema_units(type_name: str, schema: str) -> Mapping[str, str]:
    r"""Return the unit of each field by its path, as in ``position.x``; no unit: not there.

    Parameters
    ----------
    type_name : str
        ``package/msg/Type``.
    schema : str
        As in an mcap file: the definition, then those of all types that it uses.

    Examples
    --------
    >>> dict(schema_units('a_msgs/msg/A', 'float64 x  # [m] where\nfloat64 y'))
    {'x': 'm'}
    """
    package, _, name = type_name.replace('/msg/', '/').rpartition('/')
    parts = _SEPARATOR.split(schema)
    texts = {f'{package}/{name}': parts[0]}
    for part in parts[1:]:
        found = _TYPE_OF_PART.search(part)
        if found:
            texts[found.group(1).replace('/msg/', '/')] = part
    units: dict[str, str] = {}
    _add(units, texts, f'{package}/{name}', '', '')
    return units


def _add(
    units: dict[str, str], texts: Mapping[str, str], type_name: str, prefix: str, handed: str
) -> None:
    """Add the units of the fields of a type; `handed` is that of the field that holds it."""
    package = type_name.rpartition('/')[0]
    for line in texts.get(type_name, '').splitlines():
        found = _FIELD.match(line)
        if not found:
            continue
        kind, path = found['type'], f'{prefix}{found["name"]}'
        kind = kind.replace('/msg/', '/')
        if kind not in texts and f'{package}/{kind}' in texts:
            kind = f'{package}/{kind}'
        known = _OF_FIELDS.get(type_name, {}).get(found['name'])
        unit = _BY_TYPE.get(kind) or found['unit'] or known or handed
        if kind in texts and kind not in _BY_TYPE:
            _add(units, texts, kind, f'{path}.', unit)
        elif unit and unit != '-':
            units[path] = unit
