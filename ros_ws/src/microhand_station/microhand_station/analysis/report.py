# SPDX-License-Identifier: Apache-2.0
"""A recorded run → one HTML page that needs nothing else, neither a network nor a server."""

from __future__ import annotations

from html import escape
from importlib.resources import files
from pathlib import Path

from microhand_planner.core.errors import BadRequest
from microhand_station.analysis.findings import Findings, findings
from microhand_station.analysis.report_data import report_data
from microhand_station.analysis.report_origin import origin
from microhand_station.analysis.report_text import (
    cards,
    comparison,
    events_table,
    heading,
    notices,
    steps_table,
)
from microhand_station.analysis.run import Run

# In the order in which they use each other.
_SCRIPTS = ('unpack.js', 'player.js', 'scene.js', 'plots.js', 'page.js')
# Nothing is fetched, whatever the texts of a record hold.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def write_report(
    run: Run, path: str | Path, *, compare: Run | None = None, found: Findings | None = None
) -> None:
    """Write the report of a run: what was asked and planned, did it hold, where was it worst.

    Parameters
    ----------
    run : Run
        The record.
    path : path
        Of the page; an existing one is replaced.
    compare : Run or None
        Another run, to be set beside it.
    found : Findings or None
        Of the run, if they have been worked out already.

    Raises
    ------
    BadRequest
        The page cannot be written there.
    """
    page = _page(run, findings(run) if found is None else found, compare)
    try:
        Path(path).write_text(page, encoding='utf-8')
    except OSError as error:
        raise BadRequest(
            'report', path, f'a file that can be written ({error.strerror})'
        ) from error


def _page(run: Run, found: Findings, other: Run | None) -> str:
    data = report_data(run, found, other)
    scripts = '\n'.join(_asset(name) for name in _SCRIPTS)
    title = escape(f'Run {run.name}')
    beside = '' if other is None else comparison(run, found, other, findings(other))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width,initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{_asset('uPlot.css')}{_asset('page.css')}</style>
</head>
<body>
<header>{heading(run, found)}{notices(run)}</header>
<main>
{cards(run, found)}
{_asset('stage.html')}
{beside}
<section><h2>Step by step</h2>
<p class="dim">A click on a step shows it above. Grip: smallest and largest of the pair that holds;
“to the edge”: how far it stayed inside of the window that keeps the reserve of the plan.</p>
{steps_table(found, run.plan)}</section>
<section><h2>Events</h2>
{events_table(run)}</section>
</main>
<footer>{origin(run)}
<details><summary>Licences of what draws this page</summary><pre>{escape(_asset('LICENSES'))}</pre>
</details></footer>
<script type="application/json" id="data">{data}</script>
<script>{_asset('libraries.js')}</script>
<script>'use strict';
(() => {{
{scripts}
}})();</script>
</body>
</html>
"""


def _asset(name: str) -> str:
    """Return a file of the folder ``page``."""
    page = files('microhand_station.analysis') / 'page'
    return (page / name).read_text(encoding='utf-8')
