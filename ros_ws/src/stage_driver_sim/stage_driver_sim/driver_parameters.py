# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver node: declared with unit, range and description, read as values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rclpy.node import Node

from microhand_node.parameter_spec import ParameterSpec, declare_specs
from stage_driver_sim.axis_parameters import RANGES, AxisParameters
from stage_driver_sim.controller import ControllerSettings
from stage_driver_sim.conversions import UM_PER_M
from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.faults import Fault, FaultSettings
from stage_driver_sim.gcs.connection import PORT, parse_address
from stage_driver_sim.presets import PRESETS, max_acceleration_um_s2
from stage_driver_sim.protocol import AXES, StageLimits
from stage_driver_sim.text_parameter import TextSpec, declare_texts

DRIVERS = ('simulated', 'gcs')
CONFIGURE = 'read when the node is configured'
AT_ONCE = 'takes effect at once'


def _split_axes(text: str) -> list[str]:
    """Return the names of three axes."""
    names = text.split()
    if len(names) != 3 or len(set(names)) != 3:
        raise InvalidParameter(f'gcs_axes is {text!r}; allowed: three different names')
    return names


TEXTS = (
    TextSpec('driver', 'simulated', DRIVERS, 'what drives the stage', CONFIGURE, read_only=True),
    TextSpec(
        'preset',
        next(iter(PRESETS)),
        tuple(PRESETS),
        'stage to simulate: the defaults of the other parameters',
        'read when the node starts',
        read_only=True,
    ),
    TextSpec(
        'hardware_id',
        '',
        str,
        'type and serial number; empty: simulated-<finger>, or what the controller says; '
        'a gcs controller must have it in its answer to *IDN?',
        CONFIGURE,
    ),
    TextSpec(
        'gcs_address', f'127.0.0.1:{PORT}', parse_address, 'host:port of a controller', CONFIGURE
    ),
    TextSpec('gcs_axes', '1 2 3', _split_axes, 'what the controller calls x y z', CONFIGURE),
    TextSpec(
        'fault',
        Fault.NONE.value,
        tuple(fault.value for fault in Fault),
        'what a simulated stage does wrong',
        AT_ONCE,
    ),
)

FAULT_SPECS = (
    ParameterSpec('fault_delay', 0.1, 0.0, 10.0, 's', 'of the commands, fault late'),
    ParameterSpec('fault_drift', 1e-6, 0.0, 1e-2, 'm/s', 'per axis, fault drifting'),
    ParameterSpec('fault_margin', 0.5e-6, 0.0, 1e-3, 'm', 'per axis, fault limit'),
)

DRIVER_SPECS = (
    ParameterSpec('finger', 1, 1, 3, '', 'which finger of the station the stage moves'),
    ParameterSpec('deceleration', 1.0, 1e-3, 1e3, 'm/s^2', 'of every stop, along the path'),
    ParameterSpec('seed', 0, 0, 2**31 - 1, '', 'of the sensor noise, together with `finger`'),
    ParameterSpec('control_rate', 1000.0, 50.0, 2000.0, 'Hz', 'of the control loop'),
    ParameterSpec(
        'realtime_priority', 0, 0, 98, '', 'of the control loop (SCHED_FIFO); 0: ordinary'
    ),
    ParameterSpec('state_rate', 200.0, 1.0, 1000.0, 'Hz', 'at which `state` is published'),
    ParameterSpec(
        'on_target_window', 20e-9, 1e-10, 1e-4, 'm', 'largest distance that counts as on target'
    ),
    ParameterSpec(
        'on_target_dwell', 0.02, 0.0, 10.0, 's', 'time inside the window before on target'
    ),
    ParameterSpec(
        'gcs_rate', 500.0, 10.0, 1000.0, 'Hz', 'at which a controller is commanded and read'
    ),
)


def stage_specs(axes: Sequence[AxisParameters]) -> tuple[ParameterSpec, ...]:
    """Return the parameters that describe a stage; their defaults are that of given axes."""

    def per_axis(field: str, scale: float = 1.0) -> list[float]:
        return [getattr(axis, field) / scale for axis in axes]

    x = axes[0]
    return (
        ParameterSpec(
            'travel_lower', per_axis('lower_um', UM_PER_M), -0.1, 0.1, 'm', 'its lower end'
        ),
        ParameterSpec(
            'travel_upper', per_axis('upper_um', UM_PER_M), -0.1, 0.1, 'm', 'its upper end'
        ),
        ParameterSpec(
            'home', per_axis('middle_um', UM_PER_M), -0.1, 0.1, 'm', 'where `home` goes'
        ),
        ParameterSpec(
            'max_velocity', x.max_velocity_um_s / UM_PER_M, 1e-6, 1.0, 'm/s', 'slew limit per axis'
        ),
        ParameterSpec(
            'max_acceleration',
            max_acceleration_um_s2(x) / UM_PER_M,
            0.0,
            1e4,
            'm/s^2',
            'per axis, for who plans motions; 0: not limited',
        ),
        ParameterSpec(
            'natural_frequency',
            per_axis('natural_frequency_Hz'),
            *RANGES['natural_frequency_Hz'],
            'Hz',
            'undamped natural frequency of the closed loop',
        ),
        ParameterSpec(
            'damping_ratio',
            x.damping_ratio,
            *RANGES['damping_ratio'],
            '1',
            'of the closed loop; 1 is critical',
        ),
        ParameterSpec(
            'resonance_frequency',
            per_axis('resonance_Hz'),
            *RANGES['resonance_Hz'],
            'Hz',
            'undamped natural frequency of the mechanics',
        ),
        ParameterSpec(
            'resonance_damping',
            x.resonance_damping,
            *RANGES['resonance_damping'],
            '1',
            'damping ratio of the mechanics',
        ),
        ParameterSpec(
            'hysteresis',
            x.hysteresis,
            *RANGES['hysteresis'],
            '1',
            'width of the open-loop curve over the travel, as a share of it',
        ),
        ParameterSpec(
            'creep',
            x.creep_per_decade,
            *RANGES['creep_per_decade'],
            '1',
            'growth of an open-loop step per decade of time, as a share of it',
        ),
        ParameterSpec(
            'noise_rms', x.noise_rms_um / UM_PER_M, 0.0, 1e-6, 'm', 'sensor noise; 0: none'
        ),
        ParameterSpec(
            'sensor_resolution',
            x.resolution_um / UM_PER_M,
            0.0,
            1e-6,
            'm',
            'step of the sensor reading; 0: continuous',
        ),
    )


