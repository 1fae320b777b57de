# SPDX-License-Identifier: Apache-2.0
"""Signs of life between nodes: who waits for another one learns soon that it died.

DDS forgets a node that was killed after 20 s; until then its services look ready. So each node
that others wait for says once, on its topic ``~/alive``, which process of which machine it is. On
the same machine the others ask the kernel, whose answer is exact and immediate, however busy
everybody is. Of a node elsewhere, or of one that hangs, they learn by the liveliness of DDS: a
thread that Python cannot hold up vouches for the publisher, and its silence is noticed after
`SILENCE_S`.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rclpy.duration import Duration
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile
from std_msgs.msg import String

VOUCHED_S = 0.5
"""DDS vouches for a publisher at two thirds of this time [s]."""
SILENCE_S = 1.5
"""A node that DDS has not vouched for in this time is taken for dead [s]."""


def _alive(lease_s: float) -> QoSProfile:
    return QoSProfile(
        depth=1,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(seconds=lease_s),
    )


@dataclass(frozen=True)
class ProcessId:
    """A process, told apart from every other one on any machine, now and later.

    Parameters
    ----------
    machine : str
        Of one start of one machine, and of one container on it.
    pid : int
        Of the process.
    started : str
        Clock ticks from the machine's start to the process's: ids are used again.

    Examples
    --------
    >>> me = ProcessId.own()
    >>> (ProcessId.read(str(me)) == me, me.has_ended())
    (True, False)
    """

    machine: str
    pid: int
    started: str

    def __str__(self) -> str:
        """Return what `read` reads."""
        return f'{self.machine} {self.pid} {self.started}'

    @classmethod
    def own(cls) -> ProcessId:
        """Return this process."""
        return cls(_machine(), os.getpid(), _stat(os.getpid())[19])

    @classmethod
    def read(cls, text: str) -> ProcessId:
        """Return the process that a text names.

        Raises
        ------
        ValueError
            The text names none.
        """
        machine, pid, started = text.split()
        return cls(machine, int(pid), started)

    def has_ended(self) -> bool:
        """Whether the process is known to have ended: on another machine it never is."""
        if self.machine != _machine():
            return False
        try:
            state, *others = _stat(self.pid)
        except OSError:
            return True
        return state in 'ZX' or others[18] != self.started  # dead, not waited for yet; or another


def _machine() -> str:
    boot = Path('/proc/sys/kernel/random/boot_id').read_text(encoding='ascii').strip()
    return f'{boot}/{os.readlink("/proc/self/ns/pid")}'


def _stat(pid: int) -> list[str]:
    """Return what the kernel says of a process, from its state on: see ``man 5 proc``."""
    text = Path(f'/proc/{pid}/stat').read_text(encoding='utf-8', errors='replace')
    return text.rpartition(')')[2].split()


def give_life_sign(node: Node) -> None:
    """Let other nodes know that this one lives; call it before anything else of the node is made.

    Endpoints become known in the order of their making: whoever sees a service of the node then
    has seen its sign of life.
    """
    node.create_publisher(String, '~/alive', _alive(VOUCHED_S)).publish(
        String(data=str(ProcessId.own()))
    )


class LifeSign:
    """What one node knows about the life of another one.

    Parameters
    ----------
    node : Node
        Listens; spun by any thread.
    of : str
        Name of the other node, relative to the namespace.
    on_loss : callable, optional
        Called by the thread that spins when the other node ends or falls silent.
    """

    def __init__(self, node: Node, of: str, on_loss: Callable[[], None] | None = None) -> None:
        self._on_loss = on_loss
        self._lock = threading.Lock()
        self._process: ProcessId | None = None
        self._mourned = False
        self._losses = 0
        node.create_subscription(
            String,
            f'{of}/alive',
            self._receive,
            _alive(SILENCE_S),
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._on_change),
        )

    @property
    def losses(self) -> int:
        """How often the other node has ended, or died, since this began to listen."""
        with self._lock:
            if self._process is not None and self._process.has_ended():
                self._mourn()
            return self._losses

    @property
    def dead(self) -> bool:
        """Whether the other node has ended, or died, and nobody has taken its place."""
        return self.losses > 0 and self._mourned

    def _mourn(self) -> None:
        """Count a loss, once for each process."""
        self._losses += not self._mourned
        self._mourned = True

    def _receive(self, message: String) -> None:
        """Keep which process the other node is."""
        with self._lock:
            if self._process is not None:
                self._mourn()  # there is another one in its place
            self._process, self._mourned = ProcessId.read(message.data), False

    def _on_change(self, change: QoSLivelinessChangedInfo) -> None:
        """Count a node that took its leave, or that nobody vouches for."""
        with self._lock:
            if change.alive_count > 0:
                if self._process is not None and not self._process.has_ended():
                    self._mourned = False  # it was silent only
                return
            if self._process is not None:
                self._mourn()
        if self._on_loss is not None:
            self._on_loss()
