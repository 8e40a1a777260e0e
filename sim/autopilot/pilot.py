"""Flies one mode: velocity set-points for hold, take-off, landing and offboard.

In hold, take-off and landing the velocity follows from the position error; in offboard it is the set-point.
Changes of mode, arming and fail-safes are in ``sim.autopilot.flight``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from bridge.frames import yaw_from_quaternion
from bridge.mavlink.server.commander import Setpoint
from bridge.mavlink.server.parameters import Parameters
from bridge.mavlink.server.profile import FlightMode
from flightstack.core.types import ZERO, Vec3
from sim.plant.states import Estimate
from sim.vehicle.vehicle import VehicleSim

_INTEGRAL_GAIN_1_S2 = 0.25  # gain that cancels wind and mass error in seconds; slower than the position loop
_INTEGRAL_MAX_M_S = 0.4  # limit of the integral: above the steady error at 10 % mass error and 2 m/s of wind
_LEARN_BELOW_M_S = 0.1  # proportional velocity above which the integral is constant (anti-windup)
_SLEW_M_S2 = 1.0  # slew limit; with K_v = 0.5 a step of 0.53 m/s would command zero thrust (27 g)


@dataclass(frozen=True, slots=True)
class OwnLimits:
    """Gains and speeds of the autopilot's modes, from its parameters."""

    gain_xy_1_s: float
    gain_z_1_s: float
    speed_xy_m_s: float
    speed_up_m_s: float
    speed_down_m_s: float


class PositionHold:
    """Position loop with a clamped integral and a slew limit; its output is a velocity set-point, ENU."""

    def __init__(self, trim_enu_m_s: Vec3) -> None:
        self._trim_m_s = trim_enu_m_s  # velocity set-point that holds the position at the start
        self.point_enu_m: Vec3 = ZERO  # position to hold
        self.velocity_enu_m_s: Vec3 = ZERO  # newest set-point to the velocity loop
        self._integral_m_s: Vec3 = trim_enu_m_s

    def engage(self, position_enu_m: Vec3, velocity_enu_m_s: Vec3, gain_xy_1_s: float) -> None:
        """Start to control a vehicle in motion: hold the point where it stops.

        The hold point is v / gain ahead, so the first set-point equals the velocity, which then decays.
        """
        x, y, z = position_enu_m
        vx, vy, _ = velocity_enu_m_s
        self.point_enu_m = (x + vx / gain_xy_1_s, y + vy / gain_xy_1_s, z)
        self.velocity_enu_m_s = velocity_enu_m_s
        self._integral_m_s = self._trim_m_s

    def aim(self, height_m: float) -> None:
        self.point_enu_m = (self.point_enu_m[0], self.point_enu_m[1], height_m)

    def step(
        self,
        position_enu_m: Vec3,
        limits: OwnLimits,
        dt_s: float,
        *,
        vertical_m_s: float | None = None,
        learn: bool = True,
    ) -> Vec3:
        """Return the velocity set-point towards the hold point.

        ``vertical_m_s``: replaces the height control; ``learn``: false while the vehicle is on the ground,
        where the integral stays constant.
        """
        ex, ey, ez = (goal - now for goal, now in zip(self.point_enu_m, position_enu_m, strict=True))
        vx, vy, vz = limits.gain_xy_1_s * ex, limits.gain_xy_1_s * ey, limits.gain_z_1_s * ez
        if learn:
            old = self._integral_m_s
            ix, iy = _learnt(old[0], ex, vx, dt_s), _learnt(old[1], ey, vy, dt_s)
            iz = old[2] if vertical_m_s is not None else _learnt(old[2], ez, vz, dt_s)
            self._integral_m_s = (ix, iy, iz)
        ix, iy, iz = self._integral_m_s
        scale = min(1.0, limits.speed_xy_m_s / max(math.hypot(vx + ix, vy + iy), 1e-9))
        if vertical_m_s is None:
            vertical_m_s = _clamp(vz + iz, -limits.speed_down_m_s, limits.speed_up_m_s)
        return self._slew(((vx + ix) * scale, (vy + iy) * scale, vertical_m_s), dt_s)

    def sink(self, vertical_m_s: float, dt_s: float) -> Vec3:
        """Return a velocity set-point without a position estimate: vertical only."""
        return self._slew((0.0, 0.0, vertical_m_s), dt_s)

    def _slew(self, wanted: Vec3, dt_s: float) -> Vec3:
        most = _SLEW_M_S2 * dt_s
        x, y, z = self.velocity_enu_m_s
        self.velocity_enu_m_s = (
            x + _clamp(wanted[0] - x, -most, most),
            y + _clamp(wanted[1] - y, -most, most),
            z + _clamp(wanted[2] - z, -most, most),
        )
        return self.velocity_enu_m_s


