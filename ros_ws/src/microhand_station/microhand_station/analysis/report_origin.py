# SPDX-License-Identifier: Apache-2.0
"""A run → where its figures come from, as HTML: file, versions, the request, all parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping
from html import escape
from typing import Any

from microhand_station.analysis.run import Run


def origin(run: Run) -> str:
    """Return what folds out at the foot of the report's page."""
    told = {
        'record': str(run.path),
        'plan': run.metadata.get('plan_hash', ''),
        'microhand': run.metadata.get('microhand_station', ''),
        'recorded on Python': run.metadata.get('python', ''),
        'messages': f'{sum(run.counts.values())} in {len(run.counts)} topics',
    }
    parts = [_details('About this record', _pairs(told))]
    if run.versions:
        parts.append(_details('Versions', _pairs(run.versions)))
    if run.note.request:
        parts.append(_details('The request, as it was sent (SI units)', _json(run.note.request)))
    if run.parameters:
        nodes = ''.join(
            f'<h3>{escape(node)}</h3>{_json(values)}' for node, values in run.parameters.items()
        )
        parts.append(_details(f'Parameters of {len(run.parameters)} nodes', nodes))
    return ''.join(parts)


def _details(summary: str, content: str) -> str:
    return f'<details><summary>{escape(summary)}</summary>{content}</details>'


def _pairs(pairs: Mapping[str, str]) -> str:
    rows = (
        f'<dt>{escape(name)}</dt><dd>{escape(value)}</dd>'
        for name, value in pairs.items()
        if value
    )
    return f'<dl>{"".join(rows)}</dl>'


def _json(values: Mapping[str, Any]) -> str:
    return f'<pre>{escape(json.dumps(values, indent=1, ensure_ascii=False))}</pre>'
