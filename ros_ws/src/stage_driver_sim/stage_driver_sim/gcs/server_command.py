# SPDX-License-Identifier: Apache-2.0
"""The command ``gcs_server``: a simulated GCS controller in a process of its own."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from collections.abc import Callable, Sequence
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
    add('--port', type=_within(int, 0, 65_535), default=PORT, help='0: any that is free')
    add('--preset', choices=list(PRESETS), default=next(iter(PRESETS)), help='the stage')
    add(
        '--travel-um',
        type=_within(float, -1e5, 1e5),
        nargs=2,
        default=[0.0, 200.0],
        metavar=('LOW', 'HIGH'),
        help='of all axes',
    )
    add(
        '--home-um',
        type=_within(float, -1e5, 1e5),
        nargs=3,
        metavar=('X', 'Y', 'Z'),
        help='where it powers up; default: the middle',
    )
    add('--seed', type=_within(int, 0, 2**31 - 1), default=0, help='of the sensor noise')
    add('--fault', choices=[fault.value for fault in Fault], default='none', help='at first')
    add(
        '--answer-delay-s',
        type=_within(float, 0, 10),
        default=0.0,
        help='how long each reply is held back',
    )
    return parser


def _within(kind: type[int] | type[float], low: float, high: float) -> Callable[[str], float]:
    """Return what reads a number of a kind, and refuses those out of range."""
    what = 'an integer' if kind is int else 'a number'

    def read(text: str) -> float:
        try:
            number = kind(text)
        except ValueError:
            number = math.nan
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(f'{text!r}; allowed: {what}, {low:g} to {high:g}')
        return number

    return read


if __name__ == '__main__':
    sys.exit(main())
