# SPDX-License-Identifier: Apache-2.0
"""Signs of life: a node that hangs, wakes up, is killed, and has a successor."""

import signal
import subprocess
import sys
import time

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor

from microhand_node.life_sign import LifeSign, ProcessId

DEADLINE_S = 20.0
OTHER = """
import rclpy
from microhand_node.life_sign import give_life_sign
rclpy.init()
node = rclpy.create_node('other', namespace='life')
give_life_sign(node)
rclpy.spin(node)
"""


@pytest.fixture
def watch(ros_domain):
    """Return the sign of life of the node `other`, and a function that spins until something."""
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node('watcher', namespace='life', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    told = []
    life = LifeSign(node, 'other', lambda: told.append(True))

    def spin_until(condition):
        give_up_s = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < give_up_s
            executor.spin_once(timeout_sec=0.05)

    yield life, told, spin_until
    executor.shutdown()
    node.destroy_node()
    context.shutdown()


@pytest.fixture
def start():
    """Return a function that starts the other node; all are killed at the end."""
    processes = []

    def start():
        processes.append(subprocess.Popen([sys.executable, '-c', OTHER]))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.wait()


def test_one_that_hangs_and_one_that_dies_are_missed_and_a_new_one_is_known(watch, start):
    """DDS tells of the first, the kernel of the second, before it is waited for."""
    life, told, spin_until = watch
    other = start()
    spin_until(lambda: life._process is not None)
    assert (life._process.pid, life.losses, life.dead) == (other.pid, 0, False)
    other.send_signal(signal.SIGSTOP)
    spin_until(lambda: life.dead)
    assert (life.losses, told) == (1, [True])
    other.send_signal(signal.SIGCONT)
    spin_until(lambda: not life.dead)
    other.kill()
    spin_until(lambda: life.dead)
    assert life.losses == 2
    start()
    spin_until(lambda: not life.dead)
    assert life.losses == 2


def test_a_process_elsewhere_is_never_known_to_have_ended():
    """Neither is one with the same id; one that began at another time is another one."""
    me = ProcessId.own()
    assert not ProcessId('elsewhere', 1 << 22, '1').has_ended()
    assert ProcessId(me.machine, me.pid, f'{int(me.started) - 1}').has_ended()
    assert ProcessId(me.machine, (1 << 22) + 1, me.started).has_ended()
