"""The autopilots that the simulated vehicle plays: their parameters, and one server profile each.

PX4 1.18 (``px4_custom_mode.h``, ``Commander.cpp``, ``mavlink_receiver.cpp``) and ArduCopter 4.6 (``mode.h``,
``mode_guided.cpp``, ``GCS_Mavlink.cpp``, ``Parameters.cpp``), both also measured in their own SITL. The
simulator's own parameters have PX4's names and units. Each of ArduCopter's stands for one or more of them;
the defaults are ArduCopter's where they fit into a room. The fixed ones say what the simulator does, or mean
nothing here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.profiles.autopilots import SITL_MARK
from bridge.mavlink.server.parameters import REAL32, Parameter, Parameters, fixed, integer, one_of, real
from bridge.mavlink.server.profile import CAPABILITIES, RELEASE, Code, FlightMode, ServerProfile

_INT8 = dialect.MAV_PARAM_TYPE_INT8
_INT16 = dialect.MAV_PARAM_TYPE_INT16
_INT32 = dialect.MAV_PARAM_TYPE_INT32
_CM = 100.0  # cm in a metre

# The fixed ones mean nothing here: QGroundControl's PX4 plug-in wants to find them (PX4
# mavlink_parameters.cpp, list in send()).
_FOR_QGROUNDCONTROL = (
    *(fixed(f"CAL_MAG{i}_{kind}", 0) for i in range(4) for kind in ("ID", "ROT")),
    *(fixed(name, 0) for name in ("CAL_ACC0_ID", "CAL_GYRO0_ID", "SENS_BOARD_ROT", "TRIG_MODE")),
    *(fixed(name, 0) for name in ("UAVCAN_ENABLE", "SYS_AUTOSTART")),
    *(
        Parameter(name, REAL32, 0.0, 0.0, 0.0)
        for name in ("SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF", "SENS_DPRES_OFF")
    ),
    fixed("SYS_PARAM_VER", 1),
)

# Values of the ..._ACT parameters: tables in sim.autopilot.watches.
_OWN = (
    real("COM_OF_LOSS_T", 0.5, 0.1, 5.0),  # s, silence of the companion before COM_OBL_RC_ACT
    one_of("COM_OBL_RC_ACT", 4, 0, 3, 4, 5),  # then: land, return, land, hold
    real("COM_DISARM_LAND", 2.0, 0.1, 20.0),  # s, PX4's default
    real("COM_DISARM_PRFLT", 10.0, 1.0, 120.0),  # s, PX4's default
    fixed("COM_RC_IN_MODE", 4),  # no stick input
    fixed("MAN_OVERRIDE_SPD", -1.0, REAL32),  # sticks never take over
    # warn; land when critical; twice return, and land in emergency: it does not estimate the time left
    one_of("COM_LOW_BAT_ACT", 0, 0, 2, 3, 5),
    integer("COM_DL_LOSS_T", 10, 1, 300),  # s without a ground station's heartbeat before NAV_DLL_ACT
    one_of("NAV_DLL_ACT", 0, 0, 1, 2, 3),  # then: nothing, hold, return, land
    real("BAT_LOW_THR", 0.15, 0.12, 0.5),  # share of charge; these three are PX4's
    real("BAT_CRIT_THR", 0.07, 0.05, 0.5),
    real("BAT_EMERGEN_THR", 0.05, 0.03, 0.5),
    real("BAT1_V_EMPTY", 3.5, 2.5, 4.0),  # V at rest; the simulated cell's
    real("BAT1_V_CHARGED", 4.15, 3.5, 4.35),  # V at rest
    real("BAT1_V_LOAD_DROP", 0.37, 0.0, 1.0),  # V at full throttle; 0.25 V in hover at 0.67
    one_of("GF_ACTION", 2, 0, 1, 2, 3, 5),  # outside: nothing, warn, hold, return, land
    real("GF_MAX_HOR_DIST", 0.0, 0.0, 10000.0),  # m from home; 0: no limit
    real("GF_MAX_VER_DIST", 0.0, 0.0, 10000.0),  # m above home; 0: no limit
    real("RTL_RETURN_ALT", 1.0, 0.1, 20.0),  # m above home, on the way back
    real("RTL_MIN_DIST", 0.3, 0.0, 20.0),  # m; nearer to home it lands where it is
    real("RTL_LAND_DELAY", 0.0, 0.0, 60.0),  # s over home before it lands
    integer("SYS_FAILURE_EN", 0, 0, 1),  # command 420 may let things fail
    real("MIS_TAKEOFF_ALT", 0.5, 0.1, 20.0, in_flight=True),  # m above where it stands
    real("MPC_TKO_SPEED", 0.5, 0.1, 1.0, in_flight=True),  # m/s
    real("MPC_LAND_SPEED", 0.3, 0.1, 0.8, in_flight=True),  # m/s
    real("MPC_XY_CRUISE", 0.5, 0.1, 2.0, in_flight=True),  # m/s, highest when flying by itself
    # m/s; set-points are clipped to these. The defaults are never met: above 5 m/s a set-point is refused.
    real("MPC_XY_VEL_MAX", 5.0, 0.1, 20.0),
    real("MPC_Z_VEL_MAX_UP", 5.0, 0.1, 8.0),
    real("MPC_Z_VEL_MAX_DN", 5.0, 0.1, 8.0),
    real("MPC_XY_P", 1.0, 0.1, 2.0, in_flight=True),  # 1/s
    real("MPC_Z_P", 1.0, 0.1, 1.5, in_flight=True),  # 1/s
    fixed("MAV_COMP_ID", dialect.MAV_COMP_ID_AUTOPILOT1),
    fixed("MAV_TYPE", dialect.MAV_TYPE_QUADROTOR),
)


def px4_parameters(system_id: int) -> tuple[Parameter, ...]:
    """All parameters under PX4's names, by name."""
    all_ = (*_OWN, *_FOR_QGROUNDCONTROL, fixed("MAV_SYS_ID", system_id))
    return tuple(sorted(all_, key=lambda parameter: parameter.name))


