# SPDX-License-Identifier: Apache-2.0
"""A record of a run whose truth is known: figures of its analysis follow from formulas here."""

import functools
import json
import math
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from microhand_msgs_py.msg import (
    ContactForce,
    ObjectDeviation,
    ObjectState,
    Plan,
    RunEvent,
    SequencerState,
    SetpointChunk,
    StageState,
    TipContact,
)
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from microhand_planner.core import pose
from microhand_planner.core.catalogue import find_part
from microhand_planner.core.motions import motions
from microhand_planner.core.parameters import ContactLaw, Finger, SearchOptions
from microhand_planner.core.planner import plan_reorientation
from microhand_planner.ros.conversions import plan_to_msg
from microhand_station.config import Motion, StationConfig
from microhand_station.recording.ros2msg_schema import ros2msg_schema
from microhand_station.recording.run_writer import RunWriter

START_NS = 1_700_000_000_000_000_000
BEGIN_S = 0.5
BETWEEN_S = 0.1
LAG_S = (0.002, 0.003, 0.004)
MET_OFF_UM = 0.05
GRIP_FACTOR = 1.02
UNDERRUNS = 3
NAMES = {
    '/plan': Plan,
    '/events': RunEvent,
    '/object_state': ObjectState,
    '/sequencer/state': SequencerState,
    '/sequencer/object_deviation': ObjectDeviation,
    **{f'/finger_{n}/setpoints': SetpointChunk for n in (1, 2, 3)},
    **{f'/finger_{n}/state': StageState for n in (1, 2, 3)},
    **{f'/finger_{n}/contact': TipContact for n in (1, 2, 3)},
}


def error_deg(time_s):
    """Return how far the object is turned away from its plan: a slow swing of up to 1.5°."""
    return 1.5 * np.sin(0.4 * (np.asarray(time_s) - BEGIN_S)) ** 2


@dataclass(frozen=True)
class Truth:
    """What happens at each setpoint of a run, 500 a second, over all motions.

    Attributes
    ----------
    time_s : (n,) array
        Since the start.
    command_um : (n, 3, 3) array
        Tips, station frame.
    velocity_um_s : (n, 3, 3) array
        Their derivatives.
    force_uN : (n, 3, 3) array
        As planned.
    position_um, rotation : (n, 3) array, Rotation
        Where the plan has the object.
    step, stream : (n,) array of int
        Of the plan; number of the motion, from 1.
    touching : (n, 3) array of bool
        Fingers on the object.
    touches : list
        Setpoint, finger and tip of each contact that ends a guarded motion.
    """

    time_s: np.ndarray
    command_um: np.ndarray
    velocity_um_s: np.ndarray
    force_uN: np.ndarray
    position_um: np.ndarray
    rotation: Rotation
    step: np.ndarray
    stream: np.ndarray
    touching: np.ndarray
    touches: list


@functools.cache
def config():
    """Return the station."""
    return StationConfig(motion=Motion(speed=3.0))


@functools.cache
def plan():
    """Return the paper's reorientation of the ellipsoid: rolls, placements and removals."""
    goal = pose.Pose.of(
        (0.0, 0.0, 0.0), Rotation.from_euler('ZYZ', [80.0, 220.0, 100.0], degrees=True)
    )
    return plan_reorientation(
        find_part('ellipsoid'),
        pose.Pose(),
        goal,
        Finger(clearance_um=0.5),
        ContactLaw(),
        SearchOptions(),
    )


@functools.cache
def truth():
    """Work out what happens, motion by motion."""
    made, stiffness = plan(), np.array(config().stiffness_uN_per_um)
    pace = config().motion.pace(3500.0)
    touch = config().contact.touch(float(stiffness.max()))
    parts, offset_um, begin_s, touches, count = [], np.zeros((3, 3)), BEGIN_S, [], 0
    for stream, motion in enumerate(motions(made, pace, stiffness, touch), start=1):
        path = motion.trajectory
        steps = [made.steps[k] for k in path.step_of]
        touching = np.array([step.in_contact for step in steps])
        command = path.tip_um + offset_um
        velocity = np.array(path.velocity_um_s)
        for finger in np.flatnonzero(motion.guarded):
            contact_um = motion.contact_um[finger]
            way = contact_um - path.tip_um[0, finger]
            way /= np.linalg.norm(way)
            met = (command[:, finger] - contact_um) @ way >= MET_OFF_UM
            first = int(np.argmax(met))
            assert met[first], 'the motion leads beyond the contact'
            command[met, finger] = contact_um + MET_OFF_UM * way
            velocity[met, finger] = 0.0
            offset_um[finger] = MET_OFF_UM * way
            touches.append((count + first, finger, contact_um + MET_OFF_UM * way))
        offset_um[~(touching[-1] | np.array(motion.guarded))] = 0.0
        force = _forces(made, path)
        parts.append(
            (
                begin_s + path.period_s * np.arange(len(path)),
                command,
                velocity,
                force,
                path.object_position_um,
                path.object_quaternion_wxyz,
                path.step_of,
                np.full(len(path), stream),
                touching,
            )
        )
        count += len(path)
        begin_s += path.duration_s + BETWEEN_S
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    joined[5] = Rotation.from_quat(joined[5][:, [1, 2, 3, 0]])
    return Truth(*joined, touches)


