"""PX4's parameters for a simulated vehicle: motor positions, hover thrust, gains.

PX4 scales its control allocation so that a roll or pitch command of 1 changes a motor by sqrt(1/2), a yaw
command of 1 by 1, and a thrust command of 1 sets all motors to 1 (ControlAllocationPseudoInverse.cpp). With n
= 4 equal motors of thrust F at arm l, rate loop (P + D s) and motor lag T, each axis follows

    J dw/dt = k u,  k = 4 sqrt(1/2) F l (roll, pitch)  or  4 F c (yaw, c = torque / thrust)
    T s^2 + (1 + D k/J) s + P k/J = 0

PX4 removes an axis from the allocation if the effectiveness of every motor on it is at most 0.05. With PX4's
own thrust coefficient the effectiveness of a small vehicle is below this limit. Because all four
coefficients are equal, only ratios count, so this module uses a larger coefficient.

The gains set the natural frequency of the rate loop to 1.3 / T and its damping ratio to 0.8. The bandwidth of
the attitude loop is a quarter of this natural frequency.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from sim.firmware.mixer import OFF
from sim.plant.params import Four, Params, Rotor
from sim.plant.rotors import MIX_YAW, POSITION_X, POSITION_Y
from sim.scenarios.tables import OdometryLink

PX4_OF_M = (0, 3, 1, 2)  # index of the PX4 output that drives M1..M4


def share(control: float) -> float:
    """Limit an output to the range 0 to 1; NaN, which PX4 sends for a stopped motor, gives 0."""
    return min(1.0, max(0.0, control)) if math.isfinite(control) else 0.0


def rotor_speeds(controls: Sequence[float], armed: bool, rotor: Rotor) -> Four:
    """Return the commanded speeds of M1..M4, rpm.

    With THR_MDL_FAC = 0 an output is a fraction of the highest thrust, as in PX4's allocation. Below the
    smallest thrust a motor stops. The vehicle's thrust map gives the speed, as for the simulated firmware.
    ``controls``: four or more outputs in PX4's order (HIL_ACTUATOR_CONTROLS).
    """
    if not armed:
        return OFF
    thrusts = (share(controls[i]) * rotor.thrust_max_n for i in PX4_OF_M)
    m1, m2, m3, m4 = (rotor.rpm(t) if t >= rotor.thrust_min_n else 0.0 for t in thrusts)
    return (m1, m2, m3, m4)


# yaw effectiveness of a Crazyflie: 20 * 0.00705 m = 0.141; PX4's coefficient 6.5 would give 0.046, below 0.05
THRUST_COEFFICIENT = 20.0
_MOTOR_1 = 101  # number of PX4's output function "Motor 1"
_NATURAL = 1.3  # product of the rate loop's natural frequency and the motor lag
_DAMPING = 0.8
_SLOWER = 4.0  # ratio of the rate loop's natural frequency to the attitude loop's bandwidth
_INTEGRAL_1_S = 1.3  # ratio of I to P, 1/s, as in PX4's defaults 0.2 and 0.15
_YAW_1_S, _YAW_ATTITUDE_1_S = 6.0, 2.0  # bandwidths of the loops of yaw rate and yaw, 1/s
_THRUST: dict[str, float] = {"THR_MDL_FAC": 0.0}  # outputs are fractions of the highest thrust
# parameters that the pre-flight check requires of every PX4 in a simulation without a radio
SAFE_PARAMETERS: dict[str, float] = {
    "COM_RC_IN_MODE": 4,  # 4: PX4 needs no stick input
    "COM_OBL_RC_ACT": 4,  # land when the set-points stop; the pre-flight check requires this
    "SYS_FAILURE_EN": 0,  # the simulation's default is 1, which the pre-flight check rejects
}
_SATELLITES: dict[str, float] = {
    "EKF2_GPS_P_NOISE": 0.02,  # standard deviation, m; the simulated receiver has an RTK fix
    "EKF2_HGT_REF": 1,  # the height comes from the receiver, because the barometer's noise is 0.1 m
}
_MOCAP: dict[str, float] = {
    "EKF2_EV_CTRL": 11,  # use horizontal and vertical position, and yaw
    "EKF2_HGT_REF": 3,  # the height comes from vision
    "EKF2_GPS_CTRL": 0,
    "EKF2_MAG_TYPE": 5,  # no magnetometer; the pose contains the yaw
    "SYS_HAS_GPS": 0,
    "COM_ARM_WO_GPS": 1,
}


def hover_share(params: Params) -> float:
    """Return the thrust of hover as fraction of the highest thrust."""
    return params.body.mass_kg * params.contact.gravity_m_s2 / (4.0 * params.rotor.thrust_max_n)


def torque_over_thrust_m(params: Params) -> float:
    """Return the ratio of drag torque to thrust of a rotor in hover, m."""
    rotor = params.rotor
    rpm = rotor.rpm(hover_share(params) * rotor.thrust_max_n)
    torque = (rotor.torque_linear_n_m_rpm + rotor.torque_square_n_m_rpm2 * rpm) * rpm
    return torque / rotor.thrust_n(rpm)


def parameters(params: Params, mocap: OdometryLink | None = None) -> dict[str, float]:
    """Return the parameters that differ from PX4's defaults (v1.16); ``mocap`` replaces the GNSS receiver."""
    rotor, (jx, jy, jz) = params.rotor, params.body.inertia_kg_m2
    ratio = torque_over_thrust_m(params)
    found: dict[str, float] = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 4}
    for ours, px4 in sorted(enumerate(PX4_OF_M), key=lambda pair: pair[1]):
        found[f"CA_ROTOR{px4}_PX"] = POSITION_X[ours] * rotor.arm_m
        found[f"CA_ROTOR{px4}_PY"] = -POSITION_Y[ours] * rotor.arm_m  # FRD: y points right
        found[f"CA_ROTOR{px4}_CT"] = THRUST_COEFFICIENT
        found[f"CA_ROTOR{px4}_KM"] = -MIX_YAW[ours] * ratio  # positive for a counter-clockwise rotor
    for px4 in range(4):
        found[f"PWM_MAIN_FUNC{px4 + 1}"] = _MOTOR_1 + px4
    found["MPC_THR_HOVER"] = hover_share(params)
    tilt = 4.0 * math.sqrt(0.5) * rotor.thrust_max_n * rotor.arm_m
    for axis, inertia in (("ROLL", jx), ("PITCH", jy)):
        found |= _rate_gains(axis, tilt / inertia, rotor.lag_s)
    yaw = 4.0 * rotor.thrust_max_n * ratio / jz
    found["MC_YAWRATE_P"] = _YAW_1_S / yaw
    found["MC_YAW_P"] = _YAW_ATTITUDE_1_S
    found |= _THRUST | SAFE_PARAMETERS
    found |= _SATELLITES if mocap is None else _MOCAP | {"EKF2_EV_DELAY": mocap.delay_s * 1e3}  # delay in ms
    return {name: value if isinstance(value, int) else round(value, 5) for name, value in found.items()}


def _rate_gains(axis: str, per_command: float, lag_s: float) -> dict[str, float]:
    natural_1_s = _NATURAL / lag_s
    p = natural_1_s**2 * lag_s / per_command
    return {
        f"MC_{axis}RATE_P": p,
        f"MC_{axis}RATE_I": _INTEGRAL_1_S * p,
        f"MC_{axis}RATE_D": (2.0 * _DAMPING * natural_1_s * lag_s - 1.0) / per_command,
        f"MC_{axis}_P": natural_1_s / _SLOWER,
    }


# Formats that pass parameters to PX4: environment variables of PX4's start script (rcS), an airframe file,
# PX4's console. The environment cannot set a parameter to PX4's own default if the simulation has a different
# default (SYS_FAILURE_EN).
FORMATS = {
    "env": "export PX4_PARAM_{}={}",
    "airframe": "param set-default {} {}",
    "console": "param set {} {}",
}


def parameter_text(params: Params, form: str, mocap: OdometryLink | None = None) -> str:
    """Return the parameters as lines in one of ``FORMATS``."""
    return "\n".join(FORMATS[form].format(*pair) for pair in parameters(params, mocap).items())
