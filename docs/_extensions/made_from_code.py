# SPDX-License-Identifier: Apache-2.0
"""Directives for the reference: each puts Markdown into a page that the code has just said."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import command_help
import config_tables
import interface_tables
import node_tables
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

MAKERS: dict[str, Callable[[], str]] = {
    'made-command-line': command_help.command_line,
    'made-interfaces': interface_tables.interfaces,
    'made-error-codes': interface_tables.error_codes,
    'made-nodes': node_tables.nodes,
    'made-station-file': config_tables.station_file,
    'made-plan-file': config_tables.plan_file,
}


def _directive(make: Callable[[], str]) -> type[SphinxDirective]:
    """Return a directive without content or options."""

    class Made(SphinxDirective):
        def run(self) -> list[nodes.Node]:
            return self.parse_text_to_nodes(make(), allow_section_headings=True)

    return Made


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the directives."""
    for name, make in MAKERS.items():
        app.add_directive(name, _directive(make))
    return {'parallel_read_safe': True}
