# SPDX-License-Identifier: Apache-2.0
"""What the simulated GCS controller answers, line by line, as the manual has it."""

from __future__ import annotations

import numpy as np
import pytest

from stage_driver_sim.errors import InvalidParameter, StageFailed, StageSilent
from stage_driver_sim.faults import Fault, FaultSettings
from stage_driver_sim.gcs.gcs_stage import GcsStage
from stage_driver_sim.gcs.simulated_controller import SimulatedController
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.protocol import StageLimits
from stage_driver_sim.simulated_stage import SimulatedStage

MIDDLE_UM = np.full(3, 50.0)


class Dialogue:
    """Speaks with a controller whose stage stands at (50, 50, 50) µm; the test turns the clock."""

    def __init__(self) -> None:
        self.stage = SimulatedStage(
            REPRESENTATIVE_100_UM_XYZ, home_um=MIDDLE_UM, rng=np.random.default_rng(3), now_s=0.0
        )
        self.controller = SimulatedController(self.stage)
        self.now_s = 0.0

    def say(self, command: str) -> str:
        """Return what the controller replies."""
        return self.controller.handle(command, self.now_s).decode('latin-1')

    def positions_um(self) -> list[float]:
        """Return what ``POS?`` says."""
        return [float(line.split('=')[1]) for line in self.say('POS?').splitlines()]


@pytest.fixture
def dialogue() -> Dialogue:
    """Return a dialogue with a controller, its servo on."""
    dialogue = Dialogue()
    assert dialogue.say('SVO 1 1 2 1 3 1') == ''
    return dialogue


def test_who_it_is_and_what_it_has(dialogue: Dialogue) -> None:
    """Identity, syntax version, axes and travel; every line but the last ends with SP LF."""
    assert dialogue.say('*IDN?') == 'microhand, simulated, 0, 0.1.0\n'
    assert dialogue.say('CSV?') == '2.0\n'
    assert dialogue.say('SAI?') == '1 \n2 \n3\n'
    assert dialogue.say('TMN?') == '1=0.000000 \n2=0.000000 \n3=0.000000\n'
    assert dialogue.say('TMX? 2') == '2=100.000000\n'
    assert dialogue.say('ERR?') == '0\n'


def test_mnemonics_in_any_case_and_axes_in_any_order(dialogue: Dialogue) -> None:
    """Upper and lower case are the same; a reply has the axes in the order of the query."""
    assert dialogue.say('mov 3 61.5 1 40') == ''
    assert dialogue.say('MoV? 3 1') == '3=61.500000 \n1=40.000000\n'
    assert dialogue.say('  MOV?   2 ').startswith('2=50.')


def test_a_motion_from_command_to_target(dialogue: Dialogue) -> None:
    """On its way ONT? is 0 and #5 has the bit of the axis; later it is there."""
    dialogue.say('MOV 2 60')
    dialogue.now_s = 0.001
    assert dialogue.say('ONT?') == '1=1 \n2=0 \n3=1\n'
    assert dialogue.say('\x05') == '2\n'
    dialogue.now_s = 0.5
    assert dialogue.say('ONT? 2') == '2=1\n'
    assert dialogue.say('\x05') == '0\n'
    np.testing.assert_allclose(dialogue.positions_um(), [50.0, 60.0, 50.0], atol=0.01)
    assert dialogue.say('\x07') == '\xb1\n'


def test_velocity_limits_the_motion(dialogue: Dialogue) -> None:
    """At VEL 100 a way of 10 µm takes a tenth of a second, on that axis alone."""
    dialogue.say('VEL 1 100')
    assert dialogue.say('VEL? 1 2') == '1=100.000000 \n2=3500.000000\n'
    dialogue.say('MOV 1 60 2 60')
    dialogue.now_s = 0.06
    first_um, second_um, _ = dialogue.positions_um()
    assert first_um == pytest.approx(56.0, abs=0.2)
    assert second_um == pytest.approx(60.0, abs=0.05)


@pytest.mark.parametrize('stop', ['\x18', 'STP', 'stp'])
def test_a_stop_makes_the_present_place_the_target(dialogue: Dialogue, stop: str) -> None:
    """After #24 or STP the target is where it stopped, and ERR? is 10, once."""
    dialogue.say('MOV 1 90')
    dialogue.now_s = 0.005
    assert dialogue.say(stop) == ''
    assert dialogue.say('ERR?') == '10\n'
    assert dialogue.say('ERR?') == '0\n'
    target_um = float(dialogue.say('MOV? 1')[2:])
    assert 60.0 < target_um < 80.0
    dialogue.now_s = 1.0
    assert dialogue.positions_um()[0] == pytest.approx(target_um, abs=0.01)


