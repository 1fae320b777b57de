# SPDX-License-Identifier: Apache-2.0
"""What is shipped to learn from works: the run, and the notebook that reads it."""

import json
import shutil
from pathlib import Path

import pytest

from microhand_planner.core.plan import StepKind
from microhand_station.analysis.findings import findings
from microhand_station.analysis.run import Run

EXAMPLES = Path(__file__).parents[2] / 'examples'


@pytest.fixture(scope='module')
def run():
    """Return the shipped run."""
    return Run.open(EXAMPLES / 'reorientation.mcap')


def test_the_shipped_run_is_a_good_one(run):
    """Whole, executed to its end, held, and close to its goal; nothing is missing."""
    found = findings(run)
    assert (run.finished, run.missing, run.undecodable) == (True, (), 0)
    assert (found.complete, found.held) == (True, True)
    assert found.final_error_deg < 0.1
    assert found.underruns == found.missing_setpoints == 0


def test_commands_and_sequencer_agree_on_the_error_of_the_object(run):
    """Two ways to where the plan has the object: by the clock, and by the commands alone.

    They agree while it rests; while it rolls, up to what it turns in the 10 ms between two states.
    """
    import numpy as np

    from microhand_station.analysis.run_progress import from_commands

    afterwards = from_commands(run.progress, run.object)
    live = run.deviation
    apart_deg = np.abs(
        np.interp(live.time_s, afterwards.time_s, afterwards.angle_deg) - live.angle_deg
    )
    rolls = np.zeros(len(live.time_s), dtype=bool)
    for number, step in enumerate(run.plan.steps):
        if step.kind is StepKind.ROLL:
            begin_s, end_s = run.progress.span_s(number)
            rolls |= (live.time_s >= begin_s) & (live.time_s <= end_s)
    assert 0.2 < rolls.mean() < 0.8
    assert np.median(apart_deg[~rolls]) < 1e-3
    assert np.median(apart_deg[rolls]) < 0.05
    assert apart_deg.max() < 0.15


def test_the_notebook_runs(tmp_path, monkeypatch, capsys):
    """All of its cells, in order, in one namespace, beside the run; it ends with a page."""
    shutil.copy(EXAMPLES / 'reorientation.mcap', tmp_path)
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((EXAMPLES / 'look_at_a_run.ipynb').read_text(encoding='utf-8'))
    names: dict[str, object] = {}
    for cell in notebook['cells']:
        if cell['cell_type'] == 'code':
            exec(compile(''.join(cell['source']), cell['id'], 'exec'), names)
    printed = capsys.readouterr().out
    assert 'held: True' in printed
    assert '14 roll' in printed
    assert (tmp_path / 'report.html').stat().st_size > 500_000


def test_the_notebook_is_shipped_without_results():
    """Outputs would grow stale, and name the machine that made them."""
    notebook = json.loads((EXAMPLES / 'look_at_a_run.ipynb').read_text(encoding='utf-8'))
    for cell in notebook['cells']:
        assert not cell.get('outputs')
