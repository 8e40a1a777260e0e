"""Flies one mode: velocity set-points for hold, take-off, landing and offboard.

In hold, take-off and landing the velocity follows from the position error; in offboard the velocity is the
received set-point.
Changes of mode, arming and fail-safes are in ``sim.autopilot.flight``.
"""

from __future__ import annotations

import math
from enum import Enum, auto

from bridge.frames import yaw_from_quaternion
from bridge.mavlink.server.commander import Setpoint
from bridge.mavlink.server.parameters import Parameters
from bridge.mavlink.server.profile import FlightMode
from flightstack.core.safety.position_loop import clip, slew
from flightstack.core.types import ZERO, Vec3
from sim.plant.states import Estimate
from sim.vehicle.vehicle import VehicleSim

_INTEGRAL_GAIN_1_S2 = 0.25  # gain of the integral, which cancels wind and mass errors in some seconds
_INTEGRAL_MAX_M_S = 0.4  # limit of the integral, above the steady error at 10 % mass error and 2 m/s of wind
_LEARN_BELOW_M_S = 0.1  # proportional velocity above which the integral is constant (anti-windup)
_SLEW_M_S2 = 1.0  # slew limit; a step of 0.53 m/s would command zero thrust at 27 g and K_v = 0.5 N s/m
_ARRIVED_M = 0.05  # height error at which a height counts as reached, half of the Crazyflie's size
_ARRIVED_M_S = 0.15  # vertical speed below which a height counts as reached


class Event(Enum):
    """Result of a step, for the mode logic."""

    ARRIVED = auto()  # the take-off height is reached
    LANDED = auto()  # the vehicle stands on a surface in LAND
    CLIPPED = auto()  # a set-point exceeded the speed limits


