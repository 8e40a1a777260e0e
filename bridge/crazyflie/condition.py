"""Stores the newest state of a Crazyflie, checks its position estimate, and lists reasons against arming."""

from __future__ import annotations

import math
from collections.abc import Iterator

from bridge.crazyflie.packets import PROTOCOL_MIN, Connected, CrazyflieState, Health, Info, Lost, Power
from bridge.crazyflie.rules import ESTIMATOR, KALMAN, LOST_S, POSE_AGE_MAX_S, REARM_S
from bridge.frames import Quat, body_from_world, yaw_from_quaternion
from bridge.mavlink.server.commander import Battery
from bridge.mavlink.server.profile import POSITION_SOURCE
from flightstack.core.types import ZERO, Vec3

STATE_AGE_MAX_S = 0.3  # maximum age of the state, s: thirty packets in a row were lost
HEALTH_AGE_MAX_S = 1.0  # maximum age of the health packet, s: ten packets in a row were lost
VARIANCE_MAX_M2 = 0.01  # maximum position variance of an axis, m2; cflib waits for changes below 0.001
TILT_MAX_DEG = 2.0  # maximum tilt of markers to body, degrees; a common 1 degree causes a drift of 6.8 cm/s
# Lowest voltage at rest for arming, V: a sixth of the charge is left. The firmware never lands by itself.
BATTERY_MIN_V = 3.7
# Controllers that follow velocity set-points, by stabilizer.controller; 0 selects the default, PID.
# With such a set-point Mellinger (2) holds height zero or gives full thrust (controller_mellinger.c).
CONTROLLERS = {"0": "default", "1": "PID"}
_POSITION_DECKS = {
    "deck.bcLighthouse4": "Lighthouse deck: are the base stations seen, and is their geometry stored?",
    "deck.bcLoco": "Loco deck: are the anchors on?",
    "deck.bcFlow2": "Flow deck: is the floor in sight, with texture and light?",
}
_UP: Vec3 = (0.0, 0.0, 1.0)
_SHARE = 0.1  # weight of a new value in the mean ``_leaning``; at 10 Hz the time constant is 1 s
_AT_REST_G = 0.1  # deviation of the specific force from 1 g, in g, above which the vehicle counts as moving


