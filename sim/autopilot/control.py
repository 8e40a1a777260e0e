"""How the autopilot flies by itself: velocities from position errors for take-off, hold and landing."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bridge.mavlink.server.profile import FlightMode
from flightstack.core.types import ZERO, Vec3

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


_INTEGRAL_GAIN_1_S2 = 0.25  # takes out wind and a wrong mass within some seconds, slower than the loop
_INTEGRAL_MAX_M_S = 0.4  # more than the paper's velocity loop sags with 10 % mass error and 2 m/s of wind
_LEARN_BELOW_M_S = 0.1  # of proportional velocity: on the way to a far point there is nothing to learn
_SLEW_M_S2 = 1.0  # keeps K_v = 0.5 clear of zero thrust: 0.53 m/s at once would be that (27 g)


@dataclass(frozen=True, slots=True)
class OwnLimits:
    """Gains and speeds of the autopilot's own flying, from its parameters."""

    gain_xy_1_s: float
    gain_z_1_s: float
    speed_xy_m_s: float
    speed_up_m_s: float
    speed_down_m_s: float


class PositionHold:
    """A position loop with a clamped integral and a slew limit; its output is a velocity set-point, ENU.

    Args:
        trim_enu_m_s: velocity set-point at which the vehicle is known to stay where it is.

    Attributes:
        point_enu_m: where it wants to be.
        velocity_enu_m_s: set-point put out last.
    """

    def __init__(self, trim_enu_m_s: Vec3 = ZERO) -> None:
        self._trim_m_s = trim_enu_m_s
        self.point_enu_m: Vec3 = ZERO
        self.velocity_enu_m_s: Vec3 = ZERO
        self._integral_m_s: Vec3 = trim_enu_m_s

    def engage(self, position_enu_m: Vec3, velocity_enu_m_s: Vec3, gain_xy_1_s: float) -> None:
        """Take over a vehicle in motion: hold where it comes to rest.

        The hold point lies v / gain ahead, so the first set-point equals the velocity, which then decays.
        """
        x, y, z = position_enu_m
        vx, vy, _ = velocity_enu_m_s
        self.point_enu_m = (x + vx / gain_xy_1_s, y + vy / gain_xy_1_s, z)
        self.velocity_enu_m_s = velocity_enu_m_s
        self._integral_m_s = self._trim_m_s

    def aim(self, height_m: float) -> None:
        """Change the height to hold."""
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
        """Velocity towards the hold point.

        ``vertical_m_s`` is wanted instead of holding the height. While the vehicle stands it does not
        ``learn``: the integral stays.
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
        """Velocity without any position: level, and up or down as told."""
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
