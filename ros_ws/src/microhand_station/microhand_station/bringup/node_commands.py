# SPDX-License-Identifier: Apache-2.0
"""Station file to command lines: which nodes a station has, and what each is told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from microhand_planner.ros.conversions import UM_PER_M, UN_PER_N, m_from_um
from microhand_station.config import FingerConfig, StationConfig
from microhand_station.view.address import ViewAddress

VIEW_ADDRESS_FILE = 'view_address'
"""In the folder of a station: where its page is."""
STATE_RATE_HZ = 100.0
"""Of every stage: each state is read by sequencer, twin and recorder, which costs more than
all control loops together if it is doubled."""


@dataclass(frozen=True)
class NodeCommand:
    """How to start one node.

    Parameters
    ----------
    name : str
        For people, and of its log.
    module : str
        Its ``main`` runs the node.
    arguments : tuple of str
        ROS arguments.
    """

    name: str
    module: str
    arguments: tuple[str, ...]


def node_commands(config: StationConfig, folder: Path) -> Iterator[NodeCommand]:
    """Write the parameter files of a station's nodes, and return how to start them.

    Parameters
    ----------
    config : StationConfig
        Written to ``station.yaml`` in `folder` already.
    folder : Path
        Of the station; the recorder writes its files there.
    """
    command = partial(_command, config, folder)
    root = _root(config)
    for finger, stage in enumerate(config.fingers, start=1):
        yield command(
            f'finger_{finger}',
            'stage_driver_sim.driver_node',
            driver_parameters(finger, stage),
            f'/finger_{finger}',
            *('-r', f'events:={root}/events'),
        )
    if config.twin.enabled:
        yield command('twin', 'microhand_twin.ros.twin_node', twin_parameters(config))
    yield command('planner', 'microhand_planner.ros.planner_node', {'frame': config.frame})
    yield command(
        'recorder',
        'microhand_station.recording.recorder_node',
        {
            'run_dir': str(folder),
            'max_message_size': round(config.recording.max_message_mb * 1e6),
        },
    )
    yield command(
        'sequencer',
        'microhand_station.sequencer.node',
        {'config': str(folder / 'station.yaml')},
    )


def view_command(config: StationConfig, folder: Path, address: ViewAddress) -> NodeCommand:
    """Write the parameter file of the live view, and return how to start it.

    Parameters
    ----------
    config, folder
        As in `node_commands`.
    address : ViewAddress
        Where the page shall be; its token goes by the environment.
    """
    parameters = {
        'config': str(folder / 'station.yaml'),
        'host': address.host,
        'port': address.port,
        'address_file': str(folder / VIEW_ADDRESS_FILE),
    }
    return _command(config, folder, 'view', 'microhand_station.view.view_node', parameters)


def _command(
    config: StationConfig,
    folder: Path,
    name: str,
    module: str,
    parameters: Mapping[str, Any],
    namespace: str = '',
    *extra: str,
) -> NodeCommand:
    """Write the parameter file of a node, and return how to start it."""
    path = folder / f'{name}.params.yaml'
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': dict(parameters)}}), 'utf-8')
    full = f'{_root(config)}{namespace}' or '/'
    arguments = ('--ros-args', '-r', f'__ns:={full}', '--params-file', str(path), *extra)
    return NodeCommand(name, module, arguments)


def _root(config: StationConfig) -> str:
    """Return what all names of a station begin with."""
    return f'/{config.namespace.strip("/")}'.rstrip('/')


def twin_parameters(config: StationConfig) -> dict[str, Any]:
    """Return the parameters of the twin, in SI units; what is left out follows the plan."""
    twin = config.twin
    parameters: dict[str, Any] = {'frame': config.frame}
    if config.namespace:
        parameters['frame_prefix'] = f'{config.namespace.strip("/")}/'
    if twin.friction is not None:
        parameters['friction'] = twin.friction
    if twin.pull_off_uN is not None:
        parameters['pull_off_force'] = twin.pull_off_uN / UN_PER_N
    for finger, stage in enumerate(config.fingers, start=1):
        parameters[f'finger_{finger}.base'] = m_from_um(stage.base_um).tolist()
        parameters[f'finger_{finger}.stiffness'] = stage.stiffness_n_per_m
    return parameters


def driver_parameters(finger: int, stage: FingerConfig) -> dict[str, Any]:
    """Return the parameters of a stage driver, in SI units."""
    return {
        'finger': finger,
        'travel_lower': m_from_um(stage.lower_um).tolist(),
        'travel_upper': m_from_um(stage.upper_um).tolist(),
        'home': m_from_um(stage.home_um).tolist(),
        'max_velocity': stage.max_velocity_um_s / UM_PER_M,
        'state_rate': STATE_RATE_HZ,
        **stage.driver,
    }
