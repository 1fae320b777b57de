# SPDX-License-Identifier: Apache-2.0
"""The command ``gcs_server``: a simulated GCS controller in a process of its own."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stage_driver_sim.errors import StageError
from stage_driver_sim.faults import Fault, FaultSettings
from stage_driver_sim.gcs.connection import PORT
from stage_driver_sim.gcs.server import GcsServer
from stage_driver_sim.gcs.simulated_controller import SimulatedController
from stage_driver_sim.presets import PRESETS
from stage_driver_sim.simulated_stage import SimulatedStage


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until SIGINT or SIGTERM; return the exit status, 2 for what cannot be.

    Parameters
    ----------
    arguments : sequence of str, optional
        Command line; default: that of the process.
    """
    options = _parser().parse_args(arguments)
    low_um, high_um = options.travel_um
    home_um = options.home_um or [0.5 * (low_um + high_um)] * 3
    try:
        axes = [
            replace(axis, lower_um=low_um, upper_um=high_um) for axis in PRESETS[options.preset]
        ]
        stage = SimulatedStage(
            axes,
            home_um=np.array(home_um),
            rng=np.random.default_rng(options.seed),
            now_s=time.monotonic(),
            hardware_id=options.preset,
        )
        controller = SimulatedController(stage)
        controller.set_fault(FaultSettings(Fault(options.fault)), time.monotonic())
        server = GcsServer(controller, options.host, options.port)
    except (StageError, OSError) as error:
        sys.stderr.write(f'gcs_server: {error}\n')
        return 2
    server.answer_delay_s = options.answer_delay_s
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop_soon())
    sys.stdout.write(f'a simulated GCS controller listens on {options.host}:{server.port}\n')
    sys.stdout.flush()
    server.serve()
    server.close()
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='gcs_server',
        description='A simulated controller of a three-axis piezo stage that speaks GCS 2.0. '
        'FLT stuck|silent|late|drifting|limit|none, sent to it, lets something go wrong.',
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = parser.add_argument
    add('--host', default='127.0.0.1', help='address to listen on')
    add('--port', type=_port, default=PORT, help='0: any that is free')
    add('--preset', choices=list(PRESETS), default=next(iter(PRESETS)), help='the stage')
    add('--travel-um', type=float, nargs=2, default=[0.0, 200.0], metavar=('LOW', 'HIGH'))
    add('--home-um', type=float, nargs=3, metavar=('X', 'Y', 'Z'), help='where it powers up')
    add('--seed', type=_seed, default=0, help='of the sensor noise')
    add('--fault', choices=[fault.value for fault in Fault], default='none')
    add('--answer-delay-s', type=_delay, default=0.0, help='how long each reply is held back')
    return parser


def _port(text: str) -> int:
    number = int(text)
    if not 0 <= number <= 65_535:
        raise argparse.ArgumentTypeError(f'{number}; allowed: 0 to 65535')
    return number


def _seed(text: str) -> int:
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f'{number}; allowed: an integer >= 0')
    return number


def _delay(text: str) -> float:
    number = float(text)
    if not 0.0 <= number <= 10.0:
        raise argparse.ArgumentTypeError(f'{number}; allowed: 0 to 10')
    return number


if __name__ == '__main__':
    sys.exit(main())
