# SPDX-License-Identifier: Apache-2.0
"""Numeric parameters of a node: declared with unit, range and description, checked when set.

On the ROS side everything is SI. An integer is accepted wherever a double is meant: YAML files and
command lines write ``150`` for 150.0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter


@dataclass(frozen=True)
class ParameterSpec:
    """One numeric parameter.

    Parameters
    ----------
    name : str
        ROS name.
    default : int or float or list of 3 float
        Its type decides what is accepted: an integer, a number, one number per axis.
    low, high : float
        Allowed range, ends included.
    unit : str
        SI unit.
    description : str
        What it means.
    """

    name: str
    default: int | float | list[float]
    low: float
    high: float
    unit: str
    description: str

    def objection(self, value: object) -> str:
        """Return why `value` is not allowed; empty if it is."""
        numbers = list(value) if isinstance(value, Iterable) else [value]
        count, kind = 1, 'a number'
        if isinstance(self.default, list):
            count, kind = 3, 'three numbers'
        elif isinstance(self.default, int):
            kind = 'an integer'
        if len(numbers) == count and all(self._fits(x) for x in numbers):
            return ''
        allowed = f'{kind} from {self.low:g} to {self.high:g} {self.unit}'
        return f'{self.name} is {value}; allowed: {allowed.rstrip()}'

    def _fits(self, number: object) -> bool:
        """Return whether `number` has an accepted type and lies in the range."""
        if isinstance(number, bool) or not isinstance(number, int | float):
            return False
        if isinstance(self.default, int) and isinstance(number, float):
            return False
        return self.low <= number <= self.high


def declare_specs(node: Node, specs: Sequence[ParameterSpec], when: str) -> None:
    """Declare parameters, and refuse values that are not allowed, now and later.

    Parameters
    ----------
    node : Node
        Gets the parameters.
    specs : sequence of ParameterSpec
        What it gets.
    when : str
        When the node reads them, for its users.

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
        node.declare_parameter(spec.name, spec.default, _descriptor(spec, when))


def _descriptor(spec: ParameterSpec, when: str) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows; the range is checked by `objection`."""
    descriptor = ParameterDescriptor(
        description=f'[{spec.unit}] {spec.description}' if spec.unit else spec.description,
        additional_constraints=when,
        dynamic_typing=True,
    )
    if isinstance(spec.default, int):
        descriptor.integer_range = [
            IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)
        ]
    else:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=spec.low, to_value=spec.high, step=0.0)
        ]
    return descriptor
