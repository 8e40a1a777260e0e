"""Velocities for the bridge's own modes: climb to a height, hold, go down. Position in, velocity out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from bridge.crazyflie.rules import STANDING_S, TAKEOFF_MAX_S
from bridge.crazyflie.types import CrazyflieState, Velocity
from bridge.frames import wrap_angle, yaw_from_quaternion
from bridge.mavlink.server.profile import FlightMode
from flightstack.core.types import ZERO, Vec3

GAIN_1_S = 1.5  # 1/s; a third of the firmware's velocity loop (position_controller_pid.c), so no overshoot
SPEED_XY_M_S = 0.3  # m/s
CLIMB_M_S = 0.4  # m/s
DESCENT_M_S = 0.25  # m/s
ARRIVED_M, ARRIVED_M_S = 0.05, 0.15  # m, m/s; height reached
# m/s, without a position: the bias of an accelerometer makes the firmware's own vertical velocity drift by
# 0.05 m/s in a second, until it climbs while it seems to sink
UNPLACED_M_S = 0.4
STOPPED_SHARE = 0.3  # share of the descent speed; slower than that it stands on something
LANDING_MIN_S = 1.0  # s of a landing until a stop counts: a climb has to end first
STOPPED_TIME_S = 0.4  # s that the stop has to last; longer than the descent takes to begin
SINKING_M_S = -0.1  # m/s; a set-point below that is a descent command, above it may be an error of control
YAW_GAIN_1_S = 2.0  # 1/s; CRTP velocity set-points have a yaw rate, no yaw
YAW_RATE_MAX_RAD_S = 1.5  # rad/s


def yaw_rate(wanted_rad: float, state: CrazyflieState) -> float:
    """Yaw rate, counter-clockwise, that turns to a heading and holds it."""
    error_rad = wrap_angle(wanted_rad - yaw_from_quaternion(state.quaternion))
    return min(max(YAW_GAIN_1_S * error_rad, -YAW_RATE_MAX_RAD_S), YAW_RATE_MAX_RAD_S)


@dataclass(slots=True)
class Anchor:
    """A point to hold, with the heading."""

    point_enu_m: Vec3
    yaw_rad: float
    stopped_since_s: float = math.inf  # when it stopped to follow the descent command; infinite: it follows

    @classmethod
    def here(cls, state: CrazyflieState, height_m: float | None = None) -> Anchor:
        """Hold where it comes to rest, or above there at a height."""
        x, y, z = state.position_enu_m
        vx, vy, vz = state.velocity_enu_m_s
        point = (x + vx / GAIN_1_S, y + vy / GAIN_1_S, z + vz / GAIN_1_S)
        return cls(
            point if height_m is None else (*point[:2], height_m), yaw_from_quaternion(state.quaternion)
        )

    def hold(self, state: CrazyflieState) -> Vec3:
        """Velocity towards the point."""
        ex, ey, ez = (a - b for a, b in zip(self.point_enu_m, state.position_enu_m, strict=True))
        vx, vy = GAIN_1_S * ex, GAIN_1_S * ey
        speed = math.hypot(vx, vy)
        if speed > SPEED_XY_M_S:
            vx, vy = vx * SPEED_XY_M_S / speed, vy * SPEED_XY_M_S / speed
        return (vx, vy, min(max(GAIN_1_S * ez, -DESCENT_M_S), CLIMB_M_S))

    def descend(self, state: CrazyflieState) -> Vec3:
        """Velocity downwards above the point."""
        vx, vy, _ = self.hold(state)
        return (vx, vy, -DESCENT_M_S)

    def arrived(self, state: CrazyflieState) -> bool:
        """Whether the height has been reached."""
        high = abs(self.point_enu_m[2] - state.position_enu_m[2]) < ARRIVED_M
        return high and abs(state.velocity_enu_m_s[2]) < ARRIVED_M_S

    def down(self, state: CrazyflieState, now_s: float) -> bool:
        """Whether it has not followed the descent command for a while; call it at every step."""
        if state.velocity_enu_m_s[2] < -STOPPED_SHARE * DESCENT_M_S:
            self.stopped_since_s = math.inf
            return False
        self.stopped_since_s = min(self.stopped_since_s, now_s)
        return now_s - self.stopped_since_s >= STOPPED_TIME_S


class Ground:
    """Detects that a vehicle flown by a client stands: it does not follow a descent command for a second."""

    def __init__(self) -> None:
        self._since_s = math.inf

    def stands(self, wanted_z_m_s: float, state: CrazyflieState | None, now_s: float) -> bool:
        """Whether it stands; call it with every set-point."""
        sinks = state is None or state.velocity_enu_m_s[2] < STOPPED_SHARE * wanted_z_m_s
        if wanted_z_m_s > SINKING_M_S or sinks:
            self._since_s = math.inf
            return False
        self._since_s = min(self._since_s, now_s)
        return now_s - self._since_s > STANDING_S


class Done(Enum):
    """What a mode ended with."""

    ARRIVED = auto()  # take-off height reached
    LANDED = auto()
    STUCK = auto()  # take-off height not reached in time


class Pilot:
    """Flies take-off, hold and landing."""

    def __init__(self) -> None:
        self._anchor: Anchor | None = None
        self.since_s = -math.inf  # begin of the present mode

    def begin(self, now_s: float) -> None:
        """Begin a mode at the present place."""
        self._anchor, self.since_s = None, now_s

    def step(
        self,
        mode: FlightMode,
        takeoff_z_m: float,
        state: CrazyflieState | None,
        now_s: float,
        *,
        standing: bool,
        placed: bool,
    ) -> tuple[Velocity | None, Done | None]:
        """Velocity to send, and whether the mode is done.

        ``mode`` is any but OFFBOARD. ``state`` is None when there is no fresh one: then it stops in the air,
        or continues down. ``standing``: it has not moved yet. ``placed``: its position is known; a
        landing goes straight down without.
        """
        if state is None:
            if mode is FlightMode.LAND:
                return Velocity((0.0, 0.0, -DESCENT_M_S), 0.0), None
            return (None if standing else Velocity(ZERO, 0.0)), None
        if self._anchor is None:
            self._anchor = Anchor.here(state, takeoff_z_m if mode is FlightMode.TAKEOFF else None)
        anchor = self._anchor
        turn_rad_s = yaw_rate(anchor.yaw_rad, state)
        if mode is FlightMode.LAND:
            if anchor.down(state, now_s) and now_s - self.since_s > LANDING_MIN_S:
                return None, Done.LANDED
            velocity = anchor.descend(state) if placed else (0.0, 0.0, -UNPLACED_M_S)
            return Velocity(velocity, turn_rad_s), None
        done: Done | None = None
        if mode is FlightMode.TAKEOFF and anchor.arrived(state):
            done = Done.ARRIVED
        elif mode is FlightMode.TAKEOFF and now_s - self.since_s > TAKEOFF_MAX_S:
            done = Done.STUCK
        return Velocity(anchor.hold(state), turn_rad_s), done
