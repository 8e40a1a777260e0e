"""Parameters of the simulated autopilot, with PX4's names, units and values.

Fixed parameters describe the simulator's behaviour or have no effect.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.server.parameters import REAL32, Parameter, fixed, integer, one_of, real

# These have no effect, but QGroundControl's PX4 plug-in requires them (PX4 mavlink_parameters.cpp, list in
# send()).
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

# A table in sim.autopilot.flight maps the values of COM_OBL_RC_ACT to modes.
_OWN = (
    real("COM_OF_LOSS_T", 0.5, 0.1, 5.0),  # s without a set-point before COM_OBL_RC_ACT applies
    one_of("COM_OBL_RC_ACT", 4, 0, 4, 5),  # action on lost set-points: land, land, hold
    real("COM_DISARM_LAND", 2.0, 0.1, 20.0),  # s on the ground until it disarms; PX4's default
    real("COM_DISARM_PRFLT", 10.0, 1.0, 120.0),  # s without a take-off until it disarms; PX4's default
    fixed("COM_RC_IN_MODE", 4),  # no stick input
    fixed("MAN_OVERRIDE_SPD", -1.0, REAL32),  # stick input never overrides
    fixed("COM_LOW_BAT_ACT", 0),  # a low battery causes no action
    fixed("NAV_DLL_ACT", 0),  # a lost ground station causes no action
    real("BAT1_V_EMPTY", 3.5, 2.5, 4.0),  # V at rest, of the simulated cell
    real("BAT1_V_CHARGED", 4.15, 3.5, 4.35),  # V at rest, of the simulated cell
    real("BAT1_V_LOAD_DROP", 0.37, 0.0, 1.0),  # voltage drop at full throttle, V; 0.25 V in hover at 0.67
    fixed("GF_ACTION", 0),  # there is no fence
    fixed("GF_MAX_HOR_DIST", 0.0, REAL32),
    fixed("GF_MAX_VER_DIST", 0.0, REAL32),
    integer("SYS_FAILURE_EN", 0, 0, 1),  # 1: command 420 may inject failures
    real("MIS_TAKEOFF_ALT", 0.5, 0.1, 20.0, in_flight=True),  # m above the take-off place
    real("MPC_TKO_SPEED", 0.5, 0.1, 1.0, in_flight=True),  # climb speed of the take-off, m/s
    real("MPC_LAND_SPEED", 0.3, 0.1, 0.8, in_flight=True),  # sink speed of the landing, m/s
    real("MPC_XY_CRUISE", 0.5, 0.1, 2.0, in_flight=True),  # m/s; largest speed in the autopilot's modes
    # Limits of set-points, m/s; faster ones are clipped. The defaults have no effect: set-points above 5 m/s
    # are rejected.
    real("MPC_XY_VEL_MAX", 5.0, 0.1, 20.0),
    real("MPC_Z_VEL_MAX_UP", 5.0, 0.1, 8.0),
    real("MPC_Z_VEL_MAX_DN", 5.0, 0.1, 8.0),
    real("MPC_XY_P", 1.0, 0.1, 2.0, in_flight=True),  # gain of the horizontal position loop, 1/s
    real("MPC_Z_P", 1.0, 0.1, 1.5, in_flight=True),  # gain of the height loop, 1/s
    fixed("MAV_COMP_ID", dialect.MAV_COMP_ID_AUTOPILOT1),
    fixed("MAV_TYPE", dialect.MAV_TYPE_QUADROTOR),
)


def px4_parameters(system_id: int) -> tuple[Parameter, ...]:
    all_ = (*_OWN, *_FOR_QGROUNDCONTROL, fixed("MAV_SYS_ID", system_id))
    return tuple(sorted(all_, key=lambda parameter: parameter.name))
