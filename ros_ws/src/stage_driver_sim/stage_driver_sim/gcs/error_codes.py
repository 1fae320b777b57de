# SPDX-License-Identifier: Apache-2.0
"""What the numbers mean that ``ERR?`` gives: those that a positioner's controller reports.

From the table of the C-863 manual MS249E, p. 207,
https://manualshive.com/ru/manual/pi/ms249e/1554329?page=213.
"""

from __future__ import annotations

NO_ERROR = 0
SYNTAX = 1
UNKNOWN_COMMAND = 2
TOO_LONG = 3
NO_SERVO = 5
POSITION_OUT_OF_LIMITS = 7
VELOCITY_OUT_OF_LIMITS = 8
STOPPED = 10
INVALID_AXIS = 15

TEXTS = {
    SYNTAX: 'an argument is malformed',
    UNKNOWN_COMMAND: 'unknown command',
    TOO_LONG: 'the command is too long',
    NO_SERVO: 'a motion with the servo off, or without reference',
    POSITION_OUT_OF_LIMITS: 'position out of limits',
    VELOCITY_OUT_OF_LIMITS: 'velocity out of limits',
    STOPPED: 'stopped by command',
    INVALID_AXIS: 'no such axis',
}


def describe(code: int) -> str:
    """Return what an error is, for people.

    Examples
    --------
    >>> describe(7)
    'GCS error 7 (position out of limits)'
    """
    return f'GCS error {code} ({TEXTS.get(code, "see the manual of the controller")})'
