# SPDX-License-Identifier: Apache-2.0
"""Long work beside a single-threaded executor: callbacks await it, the node goes on."""

from __future__ import annotations

import concurrent.futures
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from rclpy.node import Node
from rclpy.task import Future

Result = TypeVar('Result')


class Workers(Generic[Result]):
    """Threads that do the work of a node's coroutine callbacks.

    Parameters
    ----------
    node : Node
        Its executor runs the callbacks that await the results.
    threads : int
        Works done at the same time; more wait in line.
    """

    def __init__(self, node: Node, threads: int) -> None:
        self._node = node
        self._pool = concurrent.futures.ThreadPoolExecutor(threads, thread_name_prefix='worker')
        self._stopping = threading.Event()

    @property
    def stopping(self) -> bool:
        """Whether the node is going down: long work asks, and gives up."""
        return self._stopping.is_set()

    def submit(self, work: Callable[[], Result]) -> Future:
        """Start `work`; await the future in a coroutine callback of the node."""
        executor = self._node.executor
        future = Future(executor=executor)

        def do_and_wake() -> None:
            try:
                future.set_result(work())
            except Exception as error:
                future.set_exception(error)
            if not self.stopping:
                executor.wake()

        self._pool.submit(do_and_wake)
        return future

    def shut_down(self) -> None:
        """Ask running work to give up, forget what waits, and return when the threads are gone."""
        self._stopping.set()
        self._pool.shutdown(wait=True, cancel_futures=True)
