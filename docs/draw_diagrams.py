# SPDX-License-Identifier: Apache-2.0
"""Block diagrams of the documentation, as SVG: readable without a network, on any host.

python docs/draw_diagrams.py     needs matplotlib, see benchmarks/requirements.txt
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use('svg')
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

DOCS = Path(__file__).parent
LINE, FILL, LOOP = '#31688e', '#eaf1f5', '#c8553d'
WIDTH, HEIGHT, GAP = 1.0, 0.5, 0.34
STYLE = {'svg.hashsalt': 'microhand', 'svg.fonttype': 'none', 'font.size': 9.0}


def block(axes: Axes, column: float, row: float, text: str, *, plain: bool = False) -> None:
    """Draw a box, or only its text, at a place of the grid."""
    middle = column * (WIDTH + GAP), -row * (HEIGHT + 2 * GAP)
    if not plain:
        corner = middle[0] - WIDTH / 2, middle[1] - HEIGHT / 2
        box = plt.Rectangle(corner, WIDTH, HEIGHT, fc=FILL, ec=LINE, lw=1.2)
        axes.add_patch(box)
    axes.text(*middle, text, ha='center', va='center')


def arrow(axes: Axes, points: Sequence[tuple[float, float]], colour: str) -> None:
    """Draw a line with a head at its end."""
    axes.plot(*zip(*points, strict=True), color=colour, lw=1.2, solid_joinstyle='miter')
    style = {'arrowstyle': '-|>', 'color': colour, 'lw': 1.2, 'shrinkA': 0, 'shrinkB': 0}
    axes.annotate('', points[-1], points[-2], arrowprops=style)


def chain(axes: Axes, names: Sequence[str], row: float, first: float = 0.0) -> None:
    """Draw blocks from left to right; what stands between `<` and `>` is a signal, not a part."""
    for number, name in enumerate(names):
        plain = name.startswith('<')
        block(axes, first + number, row, name.strip('<>'), plain=plain)
        if number:
            right = (first + number) * (WIDTH + GAP) - WIDTH / 2
            height = -row * (HEIGHT + 2 * GAP)
            arrow(axes, [(right - GAP, height), (right, height)], LINE)


def stage_model() -> None:
    """From the command of a stage to its position, and back to its servo."""
    figure, axes = plt.subplots(figsize=(10.2, 1.75))
    names = ('<command>', 'slew limit', 'servo', 'amplifier', 'hysteresis', 'creep', 'mechanics')
    chain(axes, (*names, '<position>'), 0)
    below = -(HEIGHT + 2 * GAP)
    for column, text in ((5, 'quantisation'), (6, 'noise')):
        block(axes, column, 1, text)
    pitch = WIDTH + GAP
    down = [(7 * pitch, -HEIGHT / 2), (7 * pitch, below), (6 * pitch + WIDTH / 2, below)]
    arrow(axes, down, LOOP)
    arrow(axes, [(6 * pitch - WIDTH / 2, below), (5 * pitch + WIDTH / 2, below)], LOOP)
    back = [(5 * pitch - WIDTH / 2, below), (2 * pitch, below), (2 * pitch, -HEIGHT / 2)]
    arrow(axes, back, LOOP)
    axes.text(3.2 * pitch, below + 0.07, 'reading', ha='center', va='bottom', color=LOOP)
    axes.set(xlim=(-0.55, 7 * pitch + 0.55), ylim=(below - 0.32, HEIGHT / 2 + 0.07))
    axes.set_aspect('equal')
    axes.axis('off')
    figure.subplots_adjust(0, 0, 1, 1)
    figure.savefig(DOCS / 'explanation/figures/stage_model.svg', metadata={'Date': None})


def main() -> None:
    """Draw all diagrams."""
    with plt.rc_context(STYLE):
        stage_model()


if __name__ == '__main__':
    main()
