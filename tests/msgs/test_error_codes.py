# SPDX-License-Identifier: Apache-2.0
"""The error codes on the wire and the errors of the core are the same list."""

import re
from typing import Any

import pytest
from microhand_msgs_py.msg import ErrorCode

from microhand_planner.core import errors

CONSTANTS: dict[str, int] = {
    name: value
    for name in dir(type(ErrorCode))
    if name.isupper() and isinstance(value := getattr(ErrorCode, name), int)
}


def subclasses_of(error: type[Exception]) -> list[Any]:
    """Return all classes below `error` in the tree of errors."""
    return [found for child in error.__subclasses__() for found in (child, *subclasses_of(child))]


def constant_name(error: type[Exception]) -> str:
    """Return the constant that a class stands for: ``UnknownObject`` → ``UNKNOWN_OBJECT``."""
    return re.sub(r'(?<=[a-z])(?=[A-Z])', '_', error.__name__).upper()


CONCRETE = [
    error
    for error in subclasses_of(errors.MicrohandError)
    if error.__module__ == errors.__name__ and error not in (errors.NoPlan, errors.RunFailed)
]


def test_constants_are_unique() -> None:
    """No two constants share a value."""
    assert len(CONSTANTS) > 20
    assert len(set(CONSTANTS.values())) == len(CONSTANTS)


@pytest.mark.parametrize('error', CONCRETE, ids=lambda error: error.__name__)
def test_each_error_has_its_constant(error: Any) -> None:
    """The code of each error class of the core is the constant of the same name."""
    name = {'TIME_LIMIT_REACHED': 'TIME_LIMIT'}.get(constant_name(error), constant_name(error))
    assert CONSTANTS[name] == error.code


def test_each_planning_constant_has_its_error() -> None:
    """The core has one class for each code of the 100s and 200s: none is forgotten."""
    assert sorted(error.code for error in CONCRETE) == sorted(
        value for value in CONSTANTS.values() if 100 <= value < 300
    )


@pytest.mark.parametrize('error', CONCRETE, ids=lambda error: error.__name__)
def test_exit_status_follows_the_hundreds(error: Any) -> None:
    """1xx ends a command with status 2, 2xx with 3."""
    assert error.exit_status == {1: 2, 2: 3}[error.code // 100]


def test_failed_runs_carry_their_code() -> None:
    """A failed run ends a command with status 4 and keeps the code that says why."""
    error = errors.RunFailed('finger 2 does not answer', ErrorCode.STAGE_MISSING)
    assert (error.exit_status, error.code) == (4, 300)
    assert errors.RunFailed('?').code == ErrorCode.INTERNAL
