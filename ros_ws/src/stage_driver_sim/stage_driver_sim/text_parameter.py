# SPDX-License-Identifier: Apache-2.0
"""Text parameters of a node: declared with what is allowed, checked when set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from stage_driver_sim.errors import StageError


@dataclass(frozen=True)
class TextSpec:
    """One text parameter.

    Parameters
    ----------
    name : str
        ROS name.
    default : str
        Its value if nobody sets it.
    check : sequence of str, or callable
        What is allowed: one of these, or whatever the function does not raise `StageError` for.
    description : str
        What it means.
    when : str
        When the node reads it, for its users.
    read_only : bool
        True: it can only be given when the node starts.
    """

    name: str
    default: str
    check: Sequence[str] | Callable[[str], object]
    description: str
    when: str
    read_only: bool = False

    def objection(self, value: object) -> str:
        """Return why `value` is not allowed; empty if it is."""
        if not isinstance(value, str):
            return f'{self.name} is {value}; allowed: a text'
        if not callable(self.check):
            if value in self.check:
                return ''
            return f'{self.name} is {value!r}; allowed: {", ".join(self.check)}'
        try:
            self.check(value)
        except StageError as error:
            return str(error)
        return ''


def declare_texts(node: Node, specs: Sequence[TextSpec]) -> None:
    """Declare parameters, and refuse values that are not allowed, now and later.

    Raises
    ------
    rclpy.exceptions.ParameterException
        An override is not allowed.
    """
    by_name = {spec.name: spec for spec in specs}

    def check(parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name in by_name:
                objection = by_name[parameter.name].objection(parameter.value)
                if objection:
                    return SetParametersResult(successful=False, reason=objection)
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)
    for spec in specs:
        words = '' if callable(spec.check) else f'one of {", ".join(spec.check)}; '
        descriptor = ParameterDescriptor(
            description=spec.description,
            additional_constraints=words + spec.when,
            dynamic_typing=True,
            read_only=spec.read_only,
        )
        node.declare_parameter(spec.name, spec.default, descriptor)
