# SPDX-License-Identifier: Apache-2.0
"""What can go wrong, and for whom.

::

    MicrohandError
    ├── BadRequest            the request cannot be served as it stands        exit 2
    │   ├── UnknownObject         neither a catalogue name nor a readable mesh
    │   ├── InvalidMesh           not watertight, no volume, several bodies, ...
    │   ├── EmptySection          a manipulation plane misses the object
    │   ├── InvalidRotation       not a rotation
    │   ├── InvalidNumber         NaN or infinite
    │   ├── InvalidParameter      a number outside what is allowed
    │   ├── InvalidPlan           a plan that contradicts itself or its hash
    │   ├── TravelExceeded        a setpoint outside what a stage can do
    │   └── InadmissibleContact   the tip cannot stand where it must
    ├── NoPlan                the request is sound, there is no plan to return  exit 3
    │   ├── NoPlanExists          proven by an exhaustive search
    │   ├── TimeLimitReached      cut off; a plan may exist
    │   └── Cancelled             the caller cancelled
    └── RunFailed             the motion did not finish                         exit 4

`code` is the value of ``microhand_msgs_py/msg/ErrorCode``; a test keeps the two in step.
"""

from __future__ import annotations

_LONGEST_VALUE = 200  # characters of a value at fault that a message shows


class MicrohandError(Exception):
    """Root of all errors that microhand raises on purpose."""

    code: int = 900
    exit_status: int = 4


class BadRequest(MicrohandError):
    """The request cannot be served as it stands.

    Parameters
    ----------
    field : str
        Name of the field at fault, as the user writes it.
    value : object
        What was given.
    allowed : str
        What is allowed there.
    """

    code = 100
    exit_status = 2

    def __init__(self, field: str, value: object, allowed: str) -> None:
        shown = ' '.join(str(value).split())
        if len(shown) > _LONGEST_VALUE:
            shown = f'{shown[: _LONGEST_VALUE - 1]}…'
        super().__init__(f'{field} is {shown}; allowed: {allowed}')
        self.field = field
        self.value = value
        self.allowed = allowed


class UnknownObject(BadRequest):
    """Neither a catalogue name nor a readable mesh file."""

    code = 101


class InvalidMesh(BadRequest):
    """A mesh that bounds no single solid of plausible size."""

    code = 102


class EmptySection(BadRequest):
    """A manipulation plane that misses the object."""

    code = 103


class InvalidRotation(BadRequest):
    """Not a rotation: a quaternion of zero length, NaN, or a wrong number of values."""

    code = 104


class InvalidNumber(BadRequest):
    """NaN or infinity where a number is needed."""

    code = 105


class InvalidParameter(BadRequest):
    """A number outside what is allowed."""

    code = 106


class InvalidPlan(BadRequest):
    """A plan that contradicts itself or its hash."""

    code = 107


class TravelExceeded(BadRequest):
    """A setpoint outside the travel, velocity or acceleration of a stage."""

    code = 108


class InadmissibleContact(BadRequest):
    """The tip cannot stand where the plan must put it."""

    code = 109


class NoPlan(MicrohandError):
    """The request is sound, but there is no plan to return.

    Parameters
    ----------
    message : str
        One sentence for the user.
    expanded : int
        States that the search had expanded when it ended: the evidence.
    """

    exit_status = 3

    def __init__(self, message: str, expanded: int = 0) -> None:
        super().__init__(message)
        self.expanded = expanded


class NoPlanExists(NoPlan):
    """The search was exhaustive and found no sequence of grasps that reaches the goal."""

    code = 200


class TimeLimitReached(NoPlan):
    """The search was cut off; a plan may exist."""

    code = 201


class Cancelled(NoPlan):
    """The caller cancelled the search."""

    code = 202


class RunFailed(MicrohandError):
    """The motion did not finish.

    Parameters
    ----------
    message : str
        One sentence that says where.
    code : int
        Value of ``microhand_msgs_py/msg/ErrorCode`` in the 300s, or 900.
    """

    code = 900
    exit_status = 4

    def __init__(self, message: str, code: int = 900) -> None:
        super().__init__(message)
        self.code = code
