# SPDX-License-Identifier: Apache-2.0
"""Write docs/reference/streaming.md from streaming_page.md and benchmarks/results/streaming.json.

python benchmarks/streaming_page.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from record import RESULTS

PAGE = Path(__file__).parent.parent / 'docs' / 'reference' / 'streaming.md'


def spread(row: dict[str, Any], key: str) -> str:
    """Return median, 99 % and largest for people."""
    if key not in row:
        return '–'
    return ' / '.join(f'{value:.0f}' if value >= 100.0 else f'{value:.3g}' for value in row[key])


def line(row: dict[str, Any]) -> list[str]:
    """Return the column of one measurement."""
    cpu = row['cpu_percent']
    drivers = [share for name, share in cpu.items() if name != 'sender']
    return [
        f'{row["way"].partition(":")[0]}, {row["rate_hz"]:g} Hz',
        f'{row["setpoints"]}',
        f'{row["lost"]}',
        f'{row["reordered"]}',
        f'{row.get("underruns", "–")}',
        spread(row, 'tracking_nm'),
        spread(row, 'tracking_served_nm'),
        spread(row, 'skew_ms'),
        spread(row, 'skew_served_ms'),
        f'{row["skew_over_1ms_percent"]:g}',
        spread(row, 'latency_ms'),
        spread(row, 'machine_late_ms'),
        f'{row["machine_away"]}',
        f'{100.0 - row["served_percent"]:.2f}',
        f'{row.get("sent_hz", "–")}',
        f'{cpu["sender"]:g}',
        ', '.join(f'{share:g}' for share in drivers),
    ]


HEADS = [
    '', 'setpoints', 'lost', 'reordered', 'underruns', 'tracking [nm]', '… while served',
    'skew [ms]', '… while served', 'skew over 1 ms [% of the time]', 'latency [ms]',
    'machine late [ms]', 'machine away', 'not served [% of the time]',
    'rate reached [Hz]', 'processor, sender [%]', 'processor, each finger [%]',
]  # fmt: skip


def write() -> Path:
    """Write the page and return where it is."""
    content = json.loads((RESULTS / 'streaming.json').read_text(encoding='utf-8'))
    rows, machine = content['rows'], content['machine']
    columns = [HEADS, *map(line, rows)]
    lines = ['| ' + ' | '.join(cells) + ' |' for cells in zip(*columns, strict=True)]
    lines.insert(1, '| --- |' + ' ---: |' * len(rows))
    template = Path(__file__).with_suffix('.md').read_text(encoding='utf-8')
    text = template.format(
        seconds=rows[0]['seconds'],
        table='\n'.join(lines),
        limit=next(row['model_limit_nm'] for row in rows if 'model_limit_nm' in row),
        command=content['command'],
        date=content['date'],
        loads=', '.join(f'{row["load_before"]:g}' for row in rows),
        nice=rows[0]['nice'],
        processor=machine['processor'],
        cores=machine['cores'],
        python=machine['python'],
    )
    PAGE.write_text(text, encoding='utf-8')
    return PAGE


if __name__ == '__main__':
    print(write())
