# SPDX-License-Identifier: Apache-2.0
"""The end of a node's process, also when the middleware does not return."""

from __future__ import annotations

import signal
import subprocess
import sys

CHILD = """
import ctypes, sys
from rclpy.node import Node
from microhand_node import run_node

class Hanging(Node):
    def destroy_node(self):
        ctypes.PyDLL(None).sleep(600)  # no thread of Python runs meanwhile

def make():
    node = Hanging('hanging')
    print('ready', flush=True)
    return node

run_node.HANGS_S = 1.0
sys.exit(run_node.run_node(make))
"""


def test_a_node_that_hangs_at_its_end_is_ended_and_says_where(ros_domain: int) -> None:
    """The interpreter is held by a call that does not return: the process ends all the same."""
    with subprocess.Popen(
        [sys.executable, '-c', CHILD], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == 'ready\n'
        child.send_signal(signal.SIGTERM)
        _, said = child.communicate(timeout=30)
    assert child.returncode == 1
    assert 'in destroy_node' in said
