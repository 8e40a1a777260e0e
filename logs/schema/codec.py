"""Fast CDR packers for the messages written every tick.

A ROS 2 message on the wire is a four-byte header and the fields in order, each aligned to its size. The
messages here have fixed layouts, so one ``struct`` call writes them whole: a generic codec takes ten times
as long. Tests hold every packer byte-equal with ``rosbags``.

Times are integer nanoseconds (Unix time, or simulated time from 2020-01-01 on in lockstep).
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from logs.schema.codec_log import LogRow, Severity, pack_log, unpack_log
from logs.schema.codec_mavlink import FrameError, pack_mavlink, unpack_mavlink

__all__ = [
    "CDR_HEADER",
    "ControllerStepRow",
    "FrameError",
    "LogRow",
    "LoopTimingRow",
    "Severity",
    "TrueStateRow",
    "pack_controller_step",
    "pack_log",
    "pack_loop_timing",
    "pack_mavlink",
    "pack_true_state",
    "unpack_controller_step",
    "unpack_log",
    "unpack_loop_timing",
    "unpack_mavlink",
    "unpack_true_state",
]

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]

CDR_HEADER = b"\x00\x01\x00\x00"  # plain CDR, little-endian, no options (OMG DDSI-RTPS 10.5)
_NS = 1_000_000_000  # nanoseconds in a second
_MAP = b"map\x00"  # the world frame of every message here

# Encapsulation, stamp, length and text of frame_id: 16 bytes of body, so what follows is aligned to 8.
_HEADER = "<4siII4s"
_CONTROLLER_STEP = struct.Struct(_HEADER + "Q8B32d3I2B2x4d")
_LOOP_TIMING = struct.Struct(_HEADER + "Q4d2I")
_TRUE_STATE = struct.Struct(_HEADER + "Q3d3d4d3d4d3d3d4dI4x7dB7x4d")


class ControllerStepRow(NamedTuple):
    """One controller step; fields, units and constants as in ``ControllerStep.msg``."""

    stamp_ns: int
    tick: int
    phase: int
    request: int
    filter_status: int
    gate: int
    setpoint_sent: bool
    barrier_active: bool
    own_valid: bool
    target_valid: bool
    own_age_s: float
    target_age_s: float
    own_position_enu_m: Vec3
    own_velocity_enu_m_s: Vec3
    own_yaw_rad: float
    target_position_enu_m: Vec3
    target_velocity_enu_m_s: Vec3
    target_yaw_rad: float
    h_m: float
    gradient: Vec3
    dh_dt_m_s: float
    nominal_enu_m_s: Vec3
    filtered_enu_m_s: Vec3
    command_enu_m_s: Vec3
    slack_m_s: float
    residual: float
    iterations: int
    target_accepted: int
    target_rejected: int
    link_valid: bool = False
    finished: bool = False
    wanted_enu_m_s: Vec3 = (math.nan, math.nan, math.nan)
    command_yaw_rad: float = math.nan


class LoopTimingRow(NamedTuple):
    """Wall-clock behaviour of one tick; fields and units as in ``LoopTiming.msg``."""

    stamp_ns: int
    tick: int
    period_s: float
    lateness_s: float
    exec_s: float
    solve_s: float
    overruns: int
    feed_dropped: int


class TrueStateRow(NamedTuple):
    """True state of the simulator; fields, units and constants as in ``TrueState.msg``."""

    stamp_ns: int
    tick: int
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    orientation_xyzw: Vec4  # body FLU to world ENU; ROS order, scalar last
    angular_velocity_flu_rad_s: Vec3
    rotor_rpm: Vec4
    pad_position_enu_m: Vec3
    pad_velocity_enu_m_s: Vec3
    pad_yaw_rad: float
    h_m: float
    h_min_m: float
    h_min_outside_pad_m: float
    contacts: int
    first_touch_relative_position_enu_m: Vec3
    first_touch_relative_velocity_enu_m_s: Vec3
    first_touch_time_s: float
    motors_running: bool
    battery_v: float
    wind_enu_m_s: Vec3


def pack_controller_step(row: ControllerStepRow) -> bytes:
    """Return the step as CDR.

    Raises:
        struct.error: A number out of the range of its field.
    """
    (stamp_ns, tick, phase, request, status, gate, sent, active, own, target, own_age, target_age,
     own_p, own_v, own_yaw, target_p, target_v, target_yaw, h, gradient, dh_dt,
     nominal, filtered, command, slack, residual, iterations, accepted, rejected,
     link, finished, wanted, command_yaw) = row  # fmt: skip
    return _CONTROLLER_STEP.pack(
        CDR_HEADER, stamp_ns // _NS, stamp_ns % _NS, 4, _MAP,
        tick, phase, request, status, gate, sent, active, own, target, own_age, target_age,
        *own_p, *own_v, own_yaw, *target_p, *target_v, target_yaw, h, *gradient, dh_dt,
        *nominal, *filtered, *command, slack, residual, iterations, accepted, rejected,
        link, finished, *wanted, command_yaw,
    )  # fmt: skip


def unpack_controller_step(data: bytes) -> ControllerStepRow:
    """Return the step in a CDR payload of :func:`pack_controller_step`.

    Raises:
        ValueError: Wrong size or a frame other than "map".
    """
    f = _fields(_CONTROLLER_STEP, data, "ControllerStep")
    return ControllerStepRow(
        f[1] * _NS + f[2], f[5], f[6], f[7], f[8], f[9],
        bool(f[10]), bool(f[11]), bool(f[12]), bool(f[13]), f[14], f[15],
        f[16:19], f[19:22], f[22], f[23:26], f[26:29], f[29], f[30], f[31:34], f[34],
        f[35:38], f[38:41], f[41:44], f[44], f[45], f[46], f[47], f[48],
        bool(f[49]), bool(f[50]), f[51:54], f[54],
    )  # fmt: skip


def pack_loop_timing(row: LoopTimingRow) -> bytes:
    """Return the timing as CDR.

    Raises:
        struct.error: A number out of the range of its field.
    """
    return _LOOP_TIMING.pack(CDR_HEADER, row[0] // _NS, row[0] % _NS, 4, _MAP, *row[1:])


def unpack_loop_timing(data: bytes) -> LoopTimingRow:
    """Return the timing in a CDR payload of :func:`pack_loop_timing`.

    Raises:
        ValueError: Wrong size or a frame other than "map".
    """
    f = _fields(_LOOP_TIMING, data, "LoopTiming")
    return LoopTimingRow(f[1] * _NS + f[2], *f[5:])


def pack_true_state(row: TrueStateRow) -> bytes:
    """Return the true state as CDR.

    Raises:
        struct.error: A number out of the range of its field.
    """
    (stamp_ns, tick, p, v, q, omega, rpm, pad_p, pad_v, pad_yaw, h, h_min, h_min_outside, contacts,
     touch_p, touch_v, touch_s, running, battery, wind) = row  # fmt: skip
    return _TRUE_STATE.pack(
        CDR_HEADER, stamp_ns // _NS, stamp_ns % _NS, 4, _MAP,
        tick, *p, *v, *q, *omega, *rpm, *pad_p, *pad_v, pad_yaw, h, h_min, h_min_outside, contacts,
        *touch_p, *touch_v, touch_s, running, battery, *wind,
    )  # fmt: skip


def unpack_true_state(data: bytes) -> TrueStateRow:
    """Return the true state in a CDR payload of :func:`pack_true_state`.

    Raises:
        ValueError: Wrong size or a frame other than "map".
    """
    f = _fields(_TRUE_STATE, data, "TrueState")
    return TrueStateRow(
        f[1] * _NS + f[2], f[5], f[6:9], f[9:12], f[12:16], f[16:19], f[19:23], f[23:26], f[26:29],
        f[29], f[30], f[31], f[32], f[33], f[34:37], f[37:40], f[40], bool(f[41]), f[42], f[43:46],
    )  # fmt: skip


def _fields(layout: struct.Struct, data: bytes, name: str) -> tuple:  # type: ignore[type-arg]
    if len(data) != layout.size or data[:4] != CDR_HEADER or data[12:20] != b"\x04\x00\x00\x00" + _MAP:
        raise ValueError(
            f"not a {name} of this stack: {len(data)} bytes beginning with {bytes(data[:20]).hex()}; "
            f"expected {layout.size} bytes, little-endian CDR, frame 'map'"
        )
    return layout.unpack(data)
