# SPDX-License-Identifier: Apache-2.0
"""Write docs/reference/benchmarks.md from the results, and draw the figures.

python benchmarks/publish.py
"""

from __future__ import annotations

import json
from pathlib import Path

import draw_figures
from record import RESULTS

PAGE = Path(__file__).parent.parent / 'docs' / 'reference' / 'benchmarks.md'
Rows = list[dict]


def results(name: str) -> dict:
    """Read the results of a benchmark."""
    return json.loads((RESULTS / f'{name}.json').read_text(encoding='utf-8'))


def milliseconds(time_s: float) -> str:
    """Return a time for people: three digits, in the unit that suits it."""
    return f'{1e3 * time_s:.3g} ms' if time_s < 1.0 else f'{time_s:.3g} s'


def table(heads: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table; all columns but the first are right-aligned."""
    rule = ['---'] + ['---:'] * (len(heads) - 1)
    return '\n'.join('| ' + ' | '.join(cells) + ' |' for cells in [heads, rule, *rows])


def where(content: dict) -> str:
    """Return where and when a benchmark ran, in one line."""
    machine = content['machine']
    packages = ', '.join(f'{name} {number}' for name, number in machine['packages'].items())
    return (
        f'`{content["command"]}`, {content["date"]}, {machine["processor"]}, {machine["cores"]} '
        f'cores, load before {machine["load_before"]:g}; Python {machine["python"]}, {packages}.'
    )


def plans(rows: Rows) -> str:
    """Return the table of whole plans."""
    lines = []
    for row in rows:
        paper_s, faster = row['paper_s'], row['times_faster']
        lines.append(
            [
                f'{row["case"]}, {row["object_name"]}',
                f'{row["step_deg"]:g}°',
                *(milliseconds(row[key]) for key in ('median_s', 'fastest_s', 'slowest_s')),
                '' if paper_s is None else f'{paper_s:.3g} s ({faster:.0f})',
            ]
        )
    return table(['case', 'Δθ', 'median', 'fastest', 'slowest', 'paper (ratio)'], lines)


def libraries(rows: Rows) -> str:
    """Return the table of graph libraries."""
    lines = []
    for row in rows:
        if 'error' in row:
            parts = [str(row['error'])] + [''] * 5
        elif 'nodes' in row:
            parts = [
                f'{row["nodes"] / 1e6:.2f} M',
                milliseconds(row['curve_s'] + row['arrays_s'] + row['structure_s']),
                milliseconds(row['search_s']),
                f'{row["peak_memory_gb"]:.1f} GB',
                f'{row["times_slower"]:.0f}',
                f'{row["times_slower_curve_given"]:.0f}',
            ]
        else:
            curve, search = (
                milliseconds(time_s)
                for time_s in (row['total_s'] - row['search_s'], row['search_s'])
            )
            parts = ['none built', curve, search, '', '1', '1']
        lines.append([f'{row["query"]}: {row["peer"]}', *parts])
    heads = [
        'query: peer', 'nodes', 'build', 'search', 'peak memory',
        'times slower in all', 'with the curve given',
    ]  # fmt: skip
    return table(heads, lines)


def growth(rows: Rows) -> str:
    """Return the table of growth."""
    lines = [
        [
            f'{row["object"]}' + (f' × {row["scale"]:g}' if row['what'] == 'size' else ''),
            f'{row["step_deg"]:g}°',
            str(row['contacts_l1']),
            milliseconds(row['median_s']),
            f'{row["peak_memory_mb"]:.0f} MB',
        ]
        for row in rows
    ]
    return table(['object', 'Δθ', 'contacts on L1', 'median', 'peak memory'], lines)


def cold(rows: Rows) -> str:
    """Return the table of new processes."""
    lines = [
        [row['command'], *(milliseconds(row[key]) for key in ('median_s', 'fastest_s'))]
        for row in rows
    ]
    return table(['process', 'median', 'fastest'], lines)


def main() -> None:
    """Write the page."""
    content = {
        name: results(name) for name in ('plans', 'graph_libraries', 'growth', 'cold_start')
    }
    tables = {
        'PLANS': plans, 'LIBRARIES': libraries, 'GROWTH': growth, 'COLD': cold,
    }  # fmt: skip
    text = (Path(__file__).parent / 'page.md').read_text(encoding='utf-8')
    for (mark, make), result in zip(tables.items(), content.values(), strict=True):
        text = text.replace(f'{{{mark}}}', f'{where(result)}\n\n{make(result["rows"])}')
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(text, encoding='utf-8')
    draw_figures.main()
    print(PAGE)


if __name__ == '__main__':
    main()