def _learnt(integral: float, error: float, proportional: float, dt_s: float) -> float:
    if abs(proportional) >= _LEARN_BELOW_M_S:
        return integral
    return _clamp(integral + _INTEGRAL_GAIN_1_S2 * error * dt_s, -_INTEGRAL_MAX_M_S, _INTEGRAL_MAX_M_S)


def _clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


_ARRIVED_M = 0.05  # height error at which a height counts as reached, half of the Crazyflie's size
_ARRIVED_M_S = 0.15  # vertical speed below which a height counts as reached


class Event(Enum):
    """Result of a step, for the mode logic."""

    ARRIVED = auto()  # the take-off height is reached
    LANDED = auto()  # the vehicle stands on a surface in LAND
    CLIPPED = auto()  # a set-point exceeded the speed limits


class Pilot:
    """Computes velocity set-points for the firmware from mode, estimate and received set-point."""

    def __init__(self, vehicle: VehicleSim, parameters: Parameters) -> None:
        self.velocity_setpoint_enu_m_s: Vec3 | None = None  # last set-point to the firmware; None: none yet
        self._vehicle = vehicle
        self._parameters = parameters
        self._hold = PositionHold(vehicle.trim_velocity_enu_m_s)
        self._setpoint: Setpoint | None = None
        self._fresh = False  # whether the set-point has not been sent to the firmware yet
        self._engaged = False  # whether the position loop has started in this mode
        self._yaw_rad = 0.0  # heading to hold
        self._takeoff_z_m = 0.0  # height of the take-off, local frame
        self._fly: dict[FlightMode, Callable[[Estimate, bool, float], Event | None]] = {
            FlightMode.HOLD: self._fly_hold,
            FlightMode.TAKEOFF: self._fly_takeoff,
            FlightMode.LAND: self._fly_land,
            FlightMode.OFFBOARD: self._fly_offboard,
        }

    def begin(self) -> None:
        """Start a mode from the current state."""
        self._engaged, self._fresh = False, True

    def take(self, setpoint: Setpoint) -> None:
        """Store the newest received set-point; OFFBOARD flies it."""
        self._setpoint, self._fresh = setpoint, True

    @property
    def passes_on(self) -> tuple[float, float, float] | None:
        """Speeds (horizontal, up, down) up to which set-points pass unchanged, m/s; None: any may change."""
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

    def fly(
        self, mode: FlightMode, takeoff_z_m: float, estimate: Estimate, standing: bool, dt_s: float
    ) -> Event | None:
        """Run one control step of an armed vehicle."""
        self._takeoff_z_m = takeoff_z_m
        return self._fly[mode](estimate, standing, dt_s)

    @property
    def _clip(self) -> tuple[float, float, float]:
        """Speed limits in m/s: horizontal, up, down."""
        p = self._parameters
        return p["MPC_XY_VEL_MAX"], p["MPC_Z_VEL_MAX_UP"], p["MPC_Z_VEL_MAX_DN"]

    @property
    def _limits(self) -> OwnLimits:
        p, (xy, up, down) = self._parameters, self._clip
        return OwnLimits(
            p["MPC_XY_P"], p["MPC_Z_P"], min(xy, p["MPC_XY_CRUISE"]), min(up, p["MPC_TKO_SPEED"]),
            min(down, p["MPC_LAND_SPEED"]),
        )  # fmt: skip

    def _approach(
        self,
        estimate: Estimate,
        dt_s: float,
        *,
        vertical_m_s: float | None = None,
        learn: bool = True,
    ) -> None:
        """Fly towards the hold point; without a position estimate, fly level with the vertical velocity."""
        if estimate.valid:
            at = estimate.position_enu_m
            velocity = self._hold.step(at, self._limits, dt_s, vertical_m_s=vertical_m_s, learn=learn)
        else:
            velocity = self._hold.sink(vertical_m_s or 0.0, dt_s)
        self.velocity_setpoint_enu_m_s = velocity
        self._vehicle.set_velocity(velocity, self._yaw_rad)

    def _engage(self, estimate: Estimate) -> None:
        """Start the position loop from the current motion, unless it has started in this mode."""
        if self._engaged:
            return
        self._hold.engage(estimate.position_enu_m, estimate.velocity_enu_m_s, self._limits.gain_xy_1_s)
        self._yaw_rad = yaw_from_quaternion(estimate.quaternion)
        self._engaged = True

    def _fly_hold(self, estimate: Estimate, standing: bool, dt_s: float) -> Event | None:
        if standing:
            # The stop set-point is sent at every tick: if set-points stop after a flight, the firmware
            # assumes a lost link and changes to LOCKED.
            self.stop()
            return None
        self._engage(estimate)
        self._approach(estimate, dt_s)
        return None

    def _fly_takeoff(self, estimate: Estimate, standing: bool, dt_s: float) -> Event | None:
        self._engage(estimate)
        goal_m = self._takeoff_z_m
        self._hold.aim(goal_m)
        self._approach(estimate, dt_s, learn=not standing)
        arrived = estimate.valid and _at_height(estimate, goal_m)
        return Event.ARRIVED if arrived else None

    def go_on(self) -> None:
        """Hold the end point of the take-off; the position loop continues with its current integral."""
        self._engaged = True

    def _fly_land(self, estimate: Estimate, standing: bool, dt_s: float) -> Event | None:
        if standing:
            return Event.LANDED
        self._engage(estimate)
        self._approach(estimate, dt_s, vertical_m_s=-self._limits.speed_down_m_s)
        return None

    def _fly_offboard(self, estimate: Estimate, _standing: bool, dt_s: float) -> Event | None:
        setpoint = self._setpoint
        if setpoint is None:  # before the first set-point; the check of the stream runs first
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
        velocity = clip(wanted, *self._clip)
        self.velocity_setpoint_enu_m_s = velocity
        self._vehicle.set_velocity(velocity, self._yaw_rad)
        return None if velocity == wanted else Event.CLIPPED


def _at_height(estimate: Estimate, height_m: float) -> bool:
    error_m = height_m - estimate.position_enu_m[2]
    return abs(error_m) < _ARRIVED_M and abs(estimate.velocity_enu_m_s[2]) < _ARRIVED_M_S


def clip(velocity_enu_m_s: Vec3, xy_m_s: float, up_m_s: float, down_m_s: float) -> Vec3:
    """Limit a velocity to the vehicle's speeds; its horizontal direction does not change."""
    x, y, z = velocity_enu_m_s
    if x * x + y * y <= xy_m_s * xy_m_s and -down_m_s <= z <= up_m_s:
        return velocity_enu_m_s
    speed_m_s = math.hypot(x, y)
    if speed_m_s > xy_m_s:
        x, y = x * xy_m_s / speed_m_s, y * xy_m_s / speed_m_s
    return (x, y, min(max(z, -down_m_s), up_m_s))
