"""The Crazyflie's PID cascade: velocity at 100 Hz, attitude and rate at 500 Hz.

After firmware position_controller_pid.c, attitude_pid_controller.c, controller_pid.c and pid.c, gains of
platform_defaults_cf2.h. Angles in degrees inside, as there. FLU throughout: the firmware's inverted pitch
cancels.
Kept: no integral limit but 5000 in the velocity loop (so it winds up), thrust never below 20000 counts in
flight, derivative of the measurement, all integrals gone when the mode changes or the thrust is zero.
"""

from __future__ import annotations

import math

from flightstack.types import Vec3
from sim.firmware.attitude import Counts
from sim.firmware.setpoint import SensedState, Setpoint
from sim.params import CONTROL_STEP_S, Params

POSITION_EVERY = 5  # firmware stabilizer_types.h: POSITION_RATE 100 Hz
POSITION_STEP_S = POSITION_EVERY * CONTROL_STEP_S
TILT_MAX_DEG = 20.0  # PID_VEL_ROLL_MAX, PID_VEL_PITCH_MAX
THRUST_BASE = 36000.0  # counts, PID_VEL_THRUST_BASE
THRUST_MIN = 20000.0  # counts, PID_VEL_THRUST_MIN
THRUST_SCALE = 1000.0  # position_controller_pid.c: thrustScale
COUNTS_MAX = 65535.0
INT16_MAX = 32767.0
DEG = 180.0 / math.pi


class Pid:
    """One PID of pid.c."""

    __slots__ = ("_dt", "_i_limit", "_kd", "_ki", "_kp", "_limit", "_previous", "integral")

    def __init__(
        self, kp: float, ki: float, kd: float, i_limit: float, dt: float, limit: float = math.inf
    ) -> None:
        self._kp, self._ki, self._kd, self._i_limit, self._dt, self._limit = kp, ki, kd, i_limit, dt, limit
        self.integral = 0.0
        self._previous: float | None = None

    def reset(self) -> None:
        """Forget integral and previous measurement."""
        self.integral = 0.0
        self._previous = None

    def hold(self, output: float) -> None:
        """Set the integral so that this output comes at zero error."""
        self.integral = output / self._ki

    def update(self, error: float, measured: float) -> float:
        """Return the output for an error; ``measured`` feeds the derivative."""
        integral = self.integral + error * self._dt
        limit = self._i_limit
        self.integral = integral = max(-limit, min(limit, integral))
        out = self._kp * error + self._ki * integral
        if self._kd:
            if self._previous is not None:
                out -= self._kd * (measured - self._previous) / self._dt
            self._previous = measured
        return max(-self._limit, min(self._limit, out))


class PidLoop:
    """Velocity set-point in, thrust counts (per motor) and moment counts out; call at 500 Hz."""

    def __init__(self, params: Params) -> None:
        self._counts_per_n = COUNTS_MAX / (4.0 * params.rotor.thrust_max_n)
        slow, fast = POSITION_STEP_S, CONTROL_STEP_S
        self._vx = Pid(25.0, 1.0, 0.0, 5000.0, slow, 1.1 * TILT_MAX_DEG)  # PID_VEL_X
        self._vy = Pid(25.0, 1.0, 0.0, 5000.0, slow, 1.1 * TILT_MAX_DEG)  # PID_VEL_Y
        self._vz = Pid(25.0, 15.0, 0.0, 5000.0, slow, 32.767)  # PID_VEL_Z, UINT16_MAX / 2 / thrustScale
        self._roll = Pid(6.0, 3.0, 0.0, 20.0, fast)  # PID_ROLL
        self._pitch = Pid(6.0, 3.0, 0.0, 20.0, fast)  # PID_PITCH
        self._yaw = Pid(6.0, 1.0, 0.35, 360.0, fast)  # PID_YAW
        self._roll_rate = Pid(250.0, 500.0, 2.5, 33.3, fast)  # PID_ROLL_RATE
        self._pitch_rate = Pid(250.0, 500.0, 2.5, 33.3, fast)  # PID_PITCH_RATE
        self._yaw_rate = Pid(120.0, 16.7, 0.0, 166.7, fast)  # PID_YAW_RATE
        self._all = (
            self._vx, self._vy, self._vz, self._roll, self._pitch, self._yaw,
            self._roll_rate, self._pitch_rate, self._yaw_rate,
        )  # fmt: skip
        self._count = 0
        self._level: bool | None = None
        self._wanted = (0.0, 0.0, 0.0)  # roll, pitch in degrees, thrust in counts

    def reset(self) -> None:
        """Forget integrals."""
        for pid in self._all:
            pid.reset()
        self._count = 0

    def trim(self, force: Vec3) -> Vec3:
        """Load the integrals for hover at yaw 0 under ``force`` (world, N); the set-point is then zero."""
        self._level = False
        thrust = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
        self._vx.hold(math.atan2(force[0], force[2]) * DEG)
        self._vy.hold(math.asin(force[1] / thrust) * DEG)
        self._vz.hold((thrust * self._counts_per_n - THRUST_BASE) / THRUST_SCALE)
        return (0.0, 0.0, 0.0)

    def _position(self, sensed: SensedState, setpoint: Setpoint, yaw: float) -> tuple[float, float, float]:
        c, s = math.cos(yaw), math.sin(yaw)
        vx, vy, vz = sensed.velocity
        ex, ey = setpoint.vx - vx, setpoint.vy - vy
        pitch = self._vx.update(c * ex + s * ey, 0.0)
        roll = -self._vy.update(c * ey - s * ex, 0.0)
        thrust = THRUST_SCALE * self._vz.update(setpoint.vz - vz, 0.0) + THRUST_BASE
        return (
            max(-TILT_MAX_DEG, min(TILT_MAX_DEG, roll)),
            max(-TILT_MAX_DEG, min(TILT_MAX_DEG, pitch)),
            max(THRUST_MIN, min(COUNTS_MAX, thrust)),
        )

    def update(self, sensed: SensedState, setpoint: Setpoint, level: bool) -> tuple[float, Counts]:
        """Return ``(thrust counts per motor, moment counts)``; ``level`` keeps roll and pitch at zero."""
        if level is not self._level:  # controller_pid.c: a change of mode resets all PIDs
            if self._level is not None:
                self.reset()
            self._level = level
        axes = sensed.axes
        yaw = math.atan2(axes[1], axes[0])
        if self._count % POSITION_EVERY == 0:
            self._wanted = self._position(sensed, setpoint, yaw)
        self._count += 1
        roll_wanted, pitch_wanted, thrust = self._wanted
        if level:
            roll_wanted = pitch_wanted = 0.0
        roll = math.atan2(axes[5], axes[8]) * DEG
        pitch = -math.asin(max(-1.0, min(1.0, axes[2]))) * DEG
        error = setpoint.yaw_rad - yaw
        yaw_error = math.atan2(math.sin(error), math.cos(error)) * DEG
        wx, wy, wz = sensed.rates
        wx, wy, wz = wx * DEG, wy * DEG, wz * DEG
        rx = self._roll.update(roll_wanted - roll, roll) - wx
        ry = self._pitch.update(pitch_wanted - pitch, pitch) - wy
        rz = self._yaw.update(yaw_error, -yaw_error) - wz  # minus the error: continuous where yaw jumps
        return thrust, (
            int(max(-INT16_MAX, min(INT16_MAX, self._roll_rate.update(rx, wx)))),
            int(max(-INT16_MAX, min(INT16_MAX, self._pitch_rate.update(ry, wy)))),
            int(max(-INT16_MAX, min(INT16_MAX, self._yaw_rate.update(rz, wz)))),
        )