@dataclass(frozen=True, eq=False)
class DriverParameters:
    """All parameters of a driver, in the units of the package."""

    driver: str
    finger: int
    hardware_id: str
    seed: int
    axes: tuple[AxisParameters, ...]
    limits: StageLimits
    gcs_address: tuple[str, int]
    gcs_axes: tuple[str, ...]
    gcs_period_s: float
    settings: ControllerSettings
    control_period_s: float
    realtime_priority: int
    state_period_s: float


def declare_parameters(node: Node) -> None:
    """Declare every parameter and refuse values that are not allowed, now and later.

    Raises
    ------
    rclpy.exceptions.ParameterException
        An override is not allowed.
    """
    declare_texts(node, TEXTS)
    declare_specs(node, FAULT_SPECS, AT_ONCE)
    preset = PRESETS[node.get_parameter('preset').value]
    declare_specs(node, (*DRIVER_SPECS, *stage_specs(preset)), CONFIGURE)


def read_fault(node: Node) -> FaultSettings:
    """Return what the stage shall do wrong.

    Raises
    ------
    InvalidParameter
        The stage is not a simulated one.
    """
    fault = Fault(_text(node, 'fault'))
    if fault is not Fault.NONE and _text(node, 'driver') != 'simulated':
        raise InvalidParameter(
            f'fault is {fault.value!r}; allowed with driver {_text(node, "driver")}: none'
        )
    return FaultSettings(
        fault,
        delay_s=_number(node, 'fault_delay'),
        drift_um_s=_number(node, 'fault_drift') * UM_PER_M,
        margin_um=_number(node, 'fault_margin') * UM_PER_M,
    )


def read_parameters(node: Node) -> DriverParameters:
    """Return the present values.

    Raises
    ------
    InvalidParameter
        Values that contradict each other.
    """
    axes = _axes(node)
    acceleration_um_s2 = _number(node, 'max_acceleration') * UM_PER_M
    return DriverParameters(
        driver=_text(node, 'driver'),
        finger=int(_number(node, 'finger')),
        hardware_id=_text(node, 'hardware_id'),
        seed=int(_number(node, 'seed')),
        axes=axes,
        limits=StageLimits(
            lower_um=np.array([axis.lower_um for axis in axes]),
            upper_um=np.array([axis.upper_um for axis in axes]),
            home_um=np.array(_per_axis(node, 'home')) * UM_PER_M,
            max_velocity_um_s=axes[0].max_velocity_um_s,
            max_acceleration_um_s2=acceleration_um_s2 or float('inf'),
        ),
        gcs_address=parse_address(_text(node, 'gcs_address')),
        gcs_axes=tuple(_split_axes(_text(node, 'gcs_axes'))),
        gcs_period_s=1.0 / _number(node, 'gcs_rate'),
        settings=ControllerSettings(
            deceleration_um_s2=_number(node, 'deceleration') * UM_PER_M,
            on_target_window_um=_number(node, 'on_target_window') * UM_PER_M,
            on_target_dwell_s=_number(node, 'on_target_dwell'),
        ),
        control_period_s=1.0 / _number(node, 'control_rate'),
        realtime_priority=int(_number(node, 'realtime_priority')),
        state_period_s=1.0 / _number(node, 'state_rate'),
    )


def _axes(node: Node) -> tuple[AxisParameters, ...]:
    axes = []
    for name, lower, upper, frequency_Hz, resonance_Hz in zip(
        AXES,
        _per_axis(node, 'travel_lower'),
        _per_axis(node, 'travel_upper'),
        _per_axis(node, 'natural_frequency'),
        _per_axis(node, 'resonance_frequency'),
        strict=True,
    ):
        try:
            axes.append(
                AxisParameters(
                    lower_um=lower * UM_PER_M,
                    upper_um=upper * UM_PER_M,
                    max_velocity_um_s=_number(node, 'max_velocity') * UM_PER_M,
                    natural_frequency_Hz=frequency_Hz,
                    damping_ratio=_number(node, 'damping_ratio'),
                    noise_rms_um=_number(node, 'noise_rms') * UM_PER_M,
                    resolution_um=_number(node, 'sensor_resolution') * UM_PER_M,
                    resonance_Hz=resonance_Hz,
                    resonance_damping=_number(node, 'resonance_damping'),
                    hysteresis=_number(node, 'hysteresis'),
                    creep_per_decade=_number(node, 'creep'),
                )
            )
        except InvalidParameter as error:
            raise InvalidParameter(f'{name}: {error}') from error
    return tuple(axes)


def _text(node: Node, name: str) -> str:
    return str(node.get_parameter(name).value)


def _number(node: Node, name: str) -> float:
    return float(node.get_parameter(name).value)


def _per_axis(node: Node, name: str) -> list[float]:
    return [float(x) for x in node.get_parameter(name).value]