def _speed(name: str, inside: str, default_cm_s: float, high_cm_s: float) -> Parameter:
    return Parameter(name, REAL32, default_cm_s, 10.0, high_cm_s, True, stands_for=(inside,), scale=_CM)


def _action(name: str, inside: str, meanings: dict[int, int]) -> Parameter:
    choices = tuple(meanings)
    return Parameter(
        name,
        _INT8,
        choices[0],
        choices[0],
        choices[-1],
        choices=choices,
        stands_for=(inside,),
        meanings=meanings,
    )


_ARDUPILOT = (
    # s without set-points until it stops
    Parameter("GUID_TIMEOUT", REAL32, 3.0, 0.1, 5.0, True, stands_for=("COM_OF_LOSS_T",)),
    fixed("GUID_OPTIONS", 0, _INT32),
    # s armed on the ground
    Parameter("DISARM_DELAY", _INT8, 10, 1, 120, stands_for=("COM_DISARM_PRFLT", "COM_DISARM_LAND")),
    _action("FS_GCS_ENABLE", "NAV_DLL_ACT", {0: 0, 1: 2, 5: 3}),  # nothing; RTL; land
    Parameter("FS_GCS_TIMEOUT", REAL32, 5.0, 2.0, 120.0, stands_for=("COM_DL_LOSS_T",)),  # s
    fixed("FS_THR_ENABLE", 0, _INT8),  # no radio
    fixed("FS_EKF_ACTION", 1, _INT8),  # land
    fixed("FS_EKF_THRESH", 0.8, REAL32),
    fixed("FS_CRASH_CHECK", 1, _INT8),
    fixed("FS_OPTIONS", 0, _INT32),
    fixed("BATT_FS_LOW_ACT", 0, _INT8),
    _action("BATT_FS_CRT_ACT", "COM_LOW_BAT_ACT", {0: 0, 1: 2, 2: 3}),  # nothing; land; RTL
    fixed("FENCE_ENABLE", 0, _INT8),
    fixed("ARMING_CHECK", 1, _INT32),
    Parameter("SYSID_MYGCS", _INT16, 255, 1, 255),  # whose heartbeats FS_GCS_ENABLE minds
    fixed("SYSID_ENFORCE", 0, _INT8),
    fixed("FRAME_CLASS", 1, _INT8),
    fixed("WP_YAW_BEHAVIOR", 2, _INT8),
    _speed("WPNAV_SPEED", "MPC_XY_VEL_MAX", 500.0, 2000.0),  # cm/s
    _speed("WPNAV_SPEED_UP", "MPC_Z_VEL_MAX_UP", 250.0, 800.0),
    _speed("WPNAV_SPEED_DN", "MPC_Z_VEL_MAX_DN", 150.0, 500.0),
    fixed("WPNAV_ACCEL", 500, REAL32),  # cm/s^2: the highest, the simulator limits no acceleration
    fixed("WPNAV_ACCEL_Z", 500, REAL32),
    _speed("LAND_SPEED", "MPC_LAND_SPEED", 30.0, 80.0),
    Parameter("RTL_ALT", _INT32, 100, 10, 2000, stands_for=("RTL_RETURN_ALT",), scale=_CM),
)


def ardupilot_parameters(system_id: int) -> tuple[Parameter, ...]:
    """All parameters under ArduCopter's names."""
    return (*_ARDUPILOT, fixed("SYSID_THISMAV", system_id, _INT16))


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
    # what a person sets before this stack flies it, since the default is not safe (bridge/mavlink/preflight)
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


GUIDED = frozenset({FlightMode.OFFBOARD, FlightMode.TAKEOFF})


def why_no_takeoff(
    mode: FlightMode, name: str, armed: bool, standing: bool, height_m: float | None, aim_m: float, z_m: float
) -> str | None:
    """Why GUIDED does not take off now, None if it does (ArduPilot mode_guided.cpp, takeoff.cpp).

    Heights are local: ``aim_m`` is that of a take-off under way, ``z_m`` the vehicle's.
    """
    if mode is FlightMode.TAKEOFF and height_m == aim_m and standing:
        return None  # the command again
    if mode not in GUIDED:
        return f"Take-off refused: mode is {name}, GUIDED is needed"
    if not armed:
        return "Take-off refused: not armed"
    if not standing:
        return "Take-off refused: in the air"
    if height_m is None or height_m <= z_m:
        return "Take-off refused: a height above the vehicle is needed"
    return None