def _forces(made, path):
    """Return the planned forces (n, 3, 3): in a roll by how far the object is turned."""
    forces = np.zeros((len(path), 3, 3))
    for number in np.unique(path.step_of):
        step, rows = made.steps[number], np.flatnonzero(path.step_of == number)
        turned, known = (
            _turned(path.object_quaternion_wxyz[rows]),
            _turned(step.object_quaternion_wxyz),
        )
        if known[-1] == 0.0:
            turned, known = np.linspace(0.0, 1.0, len(rows)), np.linspace(0.0, 1.0, len(step))
        flat = step.force_uN.reshape(len(step), 9)
        at = [np.interp(turned, known, column) for column in flat.T]
        forces[rows] = np.stack(at, axis=1).reshape(-1, 3, 3)
    return forces


def _turned(wxyz):
    """Return how far an object has been turned since the first of n orientations, (n,) [rad]."""
    turns = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]])
    return np.concatenate([[0.0], np.cumsum((turns[:-1].inv() * turns[1:]).magnitude())])


def rows_at(times_s):
    """Return the setpoint that holds at each time."""
    return np.clip(np.searchsorted(truth().time_s, times_s + 1e-9, side='right') - 1, 0, None)


def write(path, *, deviations=True, lost_at_s=None, end='complete', chosen=None, also=None):
    """Write the record of the run; return its path.

    Parameters
    ----------
    path : Path
        New file.
    deviations : bool
        Whether the sequencer has recorded how far the object was off.
    lost_at_s : float, optional
        When the object is lost, and the record ends half a second later.
    end : str or None
        How the recorder closed the file; None: it did not.
    chosen : callable, optional
        Says by name which topics are recorded.
    also : callable, optional
        Writes more into the record.
    """
    note = {'station': config().to_dict(), 'request': {'asked by': 'a <b>test</b>'}}
    writer = RunWriter(
        path.open('xb'),
        {
            'run': 'made',
            'started': '2026-11-24T12:00:00+00:00',
            'plan_hash': plan_to_msg(plan()).plan_hash,
            'metadata_json': json.dumps(note),
        },
    )
    for topic, kind in NAMES.items():
        name = f'microhand_msgs_py/msg/{kind.__name__}'
        writer.add_topic(topic, name, _schema(name), '')
    if also is not None:
        also(writer)
    stop_s = math.inf if lost_at_s is None else lost_at_s + 0.5
    for topic, seconds, cdr in _serialized(deviations, lost_at_s):
        if seconds <= stop_s and (chosen is None or chosen(topic)):
            time_ns = START_NS + round(seconds * 1e9)
            writer.write(topic, cdr, time_ns, time_ns)
    if end is None:
        writer.abandon()
    else:
        writer.close(end)
    return path


_schema = functools.cache(ros2msg_schema)


@functools.cache
def _serialized(deviations, lost_at_s):
    """Return topic, seconds and bytes of all messages, in the order of time."""
    made = sorted(_messages(deviations, lost_at_s), key=lambda item: item[1])
    return [(topic, seconds, serialize_message(message)) for topic, seconds, message in made]


def _header(seconds, frame=''):
    sec, nanosec = divmod(START_NS + round(seconds * 1e9), 10**9)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame)


def _messages(deviations, lost_at_s):
    """Yield topic, seconds and message, topic by topic."""
    end_s = float(truth().time_s[-1]) + 0.2
    yield '/plan', 0.0, plan_to_msg(plan())
    yield '/events', 0.1, RunEvent(header=_header(0.1), source='/sequencer', text='made <up>')
    if lost_at_s is not None:
        text = 'run ended: the object is lost: two fingers let go'
        yield (
            '/events',
            lost_at_s,
            RunEvent(header=_header(lost_at_s), source='/sequencer', error_code=306, text=text),
        )
    yield from _sequencer(end_s)
    yield from _object(end_s, deviations, lost_at_s)
    for finger in range(3):
        yield from _setpoints(finger)
        yield from _states(finger, end_s)


