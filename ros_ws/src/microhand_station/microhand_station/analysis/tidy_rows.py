# SPDX-License-Identifier: Apache-2.0
"""A decoded message → the rows of a tidy table, one value per cell.

A message is one row; a list in it makes one row per element, with the other fields repeated and
the number of the element, from 1. Lists that belong together, such as positions and velocities of
setpoints, are laid side by side; flat arrays of points become rows of x, y and z. What there is of
each finger stands side by side as well.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

Row = dict[str, Any]

_NS_PER_S = 1_000_000_000
_XYZ = ('x', 'y', 'z')
_OF_FINGERS = tuple(f'finger_{finger}.{axis}' for finger in (1, 2, 3) for axis in _XYZ)
# Flat arrays whose rows have a meaning: names of the columns of a row.
_ROWS: dict[str, dict[str, tuple[str, ...]]] = {
    'microhand_msgs_py/SetpointChunk': {'positions': _XYZ, 'velocities': _XYZ},
    'microhand_msgs_py/PlanStep': {
        'object_positions': _XYZ,
        'object_orientations': ('x', 'y', 'z', 'w'),
        'tip_positions': _OF_FINGERS,
        'contact_normals': _OF_FINGERS,
        'contact_forces': _OF_FINGERS,
    },
}
# Lists with one entry per finger: messages that say of which, and values for fingers 1, 2, 3.
_BY_FINGER = {
    'microhand_msgs_py/ObjectState': 'contacts',
    'microhand_msgs_py/PlanStep': 'in_contact',
}
SIDE_TABLES = {'microhand_msgs_py/Plan': ('rotations', 'options')}
"""Fields that make tables of their own, for they count something else than the rest."""


def tidy_rows(message: Any, side_table: str = '') -> Iterator[Row]:
    """Yield the rows of a message: values by the paths of their fields.

    Times are exact decimal texts of seconds, with nine digits after the point.

    Parameters
    ----------
    message : object
        Decoded by mcap-ros2-support.
    side_table : str
        One of `SIDE_TABLES`: the rows of that list alone.
    """
    if side_table:
        yield from _rows({side_table: getattr(message, side_table)}, '')
        return
    type_name = type_of(message)
    yield from _rows(_fields(message, SIDE_TABLES.get(type_name, ())), type_name)


def unit_of(column: str, units: Mapping[str, str]) -> str:
    """Return the unit of a column; empty: it has none.

    Parameters
    ----------
    column : str
        Path of a value in a row.
    units : mapping
        Units by the paths of the message type, see `schema_units`.

    Examples
    --------
    >>> units = {'contacts.force.x': 'N', 'positions': 'm'}
    >>> unit_of('contacts.finger_2.force.x', units), unit_of('positions.x', units)
    ('N', 'm')
    """
    parts = [part for part in column.split('.') if not part.startswith('finger_')]
    whole, without_axis = '.'.join(parts), '.'.join(parts[:-1])
    axis = parts[-1] in (*_XYZ, 'w')
    return units.get(whole, units.get(without_axis, '') if axis else '')


def _rows(fields: Mapping[str, Any], type_name: str) -> Iterator[Row]:
    """Yield the rows of a message given by its fields."""
    fixed: Row = {}
    lists: dict[str, list[list[Row]]] = {}
    counter = 'number'
    for name, value in fields.items():
        if _is_time(value):
            fixed[name] = _seconds(value)
        elif _is_message(value):
            inner = list(_rows(_fields(value), type_of(value)))
            if len(inner) == 1:
                fixed |= _prefixed(name, inner[0])
            else:
                lists[name] = [[row] for row in inner]
        elif _BY_FINGER.get(type_name) == name:
            fixed |= _by_finger(name, value)
        elif isinstance(value, list | tuple) and type_name in _ROWS and name in _ROWS[type_name]:
            lists[name] = _cut(value, _ROWS[type_name][name])
            counter = 'row'
        elif isinstance(value, list | tuple):
            lists[name] = [
                list(_rows(_fields(item), type_of(item))) if _is_message(item) else [{'': item}]
                for item in value
            ]
        else:
            fixed[name] = value
    yield from _beside(fixed, lists, counter)


def _beside(fixed: Row, lists: Mapping[str, list[list[Row]]], counter: str) -> Iterator[Row]:
    """Lay lists side by side, each element with its number in the column `counter`."""
    count = max((len(items) for items in lists.values()), default=0)
    if not count:
        yield fixed
        return
    for number in range(count):
        parts = []
        for name, items in lists.items():
            rows = items[number] if number < len(items) else [{}]
            parts.append([_prefixed(name, row) for row in rows])
        for combined in itertools.zip_longest(*parts, fillvalue={}):
            row: Row = {**fixed, counter: number + 1}
            for part in combined:
                row |= part
            yield row


def _cut(values: Sequence[float], columns: Sequence[str]) -> list[list[Row]]:
    """Cut a flat array into rows."""
    width = len(columns)
    return [
        [dict(zip(columns, values[begin : begin + width], strict=False))]
        for begin in range(0, len(values), width)
    ]


def _by_finger(name: str, contacts: Sequence[Any]) -> Row:
    row: Row = {}
    for finger, contact in enumerate(contacts, start=1):
        if not _is_message(contact):
            row[f'{name}.finger_{finger}'] = contact
            continue
        (inner,) = _rows(_fields(contact, ('finger',)), type_of(contact))
        row |= _prefixed(f'{name}.finger_{contact.finger}', inner)
    return row


def _prefixed(name: str, row: Row) -> Row:
    return {f'{name}.{key}' if key else name: value for key, value in row.items()}


def _fields(message: Any, left_out: Sequence[str] = ()) -> dict[str, Any]:
    return {name: getattr(message, name) for name in message.__slots__ if name not in left_out}


def type_of(message: Any) -> str:
    """Return ``package/Type``, as the decoder names the classes that it makes."""
    return str(getattr(message, '_type', '')).replace('/msg/', '/')


def _is_message(value: Any) -> bool:
    return hasattr(value, '__slots__') and not isinstance(value, str | bytes | list | tuple)


def _is_time(value: Any) -> bool:
    return _is_message(value) and tuple(value.__slots__) == ('sec', 'nanosec')


def _seconds(time: Any) -> str:
    """Return a time as an exact decimal."""
    ns = int(time.sec) * _NS_PER_S + int(time.nanosec)
    sign, ns = ('-', -ns) if ns < 0 else ('', ns)
    return f'{sign}{ns // _NS_PER_S}.{ns % _NS_PER_S:09d}'
