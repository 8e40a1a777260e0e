"""Requests to the firmware's supervisor, and velocity set-points of take-off, hold and landing.

A request to arm or to stop the motors is repeated until it has an effect. Motors-off is three packets: a
stop set-point, a notice that no more set-points follow, and a disarming request, which also works in flight.
Without the notice the supervisor locks after two seconds (firmware supervisor.c). If a forced disarm has no
effect, an emergency stop follows; the stop is latched until a restart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from bridge.crazyflie.packets import ArmReply, CrazyflieState, Info, Order, Packet, Velocity
from bridge.frames import wrap_angle, yaw_from_quaternion
from flightstack.core.types import Vec3

REPEAT_S = 0.05  # time between two repeats of a request, s: the period of five state packets
ARM_MAX_S = 0.6  # time-out of an arming request without an answer, s
KILL_UNSEEN_S = 0.2  # time without an effect after which a forced disarm becomes an emergency stop, s
OFF_MAX_S = 1.0  # time-out of a motors-off request, s
NOTICES = 6  # number of repeats of the notice after the motors are off, since packets may be lost
REFUSED = "the supervisor refused"
_OFF = (Order.STOP, Order.NOTIFY_STOP, Order.DISARM)


class _Goal(Enum):
    ARM = auto()
    OFF = auto()
    NOTICE = auto()  # repeat the notice; without it the supervisor locks after two seconds


@dataclass(slots=True)
class _Request:
    goal: _Goal
    since_s: float
    sent_s: float
    forced: bool = False  # OFF: whether the disarm must also work in flight
    latched: bool = False  # OFF: whether an emergency stop is sent, too
    refused: bool = False  # ARM: whether the supervisor has refused at least once
    left: int = NOTICES  # NOTICE: number of packets still to be sent


class Arming:
    """Request to arm or to stop the motors: repeated until its effect is observed or a time-out."""

    def __init__(self) -> None:
        self.armed = False  # whether a client of this bridge armed the vehicle and the firmware confirmed it
        self._request: _Request | None = None
        self._arms_itself = False

    @property
    def arming(self) -> bool:
        return self._request is not None and self._request.goal is _Goal.ARM

    @property
    def busy(self) -> bool:
        """Whether a packet must still be sent or an effect must still be observed."""
        return self._request is not None

    def ask(self, state: CrazyflieState, now_s: float) -> list[Packet]:
        """Start to arm the vehicle and return the packets; an armed firmware needs no packet."""
        self.armed, self._arms_itself = bool(state.info & Info.ARMED), bool(state.info & Info.AUTO_ARM)
        self._request = None if self.armed else _Request(_Goal.ARM, now_s, now_s)
        return [] if self.armed else [Order.ARM]

    def refused_by(self, reply: ArmReply) -> bool:
        """Whether a reply ends the arming request; a refusal by firmware that arms itself does not end it."""
        if self._request is None or not self.arming or reply.accepted:
            return False
        self._request.refused = True
        if not self._arms_itself:
            self._request = None
        return not self._arms_itself

    def off(self, now_s: float, *, forced: bool, latched: bool = False) -> list[Packet]:
        """Return the packets that stop the motors; call again to repeat them, since packets may be lost."""
        self.armed, before = False, self._request
        request = self._request = _Request(_Goal.OFF, now_s, now_s, forced, latched)
        if before is not None and before.goal is _Goal.OFF:
            request.latched = latched or before.latched
            if before.forced:
                request.since_s, request.forced = before.since_s, True
        return list(_OFF)

    def emergency(self, now_s: float) -> list[Packet]:
        return [Order.EMERGENCY_STOP, *self.off(now_s, forced=True, latched=True)]

    def forget(self, *, armed: bool) -> None:
        """Drop the open request because the link is lost."""
        self.armed, self._request = armed, None

    def step(self, state: CrazyflieState | None, now_s: float) -> tuple[list[Packet], str | None]:
        """Return the packets to repeat, and a text if a request has failed."""
        request = self._request
        if request is None:
            return [], None
        after_s, goal = now_s - request.since_s, request.goal
        orders: tuple[Packet, ...] = (Order.ARM,)
        if goal is _Goal.ARM:
            if state is not None and state.at_s > request.since_s and state.info & Info.ARMED:
                self.armed, self._request = True, None
                return [], None
            if after_s > ARM_MAX_S:
                self._request = None
                return [], REFUSED if request.refused else "the supervisor did not answer"
        elif goal is _Goal.OFF:
            fresh = state is not None and state.at_s > request.since_s + REPEAT_S  # later than the request
            if fresh and state is not None and not state.info & Info.FLYING:
                self._request = _Request(_Goal.NOTICE, now_s, now_s)
                return [Order.NOTIFY_STOP], None
            if after_s > OFF_MAX_S:
                self._request = None
                return [], "Motors off was not confirmed" if request.forced else None
            if request.forced and after_s > KILL_UNSEEN_S and not request.latched:
                request.latched = True
                return [Order.EMERGENCY_STOP], "Disarming had no effect: emergency stop, restart needed"
            orders = (Order.EMERGENCY_STOP, *_OFF) if request.latched else _OFF
        if now_s - request.sent_s < REPEAT_S - 1e-9:
            return [], None
        request.sent_s = now_s
        if goal is _Goal.NOTICE:
            orders, request.left = (Order.NOTIFY_STOP,), request.left - 1
            self._request = request if request.left else None
        return list(orders), None


GAIN_1_S = 1.5  # position gain, 1/s: a third of the velocity loop's gain, which avoids overshoot
SPEED_XY_M_S = 0.3  # maximum horizontal speed, m/s
CLIMB_M_S = 0.4  # maximum climb rate, m/s
DESCENT_M_S = 0.25  # descent rate of a landing, and maximum descent rate of a hold, m/s
ARRIVED_M, ARRIVED_M_S = 0.05, 0.15  # maximum height error, m, and speed, m/s, at the end of a take-off
# height above the start, m, below which a take-off keeps the horizontal velocity of a moving deck
CLEAR_M = 0.1
CARRIED_MAX_M_S = 1.0  # maximum velocity of a moving deck that the take-off follows, m/s
# Descent rate without a position, m/s: an accelerometer bias makes the firmware's estimate of the vertical
# velocity drift by 0.05 m/s per second, until the vehicle climbs while the estimate shows a descent.
UNPLACED_M_S = 0.4
STOPPED_SHARE = 0.3  # fraction of the commanded descent rate; a vehicle that sinks slower stands on something
LANDING_MIN_S = 1.0  # time after the start of a landing from which a stop counts, s: a climb must end first
STOPPED_TIME_S = 0.4  # time for which a stop must last, s; longer than the start of a descent takes
SINKING_M_S = -0.1  # maximum z velocity of a descent command, m/s; a slower descent may be a control error
YAW_GAIN_1_S = 2.0  # yaw gain, 1/s; CRTP velocity set-points have a yaw rate but no yaw
YAW_RATE_MAX_RAD_S = 1.5  # maximum yaw rate, rad/s


def yaw_rate(wanted_rad: float, state: CrazyflieState) -> float:
    """Return the yaw rate, counter-clockwise, that turns the vehicle to a heading and holds this heading."""
    error_rad = wrap_angle(wanted_rad - yaw_from_quaternion(state.quaternion))
    return min(max(YAW_GAIN_1_S * error_rad, -YAW_RATE_MAX_RAD_S), YAW_RATE_MAX_RAD_S)


class Stopped:
    """Detects a vehicle that stands on something: it does not follow a descent command."""

    def __init__(self) -> None:
        self._since_s = math.inf

    def lasts_s(self, wanted_z_m_s: float, state: CrazyflieState | None, now_s: float) -> float:
        """Return the time since the descent stopped, s; -inf: no stop. Call with every set-point."""
        sinks = state is None or state.velocity_enu_m_s[2] < STOPPED_SHARE * wanted_z_m_s
        if wanted_z_m_s > SINKING_M_S or sinks:
            self._since_s = math.inf
        else:
            self._since_s = min(self._since_s, now_s)
        return now_s - self._since_s


class Pilot:
    """Flies take-off, hold and landing; a take-off from a moving deck starts with the deck's velocity."""

    def __init__(self) -> None:
        self.begin(-math.inf)

    def begin(self, now_s: float) -> None:
        self.since_s = now_s  # start time of the present mode
        self._anchor: tuple[Vec3, float] | None = None  # point and heading to hold, set with the first state
        self._clear_z_m = -math.inf  # height above which a take-off keeps its horizontal position
        self._stopped = Stopped()

    def velocity(self, state: CrazyflieState, takeoff_z_m: float | None) -> Velocity:
        """Return the velocity to the point to hold; ``takeoff_z_m``: its z in a take-off, m; else None."""
        takes_off = takeoff_z_m is not None
        x, y, z = (
            p + v / GAIN_1_S for p, v in zip(state.position_enu_m, state.velocity_enu_m_s, strict=True)
        )
        target_z_m = z if takeoff_z_m is None else takeoff_z_m
        if self._anchor is None:
            self._anchor = ((x, y, target_z_m), yaw_from_quaternion(state.quaternion))
            self._clear_z_m = state.position_enu_m[2] + CLEAR_M
        elif takes_off and state.position_enu_m[2] < self._clear_z_m:
            self._anchor = ((x, y, target_z_m), self._anchor[1])
        point_enu_m, yaw_rad = self._anchor
        speed_max_m_s = CARRIED_MAX_M_S if takes_off else SPEED_XY_M_S
        velocity_enu_m_s = _towards(point_enu_m, state.position_enu_m, speed_max_m_s)
        return Velocity(velocity_enu_m_s, yaw_rate(yaw_rad, state))

    def arrived(self, state: CrazyflieState, takeoff_z_m: float) -> bool:
        high = abs(takeoff_z_m - state.position_enu_m[2]) < ARRIVED_M
        return high and abs(state.velocity_enu_m_s[2]) < ARRIVED_M_S

    def landed(self, state: CrazyflieState, now_s: float) -> bool:
        stopped_s = self._stopped.lasts_s(-DESCENT_M_S, state, now_s)
        return stopped_s >= STOPPED_TIME_S and now_s - self.since_s > LANDING_MIN_S


def _towards(point_enu_m: Vec3, position_enu_m: Vec3, speed_max_m_s: float) -> Vec3:
    ex, ey, ez = (a - b for a, b in zip(point_enu_m, position_enu_m, strict=True))
    vx, vy = GAIN_1_S * ex, GAIN_1_S * ey
    speed = math.hypot(vx, vy)
    if speed > speed_max_m_s:
        vx, vy = vx * speed_max_m_s / speed, vy * speed_max_m_s / speed
    return (vx, vy, min(max(GAIN_1_S * ez, -DESCENT_M_S), CLIMB_M_S))
