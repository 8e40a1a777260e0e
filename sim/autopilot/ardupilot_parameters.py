"""Parameters of the simulated autopilot under ArduCopter's names and units (Parameters.cpp, 4.6).

Each stands for one or more of the simulator's own, which have PX4's names; the defaults are ArduCopter's
where they fit into a room. The fixed ones say what the simulator does, or mean nothing here.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.autopilot.parameters import REAL32, Parameter

_INT8 = dialect.MAV_PARAM_TYPE_INT8
_INT16 = dialect.MAV_PARAM_TYPE_INT16
_INT32 = dialect.MAV_PARAM_TYPE_INT32
_CM = 100.0  # cm in a metre


def _fixed(name: str, value: float, type_: int) -> Parameter:
    return Parameter(name, type_, value, value, value)


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


_ROWS = (
    # s without set-points until it stops
    Parameter("GUID_TIMEOUT", REAL32, 3.0, 0.1, 5.0, True, stands_for=("COM_OF_LOSS_T",)),
    _fixed("GUID_OPTIONS", 0, _INT32),
    # s armed on the ground
    Parameter("DISARM_DELAY", _INT8, 10, 1, 120, stands_for=("COM_DISARM_PRFLT", "COM_DISARM_LAND")),
    _action("FS_GCS_ENABLE", "NAV_DLL_ACT", {0: 0, 1: 2, 5: 3}),  # nothing; RTL; land
    Parameter("FS_GCS_TIMEOUT", REAL32, 5.0, 2.0, 120.0, stands_for=("COM_DL_LOSS_T",)),  # s
    _fixed("FS_THR_ENABLE", 0, _INT8),  # no radio
    _fixed("FS_EKF_ACTION", 1, _INT8),  # land
    _fixed("FS_EKF_THRESH", 0.8, REAL32),
    _fixed("FS_CRASH_CHECK", 1, _INT8),
    _fixed("FS_OPTIONS", 0, _INT32),
    _fixed("BATT_FS_LOW_ACT", 0, _INT8),
    _action("BATT_FS_CRT_ACT", "COM_LOW_BAT_ACT", {0: 0, 1: 2, 2: 3}),  # nothing; land; RTL
    _fixed("FENCE_ENABLE", 0, _INT8),
    _fixed("ARMING_CHECK", 1, _INT32),
    Parameter("SYSID_MYGCS", _INT16, 255, 1, 255),  # whose heartbeats FS_GCS_ENABLE minds
    _fixed("SYSID_ENFORCE", 0, _INT8),
    _fixed("FRAME_CLASS", 1, _INT8),
    _fixed("WP_YAW_BEHAVIOR", 2, _INT8),
    _speed("WPNAV_SPEED", "MPC_XY_VEL_MAX", 500.0, 2000.0),  # cm/s
    _speed("WPNAV_SPEED_UP", "MPC_Z_VEL_MAX_UP", 250.0, 800.0),
    _speed("WPNAV_SPEED_DN", "MPC_Z_VEL_MAX_DN", 150.0, 500.0),
    _fixed("WPNAV_ACCEL", 500, REAL32),  # cm/s^2: the highest, the simulator limits no acceleration
    _fixed("WPNAV_ACCEL_Z", 500, REAL32),
    _speed("LAND_SPEED", "MPC_LAND_SPEED", 30.0, 80.0),
    Parameter("RTL_ALT", _INT32, 100, 10, 2000, stands_for=("RTL_RETURN_ALT",), scale=_CM),
)


def ardupilot_table(system_id: int) -> tuple[Parameter, ...]:
    """All parameters, by name; the order is their index on the wire."""
    all_ = (*_ROWS, _fixed("SYSID_THISMAV", system_id, _INT16))
    return tuple(sorted(all_, key=lambda parameter: parameter.name))
