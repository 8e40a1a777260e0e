"""The autopilots that the simulated vehicle plays: one server profile each.

PX4 1.16 (``px4_custom_mode.h``, ``Commander.cpp``, ``mavlink_receiver.cpp``) and ArduCopter 4.6
(``mode.h``, ``mode_guided.cpp``, ``GCS_Mavlink.cpp``), both also measured in their own SITL.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.profiles.autopilots import SITL_MARK
from bridge.mavlink.server.parameters import Parameter, Parameters
from bridge.mavlink.server.profile import CAPABILITIES, RELEASE, Code, FlightMode, ServerProfile
from sim.autopilot.parameters import ardupilot_parameters, px4_parameters

_M = dialect
# Hz; rates of PX4's own links, or what clients were measured to need. Missing: on request only.
DEFAULT_HZ: Mapping[int, float] = {
    _M.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    _M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    _M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    _M.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    _M.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    _M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    _M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    _M.MAVLINK_MSG_ID_ALTITUDE: 1.0,
    _M.MAVLINK_MSG_ID_VFR_HUD: 2.0,
    _M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.5,
    _M.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    _M.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 2.0,
    _M.MAVLINK_MSG_ID_ODOMETRY: 5.0,  # PX4's onboard link: 30; it is the costliest of all to pack
    _M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 1.0,
}
_SENSORS = (
    _M.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | _M.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | _M.MAV_SYS_STATUS_SENSOR_3D_MAG
    | _M.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | _M.MAV_SYS_STATUS_SENSOR_BATTERY
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedProfile(ServerProfile):
    """A server profile, with what the simulated vehicle needs besides."""

    parameters: Callable[[int], tuple[Parameter, ...]]  # by system id
    needs_origin: bool = False  # no position before SET_GPS_GLOBAL_ORIGIN, unless it starts in the air
    # parameter with the system id whose heartbeats are the ground station's; None: those of type GCS are
    station_id: str | None = None
    # what a person sets before this stack flies it, since the default is not safe (preflight/rules.py)
    set_before_flight: Mapping[str, float] = field(default_factory=dict)

    def new_parameters(self, system_id: int) -> Parameters:
        """Parameters with their defaults: those on the wire, and the simulator's own behind them."""
        return Parameters(self.parameters(system_id), px4_parameters(system_id), bytewise=self.bytewise)


PX4 = SimulatedProfile(
    name="px4", mark=SITL_MARK, sensors=_SENSORS, rates_hz=DEFAULT_HZ, parameters=px4_parameters
)

_GUIDED = 4
_BASE = _M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | _M.MAV_MODE_FLAG_STABILIZE_ENABLED
# ArduPilot has the number of the mode alone; GUIDED is two of ours. Our hold needs no sticks, as BRAKE.
_ARDUPILOT_CODES: Mapping[FlightMode, Code] = {
    FlightMode.HOLD: Code(17, 0, _BASE),  # BRAKE
    FlightMode.TAKEOFF: Code(_GUIDED, 0, _BASE | _M.MAV_MODE_FLAG_GUIDED_ENABLED),
    FlightMode.LAND: Code(9, 0, _BASE),
    FlightMode.RETURN: Code(6, 0, _BASE | _M.MAV_MODE_FLAG_GUIDED_ENABLED),  # RTL
    FlightMode.OFFBOARD: Code(_GUIDED, 0, _BASE | _M.MAV_MODE_FLAG_GUIDED_ENABLED),
}
_ARDUPILOT_MODES = {code.main: mode for mode, code in _ARDUPILOT_CODES.items()}
_ARDUPILOT_STICKS = {0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 5: "LOITER", 11: "DRIFT", 13: "SPORT",
                     15: "AUTOTUNE", 16: "POSHOLD"}  # fmt: skip


def _ardupilot_why(number: int, _sub: int) -> str:
    name = _ARDUPILOT_STICKS.get(number)
    reason = f"{name}: no stick input" if name is not None else "there is none here"
    return f"Mode change to {number} failed: {reason}"


_ARDUPILOT_STREAMS: dict[int, tuple[int, ...]] = {
    _M.MAV_DATA_STREAM_EXTENDED_STATUS: (
        _M.MAVLINK_MSG_ID_SYS_STATUS,
        _M.MAVLINK_MSG_ID_GPS_RAW_INT,
        _M.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    ),
    _M.MAV_DATA_STREAM_POSITION: (
        _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        _M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    ),
    _M.MAV_DATA_STREAM_RAW_CONTROLLER: (_M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,),
    _M.MAV_DATA_STREAM_EXTRA1: (_M.MAVLINK_MSG_ID_ATTITUDE,),
    _M.MAV_DATA_STREAM_EXTRA2: (_M.MAVLINK_MSG_ID_VFR_HUD,),
    _M.MAV_DATA_STREAM_EXTRA3: (_M.MAVLINK_MSG_ID_BATTERY_STATUS, _M.MAVLINK_MSG_ID_SYSTEM_TIME),
}

ARDUPILOT = SimulatedProfile(
    name="ardupilot",
    mark=SITL_MARK,
    sensors=_SENSORS,
    autopilot=_M.MAV_AUTOPILOT_ARDUPILOTMEGA,
    version=4 << 24 | 6 << 16 | RELEASE,
    capabilities=CAPABILITIES,
    codes=_ARDUPILOT_CODES,
    custom_mode=lambda code: code.main,
    pair_of=lambda custom_mode: (custom_mode, 0),
    mode_of_pair=lambda number, _sub: _ARDUPILOT_MODES.get(number),
    why_no_mode=_ardupilot_why,
    refused=_M.MAV_RESULT_FAILED,
    parameters=ardupilot_parameters,
    bytewise=False,
    long_frame=_M.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    frames={
        _M.MAV_FRAME_LOCAL_NED: False,
        _M.MAV_FRAME_LOCAL_OFFSET_NED: False,
        _M.MAV_FRAME_BODY_NED: True,
        _M.MAV_FRAME_BODY_OFFSET_NED: True,
    },
    guided=True,
    needs_origin=True,
    rates_hz=MappingProxyType({}),  # all SRx_ rates are 0: but the heartbeat, everything must be asked for
    every_tick=(),
    labels={
        FlightMode.HOLD: "BRAKE",
        FlightMode.TAKEOFF: "GUIDED",
        FlightMode.LAND: "LAND",
        FlightMode.RETURN: "RTL",
        FlightMode.OFFBOARD: "GUIDED",
    },
    set_before_flight={"GUID_TIMEOUT": 0.5, "FS_GCS_ENABLE": 5.0, "SYSID_MYGCS": 1.0},
    station_id="SYSID_MYGCS",
    data_streams={
        **_ARDUPILOT_STREAMS,
        _M.MAV_DATA_STREAM_ALL: tuple(id_ for group in _ARDUPILOT_STREAMS.values() for id_ in group),
    },
)

PROFILES: Mapping[str, SimulatedProfile] = {p.name: p for p in (PX4, ARDUPILOT)}
