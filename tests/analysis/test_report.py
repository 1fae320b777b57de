# SPDX-License-Identifier: Apache-2.0
"""The report's page, opened in a real browser and clicked through; and what its text says."""

import re
import time
from html.parser import HTMLParser

import numpy as np
import pytest

from microhand_planner.core.catalogue import find_mesh_file
from microhand_planner.core.errors import BadRequest, UnknownObject
from microhand_station.analysis import object_mesh as object_mesh_module
from microhand_station.analysis.object_mesh import ObjectMesh, simplified
from microhand_station.analysis.report import write_report
from microhand_station.analysis.run import Run
from microhand_station.analysis.thinned import thinned
from microhand_station.recording.run_writer import PARAMETERS_METADATA, VERSIONS_METADATA

SIZES = {'desktop': (1440, 900), 'phone': (390, 844)}
MOST_BYTES = 4_000_000
PATIENCE_MS = 100_000


class Texts(HTMLParser):
    """Texts of a page outside of scripts and styles; checks that tags are closed in order."""

    VOID = frozenset({'meta', 'br', 'input', 'path'})

    def __init__(self, page):
        super().__init__()
        self.open, self.texts, self.addresses = [], [], []
        self.feed(page.read_text(encoding='utf-8'))
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        """Note the tag, and what it would fetch."""
        self.addresses += [value for name, value in attrs if name in ('src', 'href')]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        """Check that it closes the tag opened last."""
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        """Note the text."""
        if not {'script', 'style'} & set(self.open):
            self.texts.append(data)


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder for pages."""
    return tmp_path_factory.mktemp('pages')


@pytest.fixture(scope='module')
def page_of_run(record, folder):
    """Return the page of the whole run."""
    write_report(Run.open(record), folder / 'run.html')
    return folder / 'run.html'


@pytest.fixture(scope='module')
def opened(browser):
    """Return a function that opens a page and collects what goes wrong with it."""
    contexts = []

    def open_page(path, size='desktop', scheme='light'):
        width, height = SIZES[size]
        context = browser.new_context(
            viewport={'width': width, 'height': height},
            has_touch=size == 'phone',
            color_scheme=scheme,
        )
        context.set_default_timeout(PATIENCE_MS)
        contexts.append(context)
        page = context.new_page()
        page.troubles, page.fetched = [], []
        page.on('console', lambda message: page.troubles.append(message.text))
        page.on('pageerror', lambda error: page.troubles.append(str(error)))
        page.on('request', lambda request: page.fetched.append(request.url))
        page.goto(path.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()


@pytest.fixture(scope='module')
def pages(opened, page_of_run):
    """Return the page of the whole run on each size of screen: light on one, dark on the other."""
    return {
        'desktop': opened(page_of_run, 'desktop', 'light'),
        'phone': opened(page_of_run, 'phone', 'dark'),
    }


def as_at_first(page):
    """Have a page stand at the beginning, whatever was done with it before."""
    page.evaluate(
        "if (document.querySelector('#play.playing')) document.getElementById('play').click()"
    )
    page.select_option('#speed', '1')
    move_slider(page, 0.0)
    return page


@pytest.fixture(params=SIZES)
def page(pages, request):
    """Return one of the pages, as it was in the beginning; it must not have complained since."""
    page = as_at_first(pages[request.param])
    yield page
    assert page.troubles == []


@pytest.fixture
def desktop(pages):
    """Return the page on a desktop, as it was in the beginning."""
    page = as_at_first(pages['desktop'])
    yield page
    assert page.troubles == []


def move_slider(page, share):
    """Drag the slider to a share of the run, as an input event does."""
    page.evaluate(
        """share => { const slider = document.getElementById('slider');
        slider.value = share * slider.max; slider.dispatchEvent(new Event('input')); }""",
        share,
    )


def wait_until(page, expression):
    """Return when an expression is true in the page; its policy forbids the way of playwright."""
    give_up_s = time.monotonic() + PATIENCE_MS / 1e3
    while not page.evaluate(expression):
        assert time.monotonic() < give_up_s, expression
        page.wait_for_timeout(20)


def picture(page):
    """Return what the scene shows, as text of its pixels."""
    return page.evaluate("document.querySelector('#scene canvas').toDataURL()")


def now_s(page):
    """Return the time that the page shows."""
    return float(page.inner_text('#clock').split()[0])


def duration_s(page):
    """Return how long the run is that the page shows."""
    return float(page.get_attribute('#slider', 'max'))


def test_page_opens_without_a_network_and_fits_the_screen(page, page_of_run):
    """Nothing fetched but the page, nothing wider than the screen, all plots there."""
    assert page.fetched == [page_of_run.as_uri()]
    assert page.locator('.plot canvas').count() == 7
    assert page.evaluate('document.documentElement.scrollWidth') <= page.viewport_size['width']


def test_colours_follow_the_system(pages):
    """Light where the system is light, dark where it is dark."""
    levels = {}
    for size, page in pages.items():
        background = page.evaluate('getComputedStyle(document.body).backgroundColor')
        levels[size] = int(re.search(r'\d+', background).group())
    assert levels['desktop'] > 200
    assert levels['phone'] < 60


def test_slider_moves_scene_plots_and_figures(page):
    """At another time the object has another pose, and each plot's line another place."""
    seen = []
    for share in (0.1, 0.35, 0.9):
        move_slider(page, share)
        line = page.evaluate("document.querySelector('#plot-grip .time-line').style.transform")
        seen.append((picture(page), line, page.inner_text('#clock'), page.inner_text('#step-now')))
    for column in zip(*seen, strict=True):
        assert len(set(column)) == 3