def _sequencer(end_s):
    steps, whole_s = len(plan().steps), float(truth().time_s[-1])
    for seconds in np.arange(0.0, end_s, 0.1):
        row = rows_at(np.array([seconds]))[0]
        share = float(np.clip((seconds - BEGIN_S) / (whole_s - BEGIN_S), 0.0, 1.0))
        state = SequencerState(
            header=_header(seconds), state=2, step=int(truth().step[row]), steps=steps
        )
        state.progress = share
        yield '/sequencer/state', seconds + 0.001, state


def _object(end_s, deviations, lost_at_s):
    times_s = np.arange(0.0, end_s, 0.02)
    released_at_s = truth().time_s[truth().touches[1][0]]
    for seconds, row in zip(times_s, rows_at(times_s), strict=True):
        off_deg = float(error_deg(seconds)) if seconds >= released_at_s else 0.0
        turned = Rotation.from_rotvec([0.0, math.radians(off_deg), 0.0]) * truth().rotation[row]
        x, y, z, w = turned.as_quat().tolist()
        force_uN = GRIP_FACTOR * truth().force_uN[row]
        state = ObjectState(
            header=_header(seconds, 'station'),
            pose=Pose(position=Point(z=1e-8), orientation=Quaternion(x=x, y=y, z=z, w=w)),
            held=bool(lost_at_s is None or seconds < lost_at_s),
            released=bool(seconds >= released_at_s),
            contacts=_contacts(force_uN, truth().touching[row]),
        )
        state.lost_because = '' if state.held else 'two fingers let go'
        yield '/object_state', seconds + 0.01, state
        if deviations and released_at_s <= seconds <= truth().time_s[-1]:
            off = ObjectDeviation(header=_header(seconds), angle=math.radians(off_deg))
            off.distance = 1e-8
            yield '/sequencer/object_deviation', seconds + 0.012, off


def _contacts(force_uN, touching):
    """Return contacts of a pair on the line of its force, 16 µm apart."""
    made = []
    for finger in range(3):
        length = float(np.linalg.norm(force_uN[finger]))
        at_um = -8.0 * force_uN[finger] / length if length else np.full(3, np.nan)
        x, y, z = (1e-6 * at_um).tolist()
        fx, fy, fz = (1e-6 * force_uN[finger]).tolist()
        contact = ContactForce(finger=finger + 1, in_contact=bool(touching[finger]))
        contact.position, contact.force = Point(x=x, y=y, z=z), Vector3(x=fx, y=fy, z=fz)
        contact.normal_force = 1e-6 * length
        contact.friction_use = 0.1 * (finger + 1) if touching[finger] else math.nan
        made.append(contact)
    return made


def _setpoints(finger):
    base_um = np.array(config().fingers[finger].base_um)
    for stream in np.unique(truth().stream):
        rows = np.flatnonzero(truth().stream == stream)
        for first in range(0, len(rows), 25):
            part = rows[first : first + 25]
            chunk = SetpointChunk(stream=int(stream), sequence=first, period=0.002)
            chunk.header = _header(truth().time_s[part[0]])
            chunk.positions = (
                (1e-6 * (truth().command_um[part, finger] - base_um)).ravel().tolist()
            )
            velocity = 1e-6 * truth().velocity_um_s[part, finger]
            chunk.velocities = velocity.ravel().tolist()
            yield f'/finger_{finger + 1}/setpoints', truth().time_s[part[0]] - 0.2, chunk


def _states(finger, end_s):
    base_um = np.array(config().fingers[finger].base_um)
    times_s = np.arange(0.0, end_s, 0.01)
    for seconds, row in zip(times_s, rows_at(times_s), strict=True):
        under_way = BEGIN_S <= seconds <= truth().time_s[-1]
        velocity = truth().velocity_um_s[row, finger] if under_way else np.zeros(3)
        command_um = truth().command_um[row, finger] - base_um
        measured_um = command_um - LAG_S[finger] * velocity
        state = StageState(header=_header(seconds), mode=2 if under_way else 1)
        state.command = Point(**dict(zip('xyz', (1e-6 * command_um).tolist(), strict=True)))
        state.position = Point(**dict(zip('xyz', (1e-6 * measured_um).tolist(), strict=True)))
        state.stream = int(truth().stream[row])
        state.underruns = UNDERRUNS if finger == 1 and seconds > 2.0 else 0
        state.contact_position = Point(x=math.nan, y=math.nan, z=math.nan)
        for at, of, tip_um in truth().touches:
            if of == finger and truth().stream[at] == state.stream and row >= at:
                x, y, z = (1e-6 * (tip_um - base_um)).tolist()
                state.guard_tripped, state.contact_position = True, Point(x=x, y=y, z=z)
        yield f'/finger_{finger + 1}/state', seconds + 0.003, state
        yield (
            f'/finger_{finger + 1}/contact',
            seconds + 0.004,
            TipContact(header=_header(seconds), in_contact=bool(truth().touching[row, finger])),
        )
