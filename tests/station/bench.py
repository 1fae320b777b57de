# SPDX-License-Identifier: Apache-2.0
"""A bench for the sequencer: drivers and twin in processes, sequencer and client in this one."""

import contextlib
import threading
from dataclasses import dataclass

import numpy as np
import rclpy
from microhand_msgs_py.msg import (
    ObjectState,
    RunEvent,
    SequencerState,
    SetpointChunk,
    StageState,
)
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from microhand_node.qos import EVENTS, LATCHED, SETPOINTS, STATE
from microhand_planner.core.plan import Plan
from microhand_planner.ros.conversions import um_from_m, um_from_point
from microhand_station.bringup.lifecycle import activate
from microhand_station.bringup.node_commands import node_commands
from microhand_station.bringup.processes import NodeProcess, end_processes
from microhand_station.client import ExecutionResult, StationClient, StationError
from microhand_station.config import ContactConfig, Motion, StationConfig, write_config
from microhand_station.recording_config import RecordingConfig
from microhand_station.sequencer.node import SequencerNode
from microhand_station.service_call import call, greet

CONFIG = StationConfig(
    namespace='bench',
    recording=RecordingConfig(required=False),
    motion=Motion(roll_rate_deg_s=45.0, speed=3.0),
    contact=ContactConfig(speed_um_s=2.0, standoff_um=0.6, overtravel_um=0.4, tolerance_um=0.3),
)
DEADLINE_S = 20.0
BASE_UM = np.array(CONFIG.fingers[0].base_um)


class Watcher:
    """Keeps what the sequencer and the drivers publish; tests wait for conditions on it."""

    def __init__(self, node):
        self.states = []
        self.chunks = {1: [], 2: [], 3: []}
        self.stages = {}
        self.events = []
        self.object = None
        self._changed = threading.Condition()
        node.create_subscription(RunEvent, 'events', self._on_event, EVENTS)
        node.create_subscription(ObjectState, 'object_state', self._on_object, STATE)
        node.create_subscription(SequencerState, 'sequencer/state', self._on_state, LATCHED)
        for finger in (1, 2, 3):
            node.create_subscription(
                SetpointChunk, f'finger_{finger}/setpoints', self._on_chunk, SETPOINTS
            )
            node.create_subscription(StageState, f'finger_{finger}/state', self._on_stage, STATE)

    def _on_state(self, message):
        with self._changed:
            self.states.append(message)
            self._changed.notify_all()

    def _on_chunk(self, message):
        with self._changed:
            self.chunks[int(message.header.frame_id[7])].append(message)
            self._changed.notify_all()

    def _on_stage(self, message):
        with self._changed:
            self.stages[int(message.header.frame_id[7])] = message
            self._changed.notify_all()

    def _on_event(self, message):
        with self._changed:
            self.events.append(message.text)
            self._changed.notify_all()

    def _on_object(self, message):
        with self._changed:
            self.object = message
            self._changed.notify_all()

    def wait(self, condition, deadline_s=DEADLINE_S):
        """Return when `condition` holds; fail after the deadline."""
        with self._changed:
            assert self._changed.wait_for(condition, deadline_s), 'waited in vain'

    def wait_state(self, state):
        """Return when the sequencer is in a state."""
        self.wait(lambda: self.states and self.states[-1].state == state)

    def tips_um(self):
        """Return where the drivers say that the tips are, station frame."""
        return np.stack([um_from_point(self.stages[f].position) + BASE_UM for f in (1, 2, 3)])

    def commands_um(self):
        """Return where the drivers say that the tips are to be, station frame."""
        return np.stack([um_from_point(self.stages[f].command) + BASE_UM for f in (1, 2, 3)])

    def clear(self):
        """Forget setpoints and states."""
        with self._changed:
            self.states = self.states[-1:]
            self.events.clear()
            for chunks in self.chunks.values():
                chunks.clear()


