# SPDX-License-Identifier: Apache-2.0
"""A terminal for each page."""

import pytest

from tests.docs.terminal import Terminal


@pytest.fixture
def terminal(ros_domain, tmp_path):
    """Give a terminal; what is left in the background is ended."""
    terminal = Terminal(tmp_path)
    yield terminal
    terminal.close()
