# SPDX-License-Identifier: Apache-2.0
"""The thread that owns the stage: it obeys, ends at rest, and never fails silently."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from stage_driver_sim import control_loop
from stage_driver_sim.chunk import Chunk
from stage_driver_sim.control_loop import REST_PERIOD_S, ControlLoop
from stage_driver_sim.controller import ControllerSettings, Mode, StageController
from stage_driver_sim.errors import NotAllowed, StageError
from stage_driver_sim.presets import REPRESENTATIVE_100_UM_XYZ
from stage_driver_sim.simulated_stage import SimulatedStage

DEADLINE_S = 5.0


def make_loop() -> ControlLoop:
    """Return a loop at 500 Hz around a simulated stage, not started."""
    now_s = time.monotonic()
    stage = SimulatedStage(
        REPRESENTATIVE_100_UM_XYZ,
        home_um=np.full(3, 50.0),
        rng=np.random.default_rng(2),
        now_s=now_s,
    )
    controller = StageController(
        stage, name='finger_1', settings=ControllerSettings(1e6, 0.02, 0.02), now_s=now_s
    )
    return ControlLoop(controller, period_s=0.002)


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait for the loop's thread; fail after `DEADLINE_S`."""
    give_up_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < give_up_s, 'deadline passed'
        time.sleep(0.001)


def test_it_does_what_it_is_asked_and_passes_errors_on() -> None:
    """`ask` returns the result, raises what the action raised, and the loop goes on."""
    loop = make_loop()
    loop.start()
    try:
        thread = loop.ask(lambda controller, now_s: threading.current_thread().name)
        assert thread == 'control loop'
        loop.ask(StageController.stop)
        with pytest.raises(NotAllowed, match='home in mode STOPPED'):
            loop.ask(StageController.home)
        loop.ask(StageController.reset)
        wait_until(lambda: loop.snapshot().mode is Mode.HOLDING)
    finally:
        loop.stop()
    assert [event.text for event in loop.take_events()][:2] == [
        'finger_1: stopped',
        'finger_1: reset',
    ]


def test_work_is_done_in_the_order_of_the_calls() -> None:
    """A thousand orders, told without waiting, are done one after the other."""
    loop = make_loop()
    done: list[int] = []
    loop.start()
    try:
        for k in range(1000):
            loop.tell(lambda controller, now_s, k=k: done.append(k))
        loop.ask(lambda controller, now_s: None)
    finally:
        loop.stop()
    assert done == list(range(1000))


def test_stopping_in_motion_brakes_first() -> None:
    """The thread ends when the stage is at rest, not in the middle of a ramp."""
    loop = make_loop()
    loop.start()
    begin_s = time.monotonic() + 0.05
    ramp_um = np.outer(np.arange(1000) * 0.04, [1.0, 0.0, 0.0])
    begin_um = loop.snapshot().command_um
    chunk = Chunk(begin_s, 0.002, begin_um + ramp_um, None, 0, 1, False)
    loop.tell(lambda controller, now_s: controller.accept(chunk, now_s))
    wait_until(lambda: loop.snapshot().command_um[0] > begin_um[0] + 1.0)
    loop.stop()
    assert loop.snapshot().mode is Mode.STOPPED
    assert not loop._controller.moving
    assert not loop._thread.is_alive()


def test_a_loop_that_breaks_reports_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """A defect in a tick ends in mode FAULT, code INTERNAL, and an answer for whoever asks."""
    monkeypatch.setattr(control_loop, 'ANSWER_TIMEOUT_S', 0.05)
    loop = make_loop()

    def break_down(controller: StageController, now_s: float) -> None:
        raise ZeroDivisionError('broken on purpose')

    loop.start()
    loop.tell(break_down)
    wait_until(lambda: loop.snapshot().mode is Mode.FAULT)
    assert loop.snapshot().error_code == 900
    assert 'ZeroDivisionError: broken on purpose' in loop.snapshot().error_msg
    with pytest.raises(StageError, match='did not answer'):
        loop.ask(StageController.stop)
    loop.stop()


def test_at_rest_it_ticks_seldom_and_at_once_when_there_is_something_to_do() -> None:
    """A stage on its target rests most of the time; an order does not wait for the rest to end."""
    loop = make_loop()
    loop.start()
    try:
        wait_until(lambda: loop.snapshot().on_target)
        loop.take_timing()
        wait_until(lambda: loop._timing.wall_s > 0.3)
        timing = loop.take_timing()
        waits_s = []
        for _ in range(20):
            asked_s = time.monotonic()
            waits_s.append(loop.ask(lambda controller, now_s: now_s) - asked_s)
    finally:
        loop.stop()
    assert timing.resting_s > 0.5 * timing.wall_s
    assert min(waits_s) < 0.5 * REST_PERIOD_S


def test_it_looks_for_work_that_waits_elsewhere() -> None:
    """What is found there is done in the order in which it came, in motion and at rest."""
    waiting: list[str] = []
    done: list[str] = []
    loop = make_loop()

    def do_all(controller: StageController, now_s: float) -> None:
        while waiting:
            done.append(waiting.pop())

    def look_for_work() -> None:
        if waiting:
            loop.tell(do_all)

    loop._look_for_work = look_for_work
    loop.start()
    try:
        for order in ('early', 'late'):
            waiting.append(order)
            wait_until(lambda order=order: order in done)
            wait_until(lambda: loop.snapshot().on_target)
    finally:
        loop.stop()
    assert done == ['early', 'late']


def test_a_loop_that_was_kept_from_running_looks_before_it_calls_a_stream_dry() -> None:
    """The rest of a stream arrives in time, but the loop is away beyond its end: no underrun."""
    loop = make_loop()
    arrived: list[Chunk] = []

    def look_for_work() -> None:
        if arrived:
            chunk = arrived.pop()
            loop.tell(lambda controller, now_s: controller.accept(chunk, now_s))

    def be_away(until_s: float, chunk: Chunk) -> None:
        arrived.append(chunk)
        time.sleep(max(0.0, until_s - time.monotonic()))

    loop._look_for_work = look_for_work
    loop.start()
    try:
        here_um = np.tile(loop.snapshot().command_um, (50, 1))
        begin_s = time.monotonic() + 0.05
        first = Chunk(begin_s, 0.002, here_um, None, 0, 1, False)
        rest = Chunk(begin_s + 0.1, 0.002, here_um, None, 50, 1, True)
        loop.tell(lambda controller, now_s: controller.accept(first, now_s))
        loop.tell(lambda controller, now_s: be_away(begin_s + 0.15, rest))
        wait_until(lambda: loop.snapshot().time_s > begin_s + 0.21)
        assert loop.snapshot().mode is Mode.HOLDING
        assert loop.snapshot().received == 100
        assert loop.snapshot().underruns == 0
    finally:
        loop.stop()


def test_it_keeps_its_rate_and_says_how_well() -> None:
    """Ticks done, ticks missed and rests add up to the time passed; each report starts anew."""
    loop = make_loop()
    loop.start()
    try:
        wait_until(lambda: loop._timing.wall_s > 0.3)
        timing = loop.take_timing()
    finally:
        loop.stop()
    spent_s = (timing.ticks + timing.missed) * 0.002 + timing.resting_s
    assert spent_s == pytest.approx(timing.wall_s, abs=0.01)
    assert 0.0 < timing.cpu_s < timing.wall_s
    assert loop.take_timing().wall_s < timing.wall_s
