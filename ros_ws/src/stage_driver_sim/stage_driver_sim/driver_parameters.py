# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver node: declared with unit, range and description, read as values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from stage_driver_sim.axis_parameters import AxisParameters
from stage_driver_sim.controller import ControllerSettings
from stage_driver_sim.conversions import UM_PER_M
from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.parameter_spec import ParameterSpec, declare_specs
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.protocol import AXES, Vector


def _per_axis(field: str, scale: float = 1.0) -> list[float]:
    return [getattr(axis, field) / scale for axis in REPRESENTATIVE_100_UM_XYZ]


_X = REPRESENTATIVE_100_UM_XYZ[0]

SPECS = (
    ParameterSpec('finger', 1, 1, 3, '', 'which finger of the station the stage moves'),
    ParameterSpec(
        'travel_lower', _per_axis('lower_um', UM_PER_M), -0.1, 0.1, 'm', 'lower end of the travel'
    ),
    ParameterSpec(
        'travel_upper', _per_axis('upper_um', UM_PER_M), -0.1, 0.1, 'm', 'upper end of the travel'
    ),
    ParameterSpec('home', [50e-6, 50e-6, 50e-6], -0.1, 0.1, 'm', 'where `home` goes'),
    ParameterSpec(
        'max_velocity', _X.max_velocity_um_s / UM_PER_M, 1e-6, 1.0, 'm/s', 'slew limit per axis'
    ),
    ParameterSpec('deceleration', 1.0, 1e-3, 1e3, 'm/s^2', 'of every stop, along the path'),
    ParameterSpec(
        'natural_frequency',
        _per_axis('natural_frequency_Hz'),
        0.1,
        1000.0,
        'Hz',
        'undamped natural frequency of the closed loop',
    ),
    ParameterSpec(
        'damping_ratio', _X.damping_ratio, 0.3, 10.0, '1', 'of the closed loop; 1 is critical'
    ),
    ParameterSpec(
        'resonance_frequency',
        _per_axis('resonance_Hz'),
        20.0,
        5000.0,
        'Hz',
        'undamped natural frequency of the mechanics',
    ),
    ParameterSpec('resonance_damping', _X.resonance_damping, 0.001, 2.0, '1', 'of the mechanics'),
    ParameterSpec(
        'hysteresis', _X.hysteresis, 0.0, 0.3, '1', 'width of the open-loop curve by its length'
    ),
    ParameterSpec(
        'creep', _X.creep_per_decade, 0.0, 0.03, '1', 'growth of a step per decade of time'
    ),
    ParameterSpec(
        'noise_rms', _X.noise_rms_um / UM_PER_M, 0.0, 1e-6, 'm', 'sensor noise per axis; 0: none'
    ),
    ParameterSpec(
        'sensor_resolution',
        _X.resolution_um / UM_PER_M,
        0.0,
        1e-6,
        'm',
        'step of the sensor reading; 0: continuous',
    ),
    ParameterSpec('seed', 0, 0, 2**31 - 1, '', 'of the sensor noise, together with `finger`'),
    ParameterSpec('control_rate', 1000.0, 50.0, 2000.0, 'Hz', 'of the control loop'),
    ParameterSpec('state_rate', 200.0, 1.0, 1000.0, 'Hz', 'at which `state` is published'),
    ParameterSpec(
        'on_target_window', 20e-9, 1e-10, 1e-4, 'm', 'largest distance that counts as on target'
    ),
    ParameterSpec(
        'on_target_dwell', 0.02, 0.0, 10.0, 's', 'time inside the window before on target'
    ),
)


@dataclass(frozen=True, eq=False)
class DriverParameters:
    """All parameters of a driver, in the units of the package."""

    finger: int
    hardware_id: str
    seed: int
    axes: tuple[AxisParameters, ...]
    home_um: Vector
    settings: ControllerSettings
    control_period_s: float
    state_period_s: float


def declare_parameters(node: Node) -> None:
    """Declare every parameter and refuse values that are not allowed, now and later.

    Raises
    ------
    rclpy.exceptions.ParameterException
        An override is not allowed.
    """
    declare_specs(node, SPECS, 'read when the node is configured')
    node.declare_parameter(
        'hardware_id',
        '',
        ParameterDescriptor(description='type and serial number; empty: simulated-<finger>'),
    )


def read_parameters(node: Node) -> DriverParameters:
    """Return the present values.

    Raises
    ------
    InvalidParameter
        Values that contradict each other.
    """

    def number(name: str) -> float:
        return float(node.get_parameter(name).value)

    def per_axis(name: str) -> list[float]:
        return [float(x) for x in node.get_parameter(name).value]

    axes = []
    for axis, lower, upper, frequency_Hz, resonance_Hz in zip(
        AXES,
        per_axis('travel_lower'),
        per_axis('travel_upper'),
        per_axis('natural_frequency'),
        per_axis('resonance_frequency'),
        strict=True,
    ):
        try:
            axes.append(
                AxisParameters(
                    lower_um=lower * UM_PER_M,
                    upper_um=upper * UM_PER_M,
                    max_velocity_um_s=number('max_velocity') * UM_PER_M,
                    natural_frequency_Hz=frequency_Hz,
                    damping_ratio=number('damping_ratio'),
                    noise_rms_um=number('noise_rms') * UM_PER_M,
                    resolution_um=number('sensor_resolution') * UM_PER_M,
                    resonance_Hz=resonance_Hz,
                    resonance_damping=number('resonance_damping'),
                    hysteresis=number('hysteresis'),
                    creep_per_decade=number('creep'),
                )
            )
        except InvalidParameter as error:
            raise InvalidParameter(f'{axis}: {error}') from error
    finger = int(node.get_parameter('finger').value)
    return DriverParameters(
        finger=finger,
        hardware_id=node.get_parameter('hardware_id').value or f'simulated-{finger}',
        seed=int(node.get_parameter('seed').value),
        axes=tuple(axes),
        home_um=np.array(per_axis('home')) * UM_PER_M,
        settings=ControllerSettings(
            deceleration_um_s2=number('deceleration') * UM_PER_M,
            on_target_window_um=number('on_target_window') * UM_PER_M,
            on_target_dwell_s=number('on_target_dwell'),
        ),
        control_period_s=1.0 / number('control_rate'),
        state_period_s=1.0 / number('state_rate'),
    )