def test_play_runs_and_pauses(page):
    """The button starts the time and stops it; at the end it starts from the beginning."""
    page.select_option('#speed', '4')
    before = picture(page)
    page.click('#play')
    wait_until(page, "parseFloat(document.getElementById('clock').textContent) > 1")
    page.evaluate("document.getElementById('play').click()")
    stopped_s = now_s(page)
    assert page.get_attribute('#play', 'aria-label') == 'Play'
    assert picture(page) != before
    move_slider(page, 0.97)
    page.click('#play')
    wait_until(page, "!document.getElementById('play').classList.contains('playing')")
    assert now_s(page) == pytest.approx(duration_s(page), abs=0.01)
    assert now_s(page) > stopped_s
    page.click('#play')
    wait_until(page, "parseFloat(document.getElementById('clock').textContent) < 9")


def test_scene_is_turned_and_zoomed_with_the_mouse(desktop):
    """Dragging turns, the wheel zooms, the button turns the view back."""
    page = desktop
    page.locator('#scene').scroll_into_view_if_needed()
    first = picture(page)
    box = page.locator('#scene').bounding_box()
    x, y = box['x'] + box['width'] / 2, box['y'] + box['height'] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 120, y + 40, steps=2)
    page.mouse.up()
    turned = picture(page)
    page.mouse.wheel(0, -300)
    assert turned != first
    assert picture(page) not in (first, turned)
    page.click('#reset-view')
    assert picture(page) == first


def test_plots_are_zoomed_together_and_lead_to_their_times(desktop):
    """A drag zooms all plots, a click goes there, the button shows the whole run again."""
    page = desktop
    over = page.locator('#plot-grip .u-over')
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    whole = page.locator('#plot-tracking canvas').evaluate('canvas => canvas.toDataURL()')
    at_y = box['y'] + box['height'] / 2
    page.mouse.click(box['x'] + box['width'] / 2, at_y)
    assert now_s(page) == pytest.approx(duration_s(page) / 2, abs=0.05)
    page.mouse.move(box['x'] + box['width'] * 0.4, at_y)
    page.mouse.down()
    page.mouse.move(box['x'] + box['width'] * 0.6, at_y, steps=3)
    page.mouse.up()
    wait_until(page, "!document.getElementById('whole-run').disabled")
    assert now_s(page) == pytest.approx(duration_s(page) / 2, abs=0.05), 'a drag is no click'
    assert page.locator('#plot-tracking canvas').evaluate('canvas => canvas.toDataURL()') != whole
    page.click('#whole-run')
    wait_until(page, "document.getElementById('whole-run').disabled")


def test_tables_lead_to_moments(page, record):
    """A step is zoomed to and shown from its beginning; the worst moment is one click away."""
    run = Run.open(record)
    page.click('table.steps tbody tr:nth-child(7) button')
    begin_s, _ = run.progress.span_s(6)
    assert now_s(page) == pytest.approx(begin_s, abs=0.006)
    assert not page.is_disabled('#whole-run')
    assert page.inner_text('#step-now').startswith('step 7: remove finger')
    assert page.locator('table.steps tr.current').get_attribute('data-step') == '7'
    page.click('#whole-run')
    page.click('.worst button >> nth=0')
    worst_s = run.deviation.time_s[np.argmax(run.deviation.angle_deg)]
    assert now_s(page) == pytest.approx(worst_s, abs=0.006)


