"""Inputs of the controllers: the newest arrived set-point, and the estimator's output."""

from __future__ import annotations

import math
import struct
from typing import Annotated

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Axes, Quaternion, Record, Vector, cell, scalars
from flightstack.core.types import ZERO, Vec3

ROOM = 256  # maximum number of set-points in transit; at 1 kHz and a delay of 0.1 s there are 100
WIDTH = 12  # values per row: arrival time, then the fields of a set-point
_ROW = struct.Struct(f"={WIDTH}d")


class SetpointRecord(Record):
    """A velocity or position set-point in the world (ENU, m/s, m) with a yaw."""

    vx: float
    vy: float
    vz: float
    yaw_rad: float
    stop: bool  # whether the motors are off: the firmware's null set-point
    cos_yaw: float
    sin_yaw: float
    by_position: bool  # whether the set-point is a position
    x: float
    y: float
    z: float


Setpoint = tuple[float, ...]  # values of a ``SetpointRecord``


def set_point(
    velocity: Vec3 = ZERO, yaw_rad: float = 0.0, *, position: Vec3 | None = None, stop: bool = False
) -> Setpoint:
    """Return the values of a set-point: a position if ``position`` is given, else a velocity."""
    yaw = yaw_rad, stop, math.cos(yaw_rad), math.sin(yaw_rad)
    return *velocity, *yaw, position is not None, *(position or ZERO)


STOP = set_point(stop=True)


class SensedState(Record):
    """Output of the estimator at 500 Hz; ENU, FLU, SI units."""

    position: Vector
    velocity: Vector
    quaternion: Quaternion
    axes: Axes
    rates: Vector  # angular velocity of the gyro


class InboxRecord(Record):
    """Ring buffer of set-points in transit."""

    rows: Annotated[F64, ROOM * WIDTH]  # arrival times in whole ms, and set-points
    first: int  # number of the oldest set-point that has not arrived
    end: int  # number of the next set-point to be sent
    taken_ms: int  # arrival time of the current set-point


@jitted
def receive(inbox: InboxRecord, s: SetpointRecord, now_ms: int) -> None:
    """Make the newest arrived set-point the current set-point."""
    while inbox.first < inbox.end:
        at = WIDTH * (inbox.first % ROOM)
        row = inbox.rows[at : at + WIDTH]
        if row[0] > now_ms:
            return
        inbox.taken_ms = int(row[0])
        s.vx, s.vy, s.vz, s.yaw_rad = row[1], row[2], row[3], row[4]
        s.stop, s.cos_yaw, s.sin_yaw = row[5] != 0.0, row[6], row[7]
        s.by_position, s.x, s.y, s.z = row[8] != 0.0, row[9], row[10], row[11]
        inbox.first += 1


class Inbox:
    """Sends set-points into the ring buffer ``record``; ``setpoint``: the current set-point."""

    def __init__(self, record: InboxRecord, setpoint: SetpointRecord) -> None:
        self._rows = record.rows.data
        self._first, self._end, self._taken_ms = scalars(record, "first", "end", "taken_ms")
        self._setpoint = cell(setpoint)

    def send(self, setpoint: Setpoint, arrives_ms: int) -> None:
        """Send a set-point; in a full buffer it replaces the newest set-point."""
        end = self._end[0]
        if end - self._first[0] >= ROOM:
            end -= 1
        _ROW.pack_into(self._rows, _ROW.size * (end % ROOM), arrives_ms, *setpoint)
        self._end[0] = end + 1

    def set(self, setpoint: Setpoint, since_ms: int) -> None:
        """Apply a set-point, with its age counted from ``since_ms``; drop the set-points in transit."""
        self._first[0] = self._end[0]
        self._taken_ms[0] = since_ms
        self._setpoint[0] = setpoint
