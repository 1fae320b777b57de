# SPDX-License-Identifier: Apache-2.0
"""A ROS message → what JSON can hold, with the names of its fields."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any


def message_note(message: Any) -> dict[str, Any]:
    """Return the fields of a message as they are, in SI units; None stands for NaN.

    Parameters
    ----------
    message : message
        Of any type.
    """
    return {name: _noted(getattr(message, name)) for name in message.get_fields_and_field_types()}


def _noted(value: Any) -> Any:
    """Return one value."""
    if hasattr(value, 'get_fields_and_field_types'):
        return message_note(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | int):
        return value
    if isinstance(value, Iterable):
        plain = value.tolist() if hasattr(value, 'tolist') else value
        return [_noted(item) for item in plain]
    return str(value)
