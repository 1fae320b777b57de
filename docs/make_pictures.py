# SPDX-License-Identifier: Apache-2.0
"""The pictures of the tutorial: what a user sees, taken from the running project.

python docs/make_pictures.py [plan] [twin] [report] [view]     default: all

Needs chromium, and matplotlib (benchmarks/requirements.txt). `view` runs a station in real time:
leave the machine alone meanwhile.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.plan import Plan
from microhand_planner.core.plan_file import read_plan
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.core.pose import Pose
from microhand_station.client import StationClient, StationError

DOCS = Path(__file__).parent
PICTURES = DOCS / 'tutorial' / 'pictures'
EXAMPLE = DOCS.parent / 'examples' / 'reorientation.mcap'
COLOURS = ('#1f6fc4', '#e07b1a', '#2f9e44')  # of fingers 1, 2, 3, as everywhere
MICROHAND = str(Path(sys.executable).with_name('microhand'))
ANGLES = ('--euler-zyz', '80', '220', '100')
VIEW_STEP = 3
"""The picture of the live view is taken when this step is done."""


def save(picture: Image.Image, name: str, width: int) -> None:
    """Write a picture, scaled and with few colours: small files."""
    height = round(picture.height * width / picture.width)
    small = picture.convert('RGB').resize((width, height), Image.Resampling.LANCZOS)
    few = small.quantize(256, dither=Image.Dither.FLOYDSTEINBERG)
    few.save(PICTURES / f'{name}.png', optimize=True)


def planned() -> Plan:
    """Return the plan of the tutorial."""
    goal = Pose.of((0, 0, 0), Rotation.from_euler('ZYZ', [80, 220, 100], degrees=True))
    part, finger = find_part('ellipsoid'), Finger(clearance_um=0.5)
    return plan_reorientation(part, Pose(), goal, finger, ContactLaw(), SearchOptions())


def plan_picture() -> None:
    """Object at the start, tips where they first hold it, and the ways of the tips."""
    import matplotlib

    matplotlib.use('agg')
    import matplotlib.pyplot as plt
    from matplotlib.colors import LightSource
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    plan, part = planned(), find_part('ellipsoid')
    figure = plt.figure(figsize=(9, 6), dpi=160)
    axes: Any = figure.add_axes((-0.2, -0.32, 1.4, 1.64), projection='3d')
    light = LightSource(azdeg=225, altdeg=50)
    axes.add_collection3d(
        Poly3DCollection(
            part.vertices_um[part.faces],
            facecolors='#cfc3a3',
            edgecolors='#cfc3a3',
            linewidths=0.3,
            shade=True,
            lightsource=light,
        )
    )
    start = next(step for step in plan.steps if any(step.in_contact))
    for finger, colour in enumerate(COLOURS):
        way = np.concatenate([step.tip_um[:, finger] for step in plan.steps])
        axes.plot(*way.T, color=colour, lw=1.6, label=f'finger {finger + 1}')
        axes.plot_surface(
            *_sphere(start.tip_um[0, finger], plan.finger.radius_um),
            color=colour,
            lightsource=light,
            linewidth=0,
            antialiased=False,
            rcount=97,
            ccount=97,
        )
    reach_um = 34.0
    axes.set(xlim=(-reach_um, reach_um), ylim=(-reach_um, reach_um), zlim=(-reach_um, reach_um))
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=28, azim=-62)
    axes.set_axis_off()
    _axes_and_scale(axes, reach_um)
    figure.legend(loc='upper left', frameon=False, bbox_to_anchor=(0.04, 0.95), fontsize=12)
    figure.canvas.draw()
    save(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())), 'plan', 900)
    plt.close(figure)


def _sphere(centre_um: np.ndarray, radius_um: float) -> list[np.ndarray]:
    """Return the surface of a tip as grids x, y, z."""
    around, up = np.meshgrid(np.linspace(0, 2 * np.pi, 97), np.linspace(np.pi, 0, 49))
    unit = (np.cos(around) * np.sin(up), np.sin(around) * np.sin(up), np.cos(up))
    return [c + radius_um * u for c, u in zip(centre_um, unit, strict=True)]


def _axes_and_scale(axes: Any, reach_um: float) -> None:
    """Draw the frame of the station in a corner, 10 µm long."""
    corner = np.array([-reach_um, -reach_um, -0.8 * reach_um])
    for direction, name in zip(np.eye(3), 'XYZ', strict=True):
        axes.plot(*np.array([corner, corner + 10 * direction]).T, color='#555555', lw=1.2)
        axes.text(*(corner + 12.5 * direction), name, color='#555555', ha='center', va='center')
    axes.text(
        *(corner + np.array([5, -7, -1])), '10 µm', color='#555555', ha='center', va='center'
    )


def twin_picture() -> None:
    """How the run of the tutorial ends in the physics engine."""
    with tempfile.TemporaryDirectory() as folder:
        file, picture = f'{folder}/turn.json', f'{folder}/end.png'
        for command in (
            (MICROHAND, 'plan', 'ellipsoid', *ANGLES, '-o', file),
            (MICROHAND, 'verify', file, '--picture', picture),
        ):
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        save(Image.open(picture), 'twin', 800)


@contextmanager
def browser(width: int, height: int) -> Iterator[Any]:
    """Give a page of a browser without a window, which draws in space by software."""
    from playwright.sync_api import sync_playwright

    options = ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader']
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=shutil.which('chromium'), args=options)
        yield opened.new_page(viewport={'width': width, 'height': height})
        opened.close()


def _screenshot(page: Any, name: str, width: int) -> None:
    with tempfile.NamedTemporaryFile(suffix='.png') as file:
        page.screenshot(path=file.name)
        save(Image.open(file.name), name, width)


def report_picture() -> None:
    """Open the report of the shipped run, in the middle of it."""
    with tempfile.TemporaryDirectory() as folder, browser(1360, 1000) as page:
        file = f'{folder}/report.html'
        command = (MICROHAND, 'analyze', str(EXAMPLE), '-o', file)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        page.goto(f'file://{file}')
        page.wait_for_timeout(4000)
        slider = page.locator('input[type=range]').first
        slider.evaluate(
            's => { s.value = 0.45 * s.max; s.dispatchEvent(new Event("input", {bubbles: true})) }'
        )
        page.wait_for_timeout(4000)
        _screenshot(page, 'report', 1100)


def view_picture() -> None:
    """Look at the live view in the middle of the plan of the tutorial."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'turn.json'
        subprocess.run(
            (MICROHAND, 'plan', 'ellipsoid', *ANGLES, '-o', str(file)),
            check=True,
            stdout=subprocess.DEVNULL,
        )
        station = subprocess.Popen(
            (MICROHAND, 'station', '--view', '--view-port', '0', '--run-dir', folder),
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            url = _address(station)
            with StationClient() as client:
                _pause_in_the_middle(client, read_plan(file))
                with browser(1280, 780) as page:
                    page.goto(url)
                    page.get_by_role('button', name='Plan', exact=True).wait_for()
                    page.wait_for_timeout(6000)
                    page.locator('.mantine-Notification-closeButton').first.click(timeout=9000)
                    page.mouse.move(640, 390)
                    for _ in range(6):
                        page.mouse.wheel(0, -100)
                        page.wait_for_timeout(200)
                    page.wait_for_timeout(4000)
                    _screenshot(page, 'view', 1100)
        finally:
            station.send_signal(signal.SIGINT)
            station.wait(30)


def _address(station: subprocess.Popen[str]) -> str:
    """Return the address of the page, when the station is ready."""
    ready, url = False, ''
    for line in station.stdout or ():
        ready = ready or 'station ready' in line
        url = line.removeprefix('view: ').strip() if line.startswith('view: ') else url
        if ready and url:
            return url
    raise RuntimeError('the station ended')


def _pause_in_the_middle(client: StationClient, plan: Plan) -> None:
    """Begin to execute a plan and let it stand: a browser without a GPU needs the machine."""
    there = threading.Event()

    def follow(progress: Any) -> None:
        if progress.step >= VIEW_STEP:
            there.set()

    def execute() -> None:
        with suppress(StationError):  # it is ended in the middle
            client.execute(plan, 'shown', follow, object_name='ellipsoid')

    threading.Thread(target=execute, daemon=True).start()
    if not there.wait(60):
        raise RuntimeError('the run failed; was the machine busy?')
    client.command('pause')
    time.sleep(5)


MAKERS: dict[str, Callable[[], None]] = {
    'plan': plan_picture,
    'twin': twin_picture,
    'report': report_picture,
    'view': view_picture,
}


def main(names: list[str]) -> None:
    """Make pictures, and say how large they are."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in names or MAKERS:
        MAKERS[name]()
        print(f'{name}.png {(PICTURES / f"{name}.png").stat().st_size // 1000} kB')


if __name__ == '__main__':
    main(sys.argv[1:])