class Condition:
    """Newest data of a Crazyflie, and the checks before arming."""

    def __init__(self, *, mocap: bool) -> None:
        self.link: Connected | Lost = Lost("not connected yet")  # present state of the connection
        self.state: CrazyflieState | None = None  # newest state, of any age
        self.health: Health | None = None  # newest position variance and battery data
        # reason why there is no good external pose; None: the newest pose is good, or no pose is needed
        self.mocap_problem: str | None = "mocap: no pose yet" if mocap else None
        # whether external poses are needed, and time of measurement of the newest external pose, s
        self.needs_poses, self.posed_s = mocap, -math.inf
        self._pose_quaternion: Quat | None = None  # attitude of the newest external pose
        self.fit_s = -math.inf  # time when the supervisor last reported armed or ready to arm, s
        self._leaning: Vec3 | None = None  # mean of (up by poses - up by specific force), body frame

    def alive(self, now_s: float) -> bool:
        """Whether states of the Crazyflie arrive; without them no telemetry is sent."""
        heard = self.state is not None and now_s - self.state.at_s <= LOST_S
        return heard and self.link.protocol is not None

    def problems(self, now_s: float) -> list[str]:
        """Return the reasons against arming, the most basic first."""
        if self.link.protocol is None:
            return [f"no link to the Crazyflie: {self.link.reason}"]
        return [*self._unfit(self.link.protocol, now_s), *self._unplaced(now_s), *self._tilted()]

    def position_known(self, now_s: float) -> bool:
        """Whether the position estimate is good enough to fly."""
        return self.fresh_state(now_s) is not None and next(self._unplaced(now_s), None) is None

    def _unfit(self, protocol: int, now_s: float) -> Iterator[str]:
        """Yield the reasons against arming that do not concern the position."""
        state, health = self.state, self.health
        if old := too_old(protocol):
            yield old
        if state is None:
            yield "no state from the Crazyflie yet"
        else:
            if (age_s := now_s - state.at_s) > STATE_AGE_MAX_S:
                yield f"state is {age_s:.1f} s old: radio too weak?"
            # firmware that arms itself disarms for 0.12 s every 30 s
            rearms = state.info & Info.AUTO_ARM and state.at_s - self.fit_s <= REARM_S
            if reason := stuck(state.info):
                yield reason
            elif not (state.info & FIT or rearms):
                yield "supervisor's pre-flight checks have not passed"
            if health is not None and health.power is Power.CHARGING:
                yield "it is charging: take it off the charger"
            elif health is not None and (
                health.power in (Power.LOW, Power.SHUTDOWN) or state.battery_v < BATTERY_MIN_V
            ):
                yield f"battery at {state.battery_v:.2f} V, {BATTERY_MIN_V:g} V needed: charge it"
        if (found := self.link.params.get("stabilizer.controller", "0")) not in CONTROLLERS:
            yield f"stabilizer.controller is {found}, which follows no velocities: set it to 1 (PID)"
        if self.mocap_problem is not None:
            yield self.mocap_problem

    def _unplaced(self, now_s: float) -> Iterator[str]:
        """Yield the reasons why there is no good position estimate."""
        params, health = self.link.params, self.health
        if (found := params.get(ESTIMATOR, KALMAN)) != KALMAN:
            yield f"{ESTIMATOR} is {found}, {KALMAN} (Kalman) needed"
        # without poses the reported variance remains small, but the position error is 0.65 m after 2.5 s
        if self.needs_poses and now_s - self.posed_s > POSE_AGE_MAX_S:
            yield "no pose from outside: has motion capture stopped?"
        if health is None or now_s - health.at_s > HEALTH_AGE_MAX_S:
            yield "no variance of the position estimate received"
            return
        worst = max(health.variance_m2)
        # a variance that is 0 or not finite comes from a filter that has stopped
        if not (math.isfinite(sum(health.variance_m2)) and 0.0 < worst <= VARIANCE_MAX_M2):
            decks = (text for name, text in _POSITION_DECKS.items() if params.get(name, "0") != "0")
            source = next(decks, "no positioning deck; give poses with --mocap KEY")
            yield f"no position estimate (sigma {math.sqrt(abs(worst)):.2g} m): {source}"

    def _tilted(self) -> Iterator[str]:
        tilt_deg = math.degrees(2.0 * math.asin(min(1.0, 0.5 * math.hypot(*(self._leaning or ZERO)))))
        if tilt_deg > TILT_MAX_DEG:
            yield (
                f"markers are tilted by {tilt_deg:.1f} degrees against the body, {TILT_MAX_DEG:g} allowed: "
                "define the body anew in motion capture while it stands level"
            )

    def fresh_state(self, now_s: float) -> CrazyflieState | None:
        """Return the newest state; None if it is too old for flight control."""
        state = self.state
        return state if state is not None and now_s - state.at_s <= STATE_AGE_MAX_S else None

    def yaw_rad(self) -> float | None:
        """Return the heading, counter-clockwise from east; None: no state has arrived yet."""
        return yaw_from_quaternion(self.state.quaternion) if self.state is not None else None

    def sensors_healthy(self, now_s: float) -> int:
        """Return the position sensor's bit if the position estimate is good, else 0."""
        return POSITION_SOURCE if self.position_known(now_s) else 0

    @property
    def battery(self) -> Battery:
        voltage_v = self.state.battery_v if self.state is not None else 0.0
        return Battery(voltage_v, self.health.battery_percent if self.health is not None else -1)

    def take_gravity(self, acceleration_flu_g: Vec3) -> None:
        """Compare the up direction of poses and of the specific force while the vehicle stands."""
        attitude, length = self._pose_quaternion, math.hypot(*acceleration_flu_g)
        flying = self.state is None or self.state.info & Info.FLYING
        if attitude is None or flying or abs(length - 1.0) > _AT_REST_G:
            return
        up = body_from_world(attitude, _UP)
        leaning = tuple(a - b / length for a, b in zip(up, acceleration_flu_g, strict=True))
        mean = self._leaning or leaning
        x, y, z = (m + _SHARE * (new - m) for m, new in zip(mean, leaning, strict=True))
        self._leaning = (x, y, z)


def stuck(info: Info) -> str | None:
    """Return the reason why the firmware blocks the motors, or None."""
    return next((text for bit, text in _STUCK.items() if info & bit), None)


FIT = Info.CAN_BE_ARMED | Info.ARMED
STUCK = Info.LOCKED | Info.TUMBLED | Info.CRASHED
_STUCK = {
    Info.LOCKED: "supervisor has locked: restart the Crazyflie",
    Info.TUMBLED: "it lies on its side or back: put it upright",
    Info.CRASHED: "supervisor saw a crash: look for damage, then arm it once: that recovers it",
}


def with_remedy(reason: str) -> str:
    """Return cflib's reason for a failed connection, with advice if the USB device cannot be used."""
    text = reason.removeprefix("Couldn't load link driver: ")
    if "Cannot find" not in text and "Could not open usb" not in text and "Access denied" not in text:
        return reason
    return (
        f"{text}: plug it in; on Linux install Bitcraze's udev rules; --uri radio://... needs a Crazyradio, "
        "--uri usb://0 a Crazyflie on a cable"
    )


def too_old(protocol: int) -> str | None:
    """Return the reason why firmware of this CRTP protocol is not supported, or None."""
    if protocol >= PROTOCOL_MIN:
        return None
    return f"firmware has CRTP protocol {protocol}, arming needs {PROTOCOL_MIN}: update it"
