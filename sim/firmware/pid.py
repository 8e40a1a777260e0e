"""The Crazyflie's PID cascade: position and velocity at 100 Hz, attitude and rate at 500 Hz.

The cascade follows firmware position_controller_pid.c, attitude_pid_controller.c, controller_pid.c and pid.c,
with gains of platform_defaults_cf2.h. Angles are in degrees, as in the firmware. All axes are FLU: the
firmware's inverted pitch cancels. Position set-points use the position loop, velocity set-points do not; the
velocity in a position set-point is ignored. A change between the two kinds changes the mode. As in the
firmware, the velocity loop has an integral limit of 5000 (so the integral winds up), thrust in flight is at
least 20000 counts, and the D-term uses the measurement. A change of mode or zero thrust sets all integrals
and the last rates of the rate loops to zero, so the derivative in the rate loops has one peak.
"""

from __future__ import annotations

import math
from typing import Annotated

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Record, new
from flightstack.core.types import Vec3
from sim.firmware.geometric import Counts
from sim.firmware.setpoint import SensedState, SetpointRecord
from sim.plant.params import CONTROL_STEP_S, Params

POSITION_EVERY = 5  # number of control steps per position step; stabilizer_types.h: POSITION_RATE 100 Hz
POSITION_STEP_S = POSITION_EVERY * CONTROL_STEP_S
LATE_MAX = 60  # maximum number of set-points in the dead time of a loop, 0.6 s
SPEED_MAX_M_S = 1.1 * 1.0  # speed limit of the position loop: velMaxOverhead * PID_POS_VEL_X_MAX, each axis
TILT_MAX_DEG = 20.0  # upper limit of the commanded tilt: PID_VEL_ROLL_MAX, PID_VEL_PITCH_MAX
THRUST_BASE = 36000.0  # thrust without velocity error, counts: PID_VEL_THRUST_BASE
THRUST_MIN = 20000.0  # lower limit of the thrust in flight, counts: PID_VEL_THRUST_MIN
THRUST_SCALE = 1000.0  # counts per output of the velocity loop: thrustScale (position_controller_pid.c)
COUNTS_MAX = 65535.0
INT16_MAX = 32767.0
DEG = 180.0 / math.pi


class PidRecord(Record):
    """Gains, limits and state of one PID of pid.c."""

    kp: float
    ki: float
    kd: float
    i_limit: float
    dt: float  # time step, s
    limit: float  # limit of the output
    integral: float
    previous: float  # last measured value, for the D-term; NaN before the first


@jitted
def pid_output(p: PidRecord, error: float, measured: float) -> float:
    """Return the output for an error; the D-term uses ``measured``."""
    p.integral = max(-p.i_limit, min(p.i_limit, p.integral + error * p.dt))
    out = p.kp * error + p.ki * p.integral
    if p.kd != 0.0:
        if not math.isnan(p.previous):
            out -= p.kd * (measured - p.previous) / p.dt
        p.previous = measured
    return max(-p.limit, min(p.limit, out))


def pid_record(
    kp: float, ki: float, kd: float, i_limit: float, dt: float, limit: float = math.inf
) -> PidRecord:
    return new(PidRecord, (kp, ki, kd, i_limit, dt, limit, 0.0, math.nan))


class CascadeRecord(Record):
    """The twelve PIDs and their common state."""

    x: PidRecord  # loop from position to velocity; x and y in the frame turned by yaw
    y: PidRecord
    z: PidRecord
    vx: PidRecord  # loop from velocity in the yaw frame to tilt, degrees
    vy: PidRecord
    vz: PidRecord  # loop from velocity to thrust
    roll: PidRecord  # loop from angle to rate, degrees
    pitch: PidRecord
    yaw: PidRecord
    roll_rate: PidRecord  # loop from rate to counts
    pitch_rate: PidRecord
    yaw_rate: PidRecord
    calls: int  # number of calls since the last reset
    mode: int  # LEVEL, FREE, TO_POSITION or UNKNOWN
    late: Annotated[F64, 2 * LATE_MAX]  # ring buffer of horizontal velocity set-points, one per loop call
    late_calls: int  # number of calls of the loop between a set-point and its effect
    response: float  # ratio of the loop's target velocity to the set-point
    tilt_share: float  # gain of the low-pass on the tilt command; 1: no low-pass
    roll_wanted: float  # commanded roll, degrees
    pitch_wanted: float  # commanded pitch, degrees
    thrust_wanted: float  # commanded thrust, counts


