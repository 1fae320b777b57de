# SPDX-License-Identifier: Apache-2.0
"""Why a stage or its driver refuses.

::

    StageError
    ├── InvalidNumber      NaN or infinite
    ├── InvalidParameter   a setting or field outside what is allowed
    ├── TravelExceeded     beyond the travel or the velocity limit
    ├── StreamBroken       a gap, a contradiction, a wrong time, or a stream that ran dry
    │   └── LeftoverChunk      the rest of a stream that is over; harmless
    ├── ContactSilent      a guarded stream without news of contacts
    ├── NotAllowed         the command does not fit the present mode
    └── StageFailed        the stage itself reports a failure
        └── StageSilent        it does not answer

The package imports nothing of the planner, so it has its own tree; `code` is the value of
``microhand_msgs_py/msg/ErrorCode``, and a test keeps the two in step.
"""

from __future__ import annotations


class StageError(Exception):
    """Root of all errors that a stage or its driver raises on purpose."""

    code: int = 900


class InvalidNumber(StageError):
    """NaN or infinity where a number is needed."""

    code = 105


class InvalidParameter(StageError):
    """A setting or a field outside what is allowed."""

    code = 106


class TravelExceeded(StageError):
    """A position or a velocity beyond what the stage can do."""

    code = 108


class StreamBroken(StageError):
    """A chunk that does not continue the stream, or a stream that ran dry."""

    code = 303


class LeftoverChunk(StreamBroken):
    """A late chunk of a stream that is over: to be dropped, not to be feared."""


class ContactSilent(StageError):
    """A guarded stream, and nobody says whether the tip touches."""

    code = 310


class NotAllowed(StageError):
    """The command does not fit the present mode."""

    code = 308


class StageFailed(StageError):
    """The stage reports that it does not do what it is told."""

    code = 301


class StageSilent(StageFailed):
    """The stage does not answer, or what it answers makes no sense."""