def test_two_runs_are_compared(opened, record, made, folder):
    """The other run is in plots, scene and a table; both begin where their plans begin."""
    lost = Run.open(made.write(folder / 'lost.mcap', lost_at_s=4.0))
    write_report(lost, folder / 'both.html', compare=Run.open(record))
    page = opened(folder / 'both.html')
    assert 'The object was lost after 4.0 s, in step 5' in page.inner_text('h1')
    assert page.inner_text('table.compared tbody tr:nth-child(2) td:nth-child(2)') == 'no'
    assert 'other run' in page.inner_text('#plot-object_error figcaption')
    assert 'object of other run' in page.inner_text('#keys')
    move_slider(page, 0.5)
    assert page.troubles == []


@pytest.mark.parametrize('absent', ['object', '/finger_', '/'])
def test_pages_of_incomplete_runs_open_as_well(opened, made, tmp_path, absent):
    """Without the object, without fingers, without any message: it says so, its slider works."""
    path = tmp_path / 'part.mcap'
    made.write(path, end=None, chosen=lambda name: absent not in name)
    write_report(Run.open(path), tmp_path / 'part.html')
    page = opened(tmp_path / 'part.html')
    assert page.locator('.notices li').count() >= 1
    move_slider(page, 0.6)
    assert page.troubles == []


def test_page_is_one_file_of_sensible_size(page_of_run):
    """Nothing is referred to, and nothing may be; a few megabytes at most."""
    text = page_of_run.read_text(encoding='utf-8')
    assert len(text) < MOST_BYTES
    assert Texts(page_of_run).addresses == []
    assert "default-src 'none'" in text


def test_page_says_what_was_asked_planned_and_found(page_of_run, made):
    """Words and figures of the run; a request with tags in it stays text."""
    texts = [' '.join(text.split()) for text in Texts(page_of_run).texts]
    page = ' '.join(texts)
    for said in (
        'The object was held, and ended',
        'a <b>test</b>',
        'made <up>',
        'ellipsoid',
        f'{made.plan().reconfigurations} placements and removals',
        '1.50°',
        '3 underruns of setpoints',
    ):
        assert said in page, said
    assert texts.count('not reached') == 0


def test_page_that_cannot_be_written_is_one_clear_line(record, tmp_path):
    """A folder that is not there is named."""
    with pytest.raises(BadRequest, match=r'report is .*none/r.html; allowed: a file that can'):
        write_report(Run.open(record), tmp_path / 'none' / 'r.html')


def test_a_record_explains_itself(made, folder, monkeypatch):
    """The mesh is that of the record, not of the catalogue; the page tells all that was noted."""

    def no_catalogue(name):
        raise UnknownObject('object', name, 'nothing')

    monkeypatch.setattr(object_mesh_module, 'find_part', no_catalogue)

    def also(writer):
        writer.note(PARAMETERS_METADATA, {'/twin': '{"friction": 0.31415}', '/view': 'damaged'})
        writer.note(VERSIONS_METADATA, {'mujoco': '3.14.15'})
        writer.attach('part.stl', 'model/stl', find_mesh_file('ellipsoid').read_bytes(), 5)

    assert Run.open(made.write(folder / 'without.mcap')).mesh is None
    run = Run.open(made.write(folder / 'explained.mcap', also=also))
    assert run.mesh.proven
    assert run.parameters == {'/twin': {'friction': 0.31415}}
    write_report(run, folder / 'explained.html')
    page = Texts(folder / 'explained.html')
    shown = ' '.join(page.texts)
    for text in ('0.31415', '3.14.15', 'a <b>test</b>', 'Parameters of 1 nodes'):
        assert text in shown


def test_thinned_lines_keep_their_extremes_and_gaps():
    """Of 100 000 noisy samples few are kept, among them both extremes and the ends of a gap."""
    rng = np.random.default_rng(3)
    values = rng.normal(size=(100_000, 1))
    values[40_000:40_777] = np.nan
    kept = thinned(values, 300)
    assert len(kept) < 1000
    assert np.all(np.diff(kept) > 0)
    for extreme in (np.nanargmin(values), np.nanargmax(values), 39_999, 40_000, 40_776, 40_777):
        assert extreme in kept


def test_simplified_mesh_keeps_its_shape():
    """A sphere of 80 000 triangles becomes one of few, closed, and no more than a cell off."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=6, radius=10.0)
    mesh = ObjectMesh(np.array(sphere.vertices), np.array(sphere.faces, dtype=np.int64), True)
    small = simplified(mesh, 5000)
    assert 500 < len(small.faces) <= 5000
    assert simplified(small, 5000) is small
    radii = np.linalg.norm(small.vertices_um[np.unique(small.faces)], axis=1)
    assert radii == pytest.approx(10.0, abs=1e-6)
    assert trimesh.Trimesh(small.vertices_um, small.faces).volume == pytest.approx(
        sphere.volume, rel=0.03
    )