class Pilot:
    """Computes velocity set-points for the firmware from mode, estimate and received set-point.

    In all modes but OFFBOARD, a position loop with a clamped integral and a slew limit computes them.
    """

    def __init__(self, vehicle: VehicleSim, parameters: Parameters) -> None:
        self.velocity_setpoint_enu_m_s: Vec3 | None = None  # last set-point to the firmware; None: none yet
        self._vehicle, self._parameters = vehicle, parameters
        self._setpoint: Setpoint | None = None
        self._fresh = False  # whether the newest received set-point still has to be sent to the firmware
        self._engaged = False  # whether the position loop has started in this mode
        self._yaw_rad = 0.0  # heading to hold
        self._point_enu_m: Vec3 = ZERO  # position to hold
        self._velocity_enu_m_s: Vec3 = ZERO  # newest set-point of the position loop
        # integral of the position loop; at first the velocity set-point that holds the position at the start
        self._integral_m_s: Vec3 = vehicle.trim_velocity_enu_m_s

    def begin(self) -> None:
        """Start a mode from the current state."""
        self._engaged, self._fresh = False, True

    def take(self, setpoint: Setpoint) -> None:
        """Store the newest received set-point for OFFBOARD."""
        self._setpoint, self._fresh = setpoint, True

    @property
    def passes_on(self) -> tuple[float, float, float] | None:
        """Speeds (horizontal, up, down) up to which set-points pass unchanged, m/s; None: unknown."""
        return self._clip if self._engaged and self._setpoint is not None else None

    def handed_on(self, setpoint: Setpoint) -> None:
        """Record a set-point that was sent to the firmware unchanged."""
        self._setpoint, self._fresh = setpoint, False
        if setpoint.yaw_rad is not None:
            self._yaw_rad = setpoint.yaw_rad
        self.velocity_setpoint_enu_m_s = setpoint.velocity_enu_m_s

    def stop(self) -> None:
        """Send a stop set-point to the firmware."""
        self._vehicle.stop_setpoint()
        self.velocity_setpoint_enu_m_s = None
        self._engaged = False

    def go_on(self) -> None:
        """Hold the end point of the take-off; the position loop continues with its current integral."""
        self._engaged = True

    def fly(
        self, mode: FlightMode, takeoff_z_m: float, estimate: Estimate, standing: bool, dt_s: float
    ) -> Event | None:
        """Run one control step of an armed vehicle."""
        if mode is FlightMode.OFFBOARD:
            return self._fly_offboard(estimate, dt_s)
        if standing and mode is FlightMode.LAND:
            return Event.LANDED
        if standing and mode is FlightMode.HOLD:
            # The stop set-point is sent at every tick: if set-points stop after a flight, the firmware
            # assumes a lost link and changes to LOCKED.
            self.stop()
            return None
        if not self._engaged:
            self._engage(estimate)
        takes_off = mode is FlightMode.TAKEOFF
        if takes_off:
            self._point_enu_m = (*self._point_enu_m[:2], takeoff_z_m)
        self._approach(estimate, dt_s, lands=mode is FlightMode.LAND, learn=not standing)
        error_m, climb_m_s = takeoff_z_m - estimate.position_enu_m[2], estimate.velocity_enu_m_s[2]
        arrived = abs(error_m) < _ARRIVED_M and abs(climb_m_s) < _ARRIVED_M_S
        return Event.ARRIVED if takes_off and estimate.valid and arrived else None

    @property
    def _clip(self) -> tuple[float, float, float]:
        """Speed limits in m/s: horizontal, up, down."""
        p = self._parameters
        return p["MPC_XY_VEL_MAX"], p["MPC_Z_VEL_MAX_UP"], p["MPC_Z_VEL_MAX_DN"]

    def _engage(self, estimate: Estimate) -> None:
        """Start the position loop; the hold point is where the vehicle stops, at a distance of v / gain."""
        (x, y, z), (vx, vy, _) = estimate.position_enu_m, estimate.velocity_enu_m_s
        gain_1_s = self._parameters["MPC_XY_P"]
        self._point_enu_m = (x + vx / gain_1_s, y + vy / gain_1_s, z)
        self._velocity_enu_m_s = estimate.velocity_enu_m_s
        self._integral_m_s = self._vehicle.trim_velocity_enu_m_s
        self._yaw_rad = yaw_from_quaternion(estimate.quaternion)
        self._engaged = True

    def _approach(self, estimate: Estimate, dt_s: float, *, lands: bool, learn: bool) -> None:
        """Fly to the hold point, or sink; without an estimate, fly level. ``learn``: change the integral."""
        p, (xy_m_s, up_m_s, down_m_s) = self._parameters, self._clip
        down_m_s = min(down_m_s, p["MPC_LAND_SPEED"])
        wanted = (0.0, 0.0, -down_m_s if lands else 0.0)
        if estimate.valid:
            at = estimate.position_enu_m
            ex, ey, ez = (goal - now for goal, now in zip(self._point_enu_m, at, strict=True))
            vx, vy, vz = p["MPC_XY_P"] * ex, p["MPC_XY_P"] * ey, p["MPC_Z_P"] * ez
            ix, iy, iz = self._integral_m_s
            if learn:
                ix, iy = _learnt(ix, ex, vx, dt_s), _learnt(iy, ey, vy, dt_s)
                iz = iz if lands else _learnt(iz, ez, vz, dt_s)
                self._integral_m_s = (ix, iy, iz)
            most_m_s = min(xy_m_s, p["MPC_XY_CRUISE"])
            scale = min(1.0, most_m_s / max(math.hypot(vx + ix, vy + iy), 1e-9))
            climb_m_s = clip(vz + iz, -down_m_s, min(up_m_s, p["MPC_TKO_SPEED"]))
            wanted = ((vx + ix) * scale, (vy + iy) * scale, -down_m_s if lands else climb_m_s)
        most = _SLEW_M_S2 * dt_s
        velocity = slew(self._velocity_enu_m_s, wanted, (most, most, most))
        self._velocity_enu_m_s = self.velocity_setpoint_enu_m_s = velocity
        self._vehicle.set_velocity(velocity, self._yaw_rad)

    def _fly_offboard(self, estimate: Estimate, dt_s: float) -> Event | None:
        setpoint = self._setpoint
        if setpoint is None:  # no set-point yet; the check of the stream runs before this method
            return None
        if not self._engaged:
            self._yaw_rad, self._engaged = yaw_from_quaternion(estimate.quaternion), True
        if setpoint.yaw_rad is not None:
            self._yaw_rad = setpoint.yaw_rad
        self._yaw_rad += setpoint.yaw_rate_rad_s * dt_s
        # Send only new set-points, so that the firmware's watchdog also detects a broken stream.
        if not (self._fresh or setpoint.yaw_rate_rad_s):
            return None
        self._fresh = False
        wanted = setpoint.velocity_enu_m_s
        velocity = _clipped(wanted, *self._clip)
        self.velocity_setpoint_enu_m_s = velocity
        self._vehicle.set_velocity(velocity, self._yaw_rad)
        return None if velocity == wanted else Event.CLIPPED


def _learnt(integral: float, error: float, proportional: float, dt_s: float) -> float:
    if abs(proportional) >= _LEARN_BELOW_M_S:
        return integral
    return clip(integral + _INTEGRAL_GAIN_1_S2 * error * dt_s, -_INTEGRAL_MAX_M_S, _INTEGRAL_MAX_M_S)


def _clipped(velocity_enu_m_s: Vec3, xy_m_s: float, up_m_s: float, down_m_s: float) -> Vec3:
    """Limit a velocity to the vehicle's speeds; the horizontal direction does not change."""
    x, y, z = velocity_enu_m_s
    if x * x + y * y <= xy_m_s * xy_m_s and -down_m_s <= z <= up_m_s:
        return velocity_enu_m_s
    speed_m_s = math.hypot(x, y)
    if speed_m_s > xy_m_s:
        x, y = x * xy_m_s / speed_m_s, y * xy_m_s / speed_m_s
    return (x, y, clip(z, -down_m_s, up_m_s))
