# SPDX-License-Identifier: Apache-2.0
"""`microhand reproduce` and `microhand bench`: rows for programs, tables for people."""

import json
from collections.abc import Callable, Iterator

import pytest

from microhand_planner.core.part import Part
from microhand_planner.evaluation.speed import BenchRow, Timing
from microhand_station.cli import bench as bench_module
from microhand_station.cli.app import main


def test_table_3_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    """One JSON object with the paper's figures beside ours on stdout, nothing on stderr."""
    assert main(['reproduce', 'table3', '--json']) == 0
    out, err = capsys.readouterr()
    answer = json.loads(out)
    assert (answer['status'], answer['error'], answer['table']) == ('ok', None, 'table3')
    assert len(answer['rows']) == 6
    assert min(row['cost_deg'] for row in answer['rows']) == 1880.0
    assert {row['paper_cost_deg'] for row in answer['rows']} == {1880.0, 2240.0, 2600.0}
    assert err == ''


def test_table_4_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    """A table that fits 80 columns, each figure with the paper's in brackets."""
    assert main(['reproduce', 'table4']) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    assert '8 (8)' in out
    assert 'NPA (NPA)' in out
    assert '(12474)' in out, "the paper's nodes to be visited"


def test_unknown_table(capsys: pytest.CaptureFixture[str]) -> None:
    """A table that is not there is a bad request that says which there are."""
    assert main(['reproduce', 'table9']) == 2
    assert "'table2', 'table3', 'table4'" in capsys.readouterr().err


def test_bench_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each row says what was measured, how often, the times, and the ratio to the paper."""

    def one_row(find_part: Callable[[str], Part]) -> Iterator[BenchRow]:
        yield BenchRow('plan', 'convex', 20.0, Timing(5, 0.01, 0.005, 0.02), 5.35)

    monkeypatch.setattr(bench_module, 'measured', one_row)
    assert main(['bench', '--json']) == 0
    (row,) = json.loads(capsys.readouterr().out)['rows']
    assert row == {
        'case': 'plan',
        'object': 'convex',
        'step_deg': 20.0,
        'runs': 5,
        'median_s': 0.01,
        'fastest_s': 0.005,
        'slowest_s': 0.02,
        'paper_s': 5.35,
        'times_faster': 535.0,
    }
