# SPDX-License-Identifier: Apache-2.0
"""Messages ↔ values of this package: the one place where m become µm and stamps become s."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from microhand_msgs_py.msg import RunEvent, SetpointChunk, StageState, TipContact
from microhand_msgs_py.srv import GetStageLimits
from numpy.typing import NDArray

from stage_driver_sim.chunk import Chunk
from stage_driver_sim.contact_guard import ContactReport
from stage_driver_sim.errors import InvalidParameter
from stage_driver_sim.protocol import StageLimits, Vector
from stage_driver_sim.snapshot import Event, Snapshot

UM_PER_M = 1e6
NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class ClockMap:
    """ROS time on the steady clock of the control loop.

    Fixed once, so that a step of the system clock cannot move a stage.

    Parameters
    ----------
    ros_minus_steady_ns : int
        ROS time less steady time [ns].
    """

    ros_minus_steady_ns: int

    def to_steady_s(self, stamp: Time) -> float:
        """Return the time of the steady clock [s] at a ROS stamp."""
        ros_ns = stamp.sec * NS_PER_S + stamp.nanosec
        return float(ros_ns - self.ros_minus_steady_ns) / NS_PER_S

    def to_stamp(self, steady_s: float) -> Time:
        """Return the ROS stamp of a time of the steady clock [s]."""
        sec, nanosec = divmod(round(steady_s * NS_PER_S) + self.ros_minus_steady_ns, NS_PER_S)
        return Time(sec=sec, nanosec=nanosec)


def chunk_from_message(message: SetpointChunk, clock_map: ClockMap) -> Chunk:
    """Return the setpoints of a message.

    Raises
    ------
    InvalidNumber, InvalidParameter
        NaN, a number of values that is no multiple of three, or another wrong field.
    """
    velocities_um_s = None
    if len(message.velocities) > 0:
        velocities_um_s = _rows_um('velocities', message.velocities)
    return Chunk(
        time_s=clock_map.to_steady_s(message.header.stamp),
        period_s=message.period,
        positions_um=_rows_um('positions', message.positions),
        velocities_um_s=velocities_um_s,
        sequence=message.sequence,
        stream=message.stream,
        last=message.last,
        guarded=message.guarded,
    )


def contact_from_message(message: TipContact, clock_map: ClockMap) -> ContactReport:
    """Return what a message says about contact."""
    return ContactReport(clock_map.to_steady_s(message.header.stamp), message.in_contact)


def state_message(snapshot: Snapshot, clock_map: ClockMap, frame_id: str) -> StageState:
    """Return the message that publishes a snapshot."""
    message = StageState(
        mode=int(snapshot.mode),
        position=_point(snapshot.position_um),
        velocity=_vector(snapshot.velocity_um_s),
        command=_point(snapshot.command_um),
        on_target=snapshot.on_target,
        stream=snapshot.stream,
        received=snapshot.received,
        underruns=snapshot.underruns,
        error_code=snapshot.error_code,
        error_msg=snapshot.error_msg,
        guard_tripped=snapshot.guard_tripped,
        contact_position=_point(snapshot.contact_um),
    )
    message.header.stamp = clock_map.to_stamp(snapshot.time_s)
    message.header.frame_id = frame_id
    return message


def event_message(event: Event, clock_map: ClockMap, source: str) -> RunEvent:
    """Return the message that publishes an event."""
    message = RunEvent(source=source, error_code=event.code, text=event.text)
    message.header.stamp = clock_map.to_stamp(event.time_s)
    return message


def fill_limits(
    response: GetStageLimits.Response, limits: StageLimits, hardware_id: str
) -> GetStageLimits.Response:
    """Return `response` with the limits of a stage in it."""
    response.lower = _point(limits.lower_um)
    response.upper = _point(limits.upper_um)
    response.home = _point(limits.home_um)
    response.max_velocity = limits.max_velocity_um_s / UM_PER_M
    if np.isfinite(limits.max_acceleration_um_s2):
        response.max_acceleration = limits.max_acceleration_um_s2 / UM_PER_M
    response.hardware_id = hardware_id
    return response


def _rows_um(field: str, values_m: object) -> NDArray[np.float64]:
    flat_um = np.array(values_m, dtype=np.float64) * UM_PER_M
    if flat_um.size % 3 != 0:
        raise InvalidParameter(f'{field} has {flat_um.size} values; allowed: a multiple of 3')
    return flat_um.reshape(-1, 3)


def _point(vector_um: Vector) -> Point:
    x, y, z = (vector_um / UM_PER_M).tolist()
    return Point(x=x, y=y, z=z)


def _vector(vector_um: Vector) -> Vector3:
    x, y, z = (vector_um / UM_PER_M).tolist()
    return Vector3(x=x, y=y, z=z)
