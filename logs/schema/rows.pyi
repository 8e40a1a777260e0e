# Made from the message definitions by `python -m tests.unit.logs.row_stubs`; changes belong there.
# fmt: off
# ruff: noqa
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.ros2.codec import Field

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

ROWS: tuple[str, ...]
COLUMNS: tuple[str, ...]

def class_name(schema: str, end: str) -> str: ...
def value_name(field: Field) -> str: ...
def column_type(field: Field) -> str: ...
def column_fields(schema: str) -> list[tuple[str, str]]: ...

class ControllerStepRow(NamedTuple):
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
    link_valid: bool
    finished: bool
    wanted_enu_m_s: Vec3
    command_yaw_rad: float
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> ControllerStepRow: ...

class ControllerInputRow(NamedTuple):
    stamp_ns: int
    tick: int
    now_s: float
    operator: int
    command_failed: bool
    own_present: bool
    status_present: bool
    armed: bool
    mode: int
    landed: int
    ready_to_arm: bool
    status_arrival_s: float
    own_arrival_s: float
    own_source_time_s: float
    own_position_enu_m: Vec3
    own_velocity_enu_m_s: Vec3
    own_yaw_rad: float
    target_samples: tuple[tuple[str, str, float, float, Vec3, Vec3, float, float, float, float], ...]
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> ControllerInputRow: ...

class ControllerPowerRow(NamedTuple):
    stamp_ns: int
    tick: int
    told: bool
    arrival_s: float
    voltage_v: float
    throttle: float
    cos_tilt: float
    reserve: float
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> ControllerPowerRow: ...

class ControllerStateRow(NamedTuple):
    stamp_ns: int
    tick: int
    layout: str
    state: str
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> ControllerStateRow: ...

class ControllerNeighboursRow(NamedTuple):
    stamp_ns: int
    tick: int
    neighbours: tuple[tuple[int, float, float, Vec3, Vec3, Vec3, float, float, int, float, bool, Vec3, bool, Vec3, bytes], ...]
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> ControllerNeighboursRow: ...

class MemberStatusRow(NamedTuple):
    stamp_ns: int
    id: int
    process: int
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    wanted_enu_m_s: Vec3
    position_sigma_m: float
    intent: int
    claims: bool
    claim_ns: int
    pad_known: bool
    pad_position_enu_m: Vec3
    pad_velocity_enu_m_s: Vec3
    yields_to: bytes
    echoes: tuple[tuple[int, int, int], ...]
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> MemberStatusRow: ...

class FleetPairRow(NamedTuple):
    stamp_ns: int
    one: int
    other: int
    distance_min_m: float
    flying_distance_min_m: float
    ellipsoid_min: float
    violations: int
    inside_ms: int
    collided_ms: int
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> FleetPairRow: ...

class LoopTimingRow(NamedTuple):
    stamp_ns: int
    tick: int
    period_s: float
    lateness_s: float
    exec_s: float
    solve_s: float
    overruns: int
    feed_dropped: int
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> LoopTimingRow: ...

class TrueStateRow(NamedTuple):
    stamp_ns: int
    tick: int
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    orientation: Vec4
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
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> TrueStateRow: ...

class HealthRow(NamedTuple):
    stamp_ns: int
    tick: int
    own_age_s: float
    target_age_s: float
    link_age_s: float
    battery_v: float
    battery_share: float
    mode: int
    landed: int
    armed: bool
    ready_to_arm: bool
    own_valid: bool
    target_valid: bool
    link_valid: bool
    finished: bool
    target_accepted: int
    target_rejected: int
    overruns: int
    feed_dropped: int
    reason: str
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> HealthRow: ...

class LogRow(NamedTuple):
    stamp_ns: int
    level: int
    name: str
    msg: str
    file: str
    function: str
    line: int
    def pack(self) -> bytes: ...
    @staticmethod
    def unpack(data: bytes) -> LogRow: ...

@dataclass(frozen=True)
class ControllerStepColumns:
    t_s: Floats
    tick: Ints
    phase: Ints
    request: Ints
    filter_status: Ints
    gate: Ints
    setpoint_sent: Bools
    barrier_active: Bools
    own_valid: Bools
    target_valid: Bools
    own_age_s: Floats
    target_age_s: Floats
    own_position_enu_m: Floats
    own_velocity_enu_m_s: Floats
    own_yaw_rad: Floats
    target_position_enu_m: Floats
    target_velocity_enu_m_s: Floats
    target_yaw_rad: Floats
    h_m: Floats
    gradient: Floats
    dh_dt_m_s: Floats
    nominal_enu_m_s: Floats
    filtered_enu_m_s: Floats
    command_enu_m_s: Floats
    slack_m_s: Floats
    residual: Floats
    iterations: Ints
    target_accepted: Ints
    target_rejected: Ints
    link_valid: Bools
    finished: Bools
    wanted_enu_m_s: Floats
    command_yaw_rad: Floats

@dataclass(frozen=True)
class LoopTimingColumns:
    t_s: Floats
    tick: Ints
    period_s: Floats
    lateness_s: Floats
    exec_s: Floats
    solve_s: Floats
    overruns: Ints
    feed_dropped: Ints

@dataclass(frozen=True)
class TrueStateColumns:
    t_s: Floats
    tick: Ints
    position_enu_m: Floats
    velocity_enu_m_s: Floats
    orientation: Floats
    angular_velocity_flu_rad_s: Floats
    rotor_rpm: Floats
    pad_position_enu_m: Floats
    pad_velocity_enu_m_s: Floats
    pad_yaw_rad: Floats
    h_m: Floats
    h_min_m: Floats
    h_min_outside_pad_m: Floats
    contacts: Ints
    first_touch_relative_position_enu_m: Floats
    first_touch_relative_velocity_enu_m_s: Floats
    first_touch_time_s: Floats
    motors_running: Bools
    battery_v: Floats
    wind_enu_m_s: Floats