UNKNOWN, FREE, LEVEL, TO_POSITION = -1, 0, 1, 2


@jitted
def cascade_reset(c: CascadeRecord) -> None:
    for pid in (
        c.x, c.y, c.z, c.vx, c.vy, c.vz, c.roll, c.pitch, c.yaw, c.roll_rate, c.pitch_rate, c.yaw_rate,
    ):  # fmt: skip
        pid.integral, pid.previous = 0.0, math.nan
    c.roll_rate.previous = c.pitch_rate.previous = c.yaw_rate.previous = 0.0  # attitudeControllerResetAllPID
    c.calls = 0
    c.late[:] = 0.0


@jitted
def clamp(value: float, limit: float) -> float:
    """Limit a value to the range -``limit`` to ``limit``."""
    return max(-limit, min(limit, value))


@jitted
def continued(before: float, angle: float) -> float:
    """Shift an angle by the multiple of 360 degrees that brings it next to ``before``; NaN: no shift."""
    if math.isnan(before):
        return angle
    turn = angle - before + 180.0
    return before + turn - 360.0 * math.floor(turn / 360.0) - 180.0


@jitted
def velocity_pids(
    c: CascadeRecord, position: F64, velocity: F64, setpoint: SetpointRecord, yaw: float
) -> None:
    """Compute tilt and thrust commands (100 Hz)."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    vx, vy = c.response * setpoint.vx, c.response * setpoint.vy
    if c.late_calls > 0:
        at = 2 * (c.calls // POSITION_EVERY % c.late_calls)
        vx, vy, c.late[at], c.late[at + 1] = c.late[at], c.late[at + 1], vx, vy
    if setpoint.by_position:
        ex, ey = setpoint.x - position[0], setpoint.y - position[1]
        ahead = pid_output(c.x, cos * ex + sin * ey, 0.0) - (cos * velocity[0] + sin * velocity[1])
        aside = pid_output(c.y, cos * ey - sin * ex, 0.0) - (cos * velocity[1] - sin * velocity[0])
        up = pid_output(c.z, setpoint.z - position[2], 0.0)
    else:
        ex, ey = vx - velocity[0], vy - velocity[1]
        ahead, aside, up = cos * ex + sin * ey, cos * ey - sin * ex, setpoint.vz
    pitch = clamp(pid_output(c.vx, ahead, 0.0), TILT_MAX_DEG)
    roll = clamp(-pid_output(c.vy, aside, 0.0), TILT_MAX_DEG)
    if c.tilt_share < 1.0:
        pitch = c.pitch_wanted + c.tilt_share * (pitch - c.pitch_wanted)
        roll = c.roll_wanted + c.tilt_share * (roll - c.roll_wanted)
    c.pitch_wanted, c.roll_wanted = pitch, roll
    thrust = THRUST_SCALE * pid_output(c.vz, up - velocity[2], 0.0) + THRUST_BASE
    c.thrust_wanted = max(THRUST_MIN, min(COUNTS_MAX, thrust))


@jitted
def cascade_update(
    c: CascadeRecord, sensed: SensedState, setpoint: SetpointRecord, level: bool
) -> tuple[float, Counts]:
    """Return ``(thrust counts per motor, moment counts)``; ``level``: command zero roll and pitch."""
    mode = LEVEL if level else TO_POSITION if setpoint.by_position else FREE
    if c.mode != mode:  # controller_pid.c: a change of mode resets all PIDs
        cascade_reset(c)
        c.mode = mode
    axes = sensed.axes
    yaw = math.atan2(axes[1], axes[0])
    if c.calls % POSITION_EVERY == 0:
        velocity_pids(c, sensed.position, sensed.velocity, setpoint, yaw)
    c.calls += 1
    roll_wanted, pitch_wanted = (0.0, 0.0) if level else (c.roll_wanted, c.pitch_wanted)
    roll = math.atan2(axes[5], axes[8]) * DEG
    pitch = -math.asin(clamp(axes[2], 1.0)) * DEG
    error = setpoint.yaw_rad - yaw
    yaw_error = math.atan2(math.sin(error), math.cos(error)) * DEG
    wx, wy, wz = sensed.rates[0] * DEG, sensed.rates[1] * DEG, sensed.rates[2] * DEG
    rx = pid_output(c.roll, roll_wanted - roll, roll) - wx
    ry = pid_output(c.pitch, pitch_wanted - pitch, pitch) - wy
    rz = pid_output(c.yaw, yaw_error, continued(c.yaw.previous, yaw * DEG)) - wz
    return c.thrust_wanted, (
        int(clamp(pid_output(c.roll_rate, rx, wx), INT16_MAX)),
        int(clamp(pid_output(c.pitch_rate, ry, wy), INT16_MAX)),
        int(clamp(pid_output(c.yaw_rate, rz, wz), INT16_MAX)),
    )


def set_up_cascade(c: CascadeRecord, params: Params) -> None:
    slow, fast = POSITION_STEP_S, CONTROL_STEP_S
    g = params.velocity_gains
    # values of the firmware's PID_POS_*, PID_VEL_*, PID_ROLL*, PID_PITCH* and PID_YAW*
    c.x = pid_record(2.0, 0.0, 0.0, 5000.0, slow, SPEED_MAX_M_S)
    c.y = pid_record(2.0, 0.0, 0.0, 5000.0, slow, SPEED_MAX_M_S)
    c.z = pid_record(2.0, 0.5, 0.0, 5000.0, slow, SPEED_MAX_M_S)
    c.vx = pid_record(g.xy_p, g.xy_i, 0.0, 5000.0, slow, 1.1 * TILT_MAX_DEG)
    c.vy = pid_record(g.xy_p, g.xy_i, 0.0, 5000.0, slow, 1.1 * TILT_MAX_DEG)
    c.vz = pid_record(g.z_p, g.z_i, 0.0, 5000.0, slow, 32.767)  # limit: UINT16_MAX / 2 / thrustScale
    c.roll = pid_record(6.0, 3.0, 0.0, 20.0, fast)
    c.pitch = pid_record(6.0, 3.0, 0.0, 20.0, fast)
    c.yaw = pid_record(6.0, 1.0, 0.35, 360.0, fast)
    c.roll_rate = pid_record(250.0, 500.0, 2.5, 33.3, fast)
    c.pitch_rate = pid_record(250.0, 500.0, 2.5, 33.3, fast)
    c.yaw_rate = pid_record(120.0, 16.7, 0.0, 166.7, fast)
    c.mode = UNKNOWN
    c.late_calls, c.response = round(g.xy_dead_time_s / slow), g.xy_response
    c.tilt_share = slow / max(slow, g.tilt_time_s)


def cascade_trim(c: CascadeRecord, force: Vec3, counts_per_n: float, moments: Counts) -> None:
    """Set the integrals for hover with ``force`` (world, N) at yaw 0; ``moments``: for unequal motors."""
    c.mode = FREE
    thrust = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    c.vx.integral = math.atan2(force[0], force[2]) * DEG / c.vx.ki
    c.vy.integral = math.asin(force[1] / thrust) * DEG / c.vy.ki
    c.vz.integral = (thrust * counts_per_n - THRUST_BASE) / THRUST_SCALE / c.vz.ki
    for pid, moment in zip((c.roll_rate, c.pitch_rate, c.yaw_rate), moments, strict=True):
        pid.integral = moment / pid.ki
