# SPDX-License-Identifier: Apache-2.0
"""Serialized messages → the same with other times in them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

NS_PER_S = 1_000_000_000
_TIME = 'builtin_interfaces/Time'
_HEADER = 'std_msgs/Header'
_ENCAPSULATION = 4  # bytes before the content of a serialized message
_LITTLE_ENDIAN = 1


class StampShift:
    """Shifts the times in messages of one type.

    A time at the beginning is changed in place; where a type has times elsewhere, as /tf has, its
    messages are taken apart. Times of zero were never set, and stay zero.

    Parameters
    ----------
    message_type : type
        Of the messages.
    """

    def __init__(self, message_type: Any) -> None:
        self._type = message_type
        fields = list(message_type.get_fields_and_field_types().values())
        self._leads = bool(fields) and fields[0] in (_TIME, _HEADER)
        self._holds_others = any(
            _holds_time(message_type, i) for i in range(int(self._leads), len(fields))
        )

    def shifted(self, cdr: bytes, moved_ns: Callable[[int], int]) -> bytes:
        """Return a message with its times moved.

        Parameters
        ----------
        cdr : bytes
            Serialized message with its encapsulation header.
        moved_ns : callable
            New time of an old one [ns since 1970].
        """
        if self._holds_others:
            message = deserialize_message(cdr, self._type)
            _move(message, moved_ns)
            return bytes(serialize_message(message))
        if not self._leads or len(cdr) < _ENCAPSULATION + 8:
            return cdr
        layout = struct.Struct('<iI' if cdr[1] & _LITTLE_ENDIAN else '>iI')
        sec, nanosec = layout.unpack_from(cdr, _ENCAPSULATION)
        if sec == nanosec == 0:
            return cdr
        sec, nanosec = divmod(moved_ns(sec * NS_PER_S + nanosec), NS_PER_S)
        return b''.join(
            (cdr[:_ENCAPSULATION], layout.pack(sec, nanosec), cdr[_ENCAPSULATION + 8 :])
        )


def _holds_time(message_type: Any, field: int) -> bool:
    """Return whether a field is a time, or a message with one in it."""
    kind = message_type.SLOT_TYPES[field]
    while hasattr(kind, 'value_type'):
        kind = kind.value_type
    if not hasattr(kind, 'namespaced_name'):
        return False
    package, _, name = kind.namespaced_name()
    if f'{package}/{name}' in (_TIME, _HEADER):
        return True
    inner = _class_of(package, name)
    return any(_holds_time(inner, i) for i in range(len(inner.SLOT_TYPES)))


def _class_of(package: str, name: str) -> Any:
    module = __import__(f'{package}.msg', fromlist=[name])
    return getattr(module, name)


def _move(message: Any, moved_ns: Callable[[int], int]) -> None:
    """Move all times in a message."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind == _TIME:
            if value.sec or value.nanosec:
                value.sec, value.nanosec = divmod(
                    moved_ns(value.sec * NS_PER_S + value.nanosec), NS_PER_S
                )
            continue
        for inner in value if isinstance(value, list | tuple) else (value,):
            if hasattr(inner, 'get_fields_and_field_types'):
                _move(inner, moved_ns)
