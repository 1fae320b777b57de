# SPDX-License-Identifier: Apache-2.0
"""The command ``gcs_server``: what it refuses, and that it speaks with anybody who connects."""

from __future__ import annotations

import socket

import pytest

from stage_driver_sim.gcs.server_command import main
from tests.stage.gcs_bench import DEADLINE_S, ServerProcess, running_server


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (['--port=70000'], "argument --port: '70000'; allowed: an integer, 0 to 65535"),
        (['--port=x'], "argument --port: 'x'; allowed: an integer"),
        (['--answer-delay-s=nan'], "argument --answer-delay-s: 'nan'; allowed: a number, 0 to 10"),
        (['--travel-um', '0', 'inf'], "argument --travel-um: 'inf'; allowed: a number"),
        (['--fault=broken'], "argument --fault: invalid choice: 'broken'"),
        (['--preset=best'], 'representative_100_um_xyz'),
    ],
)
def test_wrong_arguments_are_refused_by_name(
    capsys: pytest.CaptureFixture[str], arguments: list[str], text: str
) -> None:
    """Status 2, and the argument with what is allowed on stderr."""
    with pytest.raises(SystemExit) as refusal:
        main(arguments)
    assert refusal.value.code == 2
    assert text in capsys.readouterr().err


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (['--port=0', '--travel-um', '10', '10'], 'travel is 10.0 to 10.0 µm; allowed: lower <'),
        (['--port=0', '--home-um', '1', '2', '300'], 'z: home is 300 µm; allowed: 0 to 200 µm'),
        (['--port=0', '--host=no.such.host.invalid'], 'gcs_server: '),
    ],
)
def test_impossible_stages_and_places_are_refused(
    capsys: pytest.CaptureFixture[str], arguments: list[str], text: str
) -> None:
    """Status 2, and one line that says why."""
    assert main(arguments) == 2
    complaints = capsys.readouterr().err
    assert text in complaints
    assert len(complaints.splitlines()) == 1


def test_a_port_in_use_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """Two servers cannot listen at one place: status 2, and one line."""
    with running_server() as server:
        assert main([f'--port={server.port}']) == 2
    assert 'in use' in capsys.readouterr().err


def test_two_clients_speak_with_one_controller() -> None:
    """What one commands, the other sees; both in the same words as with a terminal."""
    server = ServerProcess('--travel-um', '0', '100', '--seed', '1')
    try:
        with (
            socket.create_connection(('127.0.0.1', server.port), timeout=DEADLINE_S) as first,
            socket.create_connection(('127.0.0.1', server.port), timeout=DEADLINE_S) as second,
            first.makefile() as answers,
            second.makefile() as others,
        ):
            first.sendall(b'SVO 1 1 2 1 3 1\nMOV 2 61.5\nERR?\n')
            assert answers.readline() == '0\n'
            second.sendall(b'mov? 2\n')
            assert others.readline() == '2=61.500000\n'
    finally:
        server.close()