@pytest.mark.parametrize(
    ('command', 'code'),
    [
        ('XYZ 1', 2),
        ('POS', 2),
        ('MOV', 1),
        ('MOV 1', 1),
        ('MOV 1 x', 1),
        ('MOV 1 nan', 1),
        ('MOV 1 60 2', 1),
        ('MOV 4 60', 15),
        ('POS? 9', 15),
        ('MOV 1 60 2 100.1', 7),
        ('MOV 1 -0.1', 7),
        ('VEL 1 0', 8),
        ('VEL 1 3501', 8),
        ('SVO 1 2', 1),
        ('MOV 1 ' + '6' * 300, 3),
        ('FLT nonsense', 1),
    ],
)
def test_what_is_wrong_is_not_done_and_gives_its_code_once(
    dialogue: Dialogue, command: str, code: int
) -> None:
    """No reply; ERR? tells the code and forgets it; no axis of the line moves."""
    assert dialogue.say(command) == ''
    assert dialogue.say('ERR?') == f'{code}\n'
    assert dialogue.say('ERR?') == '0\n'
    dialogue.now_s = 1.0
    np.testing.assert_allclose(dialogue.positions_um(), 50.0, atol=0.01)


def test_without_servo_there_is_no_motion(dialogue: Dialogue) -> None:
    """One servo off refuses motions with code 5; on again, the place is the target."""
    dialogue.say('SVO 2 0')
    assert dialogue.say('SVO?') == '1=1 \n2=0 \n3=1\n'
    dialogue.say('MOV 1 60')
    assert dialogue.say('ERR?') == '5\n'
    dialogue.say('SVO 2 1')
    assert float(dialogue.say('MOV? 1')[2:]) == pytest.approx(50.0, abs=0.01)


def test_faults_are_switched_by_a_command_of_its_own(dialogue: Dialogue) -> None:
    """FLT silent: no query is answered any more, but FLT? and FLT; none: all as before."""
    dialogue.say('FLT silent')
    assert (dialogue.say('POS?'), dialogue.say('*IDN?'), dialogue.say('\x18')) == ('', '', '')
    assert dialogue.say('FLT?') == 'silent\n'
    dialogue.say('FLT none')
    assert dialogue.positions_um() == pytest.approx([50.0] * 3, abs=0.01)
    dialogue.controller.set_fault(FaultSettings(Fault.LIMIT, margin_um=1.0), 0.0)
    dialogue.say('MOV 1 60')
    assert dialogue.say('ERR?') == '7\n'


class Script:
    """A connection whose other end answers from a list, whatever it is asked."""

    def __init__(self, *replies: list[str]) -> None:
        self.replies = list(replies)
        self.closed = False

    def exchange(self, data: bytes, replies: int, now_s: float) -> list[list[str]]:
        """Return the next replies."""
        answer, self.replies = self.replies[:replies], self.replies[replies:]
        return answer

    def close(self) -> None:
        """Remember that it was closed."""
        self.closed = True


def triple(value: str) -> list[str]:
    """Return a reply with the same value for three axes."""
    return [f'{axis}={value}' for axis in '123']


GREETING = [['E-1'], ['2.0'], ['1', '2', '3'], ['0']]
READY = [*GREETING, triple('0.0'), triple('100.0'), triple('1'), ['0']]
LIMITS = StageLimits(np.zeros(3), np.full(3, 100.0), MIDDLE_UM, 3500.0)


def connect(script: Script, axes: str = '123') -> GcsStage:
    """Return the stage behind a script."""
    return GcsStage(script, axes=tuple(axes), limits=LIMITS, now_s=0.0)


@pytest.mark.parametrize(
    ('replies', 'axes', 'error', 'match'),
    [
        ([['E-1'], ['1.0'], ['1'], ['0']], '123', StageSilent, r"CSV\? was answered '1.0'"),
        (GREETING, '12A', InvalidParameter, "gcs_axes is '1 2 A'; allowed: .* has, 1 2 3"),
        (
            [*GREETING, triple('0.0'), triple('90.0')],
            '123',
            InvalidParameter,
            'x: travel is 0 to 100 µm; allowed: within the 0 to 90 µm of the controller',
        ),
        ([*GREETING, triple('low'), triple('90.0')], '123', StageSilent, r'TMN\? was answered'),
        ([*READY[:-1], ['8']], '123', InvalidParameter, 'max_velocity is 3500 µm/s: GCS error 8'),
        ([*READY[:-1], ['?']], '123', StageSilent, r"ERR\? was answered '\?'; allowed: an int"),
    ],
    ids=['version', 'axes', 'travel', 'number', 'velocity', 'error'],
)
def test_a_controller_that_does_not_fit_is_refused_and_let_go(
    replies: list[list[str]], axes: str, error: type[Exception], match: str
) -> None:
    """Another syntax, other axes, less travel, nonsense: named; the connection is closed."""
    script = Script(*replies)
    with pytest.raises(error, match=match):
        connect(script, axes)
    assert script.closed


def test_errors_of_the_controller_reach_the_driver() -> None:
    """A servo that does not switch, and a code that ERR? tells, are failures with their text."""
    script = Script(*READY)
    stage = connect(script)
    script.replies = [['0'], triple('0')]
    with pytest.raises(StageFailed, match='SVO 1 has no effect'):
        stage.set_servo(True, 0.0)
    script.replies = [triple('50.0')] * 9 + [triple('50.0'), ['1024']]
    for _ in range(9):
        stage.measure_um(0.0)
    with pytest.raises(StageFailed, match=r'GCS error 1024 \(see the manual of the controller\)'):
        stage.measure_um(0.0)
