# SPDX-License-Identifier: Apache-2.0
"""What the tests of the live view share: plans on a sphere, and windows of a browser."""

import sys

import pytest

from tests.station.conftest import sphere_mesh, sphere_plan  # noqa: F401

SLOW_FRAMES = """
window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 600);
window.cancelAnimationFrame = clearTimeout;
"""
"""Without a GPU a browser draws on the processors that the station needs: seldom, then."""
LONGEST_WAIT_MS = 60_000


@pytest.fixture
def open_page(browser):
    """Return a function that opens an address in a browser window of its own.

    What a window said last is printed: it is seen if the test fails.
    """
    windows = []

    def opened(url):
        window = browser.new_context(viewport={'width': 1000, 'height': 620})
        windows.append(window)
        page = window.new_page()
        page.set_default_timeout(LONGEST_WAIT_MS)
        page.add_init_script(SLOW_FRAMES)
        page.goto(url)
        return page

    yield opened
    for window in windows:
        for page in window.pages:
            sys.stdout.write(f'{page.url}:\n{page.inner_text("body")}\n')
        window.close()