class Bench:
    """Three drivers and a twin in processes, a sequencer in this one, and a client."""

    def __init__(self, folder, mesh, config=CONFIG, environment=None):
        self.folder = folder
        self.environment = environment or {}
        self.mesh = str(mesh)
        write_config(config, folder / 'station.yaml')
        self.commands = {command.name: command for command in node_commands(config, folder)}
        self.drivers = {finger: self.start(f'finger_{finger}') for finger in (1, 2, 3)}
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        parameter = Parameter('config', value=str(folder / 'station.yaml'))
        self.node = SequencerNode(
            context=self.context, namespace='bench', parameter_overrides=[parameter]
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.stopping = threading.Event()
        self.spinner = threading.Thread(target=self._spin)
        self.spinner.start()
        self.client = StationClient('bench')
        self.watcher = Watcher(self.client.node)
        for finger in (1, 2, 3):
            self.activate(finger)
        self.start_twin()

    def make_ready(self):
        """Wait until the sequencer is idle, clear faults, and forget what was seen."""
        self.watcher.wait_state(SequencerState.IDLE)
        if any(state.mode == StageState.FAULT for state in self.watcher.stages.values()):
            self.client.command('reset')  # one test that failed must not make the others fail
        self.watcher.clear()

    def _spin(self):
        while not self.stopping.is_set():
            self.executor.spin_once(timeout_sec=0.05)

    def start(self, name):
        """Start the process of a driver or of the twin."""
        command = self.commands[name]
        log = self.folder / f'{command.name}.log'
        return NodeProcess(command.name, command.module, command.arguments, log, self.environment)

    def start_twin(self):
        """Start the process of the twin, and wait until it answers."""
        self.twin = self.start('twin')
        greet(self.client.node, 'twin', deadline_s=DEADLINE_S, who='the twin', missing_code=900)

    def activate(self, finger):
        """Bring a driver to work, and wait for its first state."""
        self.watcher.stages.pop(finger, None)
        activate(
            self.client.node,
            f'finger_{finger}/stage_driver',
            who=f'finger {finger}',
            deadline_s=DEADLINE_S,
        )
        self.watcher.wait(lambda: finger in self.watcher.stages)

    def close(self):
        """End everything."""
        self.client.close()
        self.stopping.set()
        self.spinner.join()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        assert end_processes([*self.drivers.values(), self.twin]) == []

    def execute(self, plan, on_progress=None):
        """Execute a plan for the sphere, and return the result."""
        return self.client.execute(plan, on_progress=on_progress, object_name=self.mesh)

    def tell_twin(self, **values):
        """Set parameters of the twin, numbers or lists; they count from the next plan on."""
        self.tell('twin', **values)

    def tell(self, name, **values):
        """Set parameters of a node."""
        node = self.client.node
        client = node.create_client(SetParameters, f'{name}/set_parameters')
        parameters = [
            Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=parameters)
        answer = call(client, request, deadline_s=DEADLINE_S, who=name, missing_code=900)
        assert [(result.successful, result.reason) for result in answer.results] == [
            (True, '')
        ] * len(values)
        node.destroy_client(client)

    @contextlib.contextmanager
    def executing(self, plan):
        """Execute a plan in another thread; gives a list that will hold the error, if any."""
        errors, ended = [], threading.Event()

        def execute():
            try:
                self.execute(plan)
            except StationError as error:
                errors.append(error)
            ended.set()

        thread = threading.Thread(target=execute)
        thread.start()
        try:
            yield errors
        except BaseException:
            self.client.cancel()  # one test that failed must not make the others fail
            raise
        finally:
            thread.join(DEADLINE_S)
        assert not thread.is_alive(), 'the action did not end'


@dataclass(frozen=True)
class Run:
    """A run that went well: what was asked for, and all that could be seen of it."""

    plan: Plan
    begin_um: np.ndarray
    end_um: np.ndarray
    result: ExecutionResult
    told: list
    chunks: dict
    events: list
    object: ObjectState
    underruns: int


def run(bench, plan):
    """Execute a plan and return all that could be seen of it."""
    watcher = bench.watcher
    begin_um = watcher.commands_um()
    told = []
    result = bench.execute(plan, told.append)
    watcher.wait(lambda: all(stage.on_target for stage in watcher.stages.values()))
    watcher.wait(
        lambda: all(
            sum(len(chunk.positions) // 3 for chunk in chunks) == result.setpoints_sent
            for chunks in watcher.chunks.values()
        )
    )
    chunks = {finger: list(chunks) for finger, chunks in watcher.chunks.items()}
    underruns = sum(stage.underruns for stage in watcher.stages.values())
    return Run(
        plan, begin_um, watcher.tips_um(), result, told, chunks, list(watcher.events),
        watcher.object, underruns,
    )  # fmt: skip


def sent_tips_um(chunks_of):
    """Return all setpoints that were sent, station frame, after checking their order."""
    tips = []
    for finger in (1, 2, 3):
        rows, expected = [], None
        for chunk in chunks_of[finger]:
            key = (chunk.stream, chunk.sequence)
            assert expected is None or key == expected or chunk.sequence == 0
            rows.append(um_from_m(chunk.positions).reshape(-1, 3) + BASE_UM)
            expected = (chunk.stream, chunk.sequence + len(rows[-1]))
        tips.append(np.concatenate(rows))
    return np.stack(tips, axis=1)
