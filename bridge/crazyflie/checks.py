"""Why a Crazyflie must not be armed now: one table, each line with what to do."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from bridge.crazyflie.rules import POSE_AGE_MAX_S, REARM_S
from bridge.crazyflie.types import PROTOCOL_MIN, CrazyflieState, Health, Info, Link, Power

STATE_AGE_MAX_S = 0.3  # s; thirty packets missing
HEALTH_AGE_MAX_S = 1.0  # s; ten packets missing
VARIANCE_MAX_M2 = 0.01  # m2 on each axis: 0.1 m; settled ones have 0.001 and less (cflib reset_estimator)
TILT_MAX_DEG = 2.0  # degrees; each makes 6.8 cm/s of drift, and an accelerometer's zero is 1 degree off
BATTERY_MIN_V = 3.7  # V at rest, a sixth of the charge; the firmware does not land on an empty battery
ESTIMATOR, KALMAN = "stabilizer.estimator", "2"
# stabilizer.controller that fly velocities: 0 is the default, which is PID (firmware controller.c). Mellinger
# (2) holds height zero for a velocity set-point, or gives full thrust (firmware controller_mellinger.c).
CONTROLLERS = {"0": "default", "1": "PID"}
_POSITION_DECKS = {
    "deck.bcLighthouse4": "Lighthouse deck: are the base stations seen, and is their geometry stored?",
    "deck.bcLoco": "Loco deck: are the anchors on?",
    "deck.bcFlow2": "Flow deck: is the floor in sight, with texture and light?",
}


class Seen(NamedTuple):
    """What the checks look at."""

    now_s: float
    link: Link
    state: CrazyflieState | None
    health: Health | None
    mocap: str | None = None  # why motion capture is not used, when it should be
    pose_age_s: float | None = None  # of the newest pose from outside; None: none are expected
    tilt_rad: float = 0.0  # between the poses' upright and gravity's
    fit_s: float = -math.inf  # when the supervisor last showed that it is, or can be, armed


def problems(seen: Seen) -> list[str]:
    """Reasons against arming, the most basic first; empty when there are none."""
    if seen.link.protocol is None:
        return [f"no link to the Crazyflie: {seen.link.reason}"]
    return [text for text in (check(seen) for check in CHECKS) if text is not None]


def position_known(seen: Seen) -> bool:
    """Whether the estimate of position may be flown by."""
    return all(check(seen) is None for check in (_state, _estimator, _poses, _position))


def stuck(info: Info) -> str | None:
    """Why the firmware will not let the motors run, in flight or before it; None: it will."""
    return next((text for bit, text in _STUCK.items() if info & bit), None)


FIT = Info.CAN_BE_ARMED | Info.ARMED
STUCK = Info.LOCKED | Info.TUMBLED | Info.CRASHED
_STUCK = {
    Info.LOCKED: "supervisor has locked: restart the Crazyflie",
    Info.TUMBLED: "it lies on its side or back: put it upright",
    Info.CRASHED: "supervisor saw a crash: look for damage, then arm it once: that recovers it",
}


def too_old(protocol: int) -> str | None:
    """Why firmware of this CRTP protocol is not flown; None: it is."""
    if protocol >= PROTOCOL_MIN:
        return None
    return f"firmware speaks CRTP {protocol}, arming by supervisor needs {PROTOCOL_MIN}: update it"


def _protocol(seen: Seen) -> str | None:
    return too_old(seen.link.protocol) if seen.link.protocol is not None else None


def _state(seen: Seen) -> str | None:
    if seen.state is None:
        return "no state from the Crazyflie yet"
    age_s = seen.now_s - seen.state.at_s
    return f"state is {age_s:.1f} s old: radio too weak?" if age_s > STATE_AGE_MAX_S else None


def _supervisor(seen: Seen) -> str | None:
    info = seen.state.info if seen.state is not None else Info(0)
    found = stuck(info)
    if found is not None or seen.state is None or info & FIT:
        return found
    if info & Info.AUTO_ARM and seen.state.at_s - seen.fit_s <= REARM_S:
        return None  # it arms itself anew
    return "supervisor's pre-flight checks have not passed"


def _battery(seen: Seen) -> str | None:
    if seen.state is None or seen.health is None:
        return None
    if seen.health.power is Power.CHARGING:
        return "it is charging: take it off the charger"
    if seen.health.power in (Power.LOW, Power.SHUTDOWN) or seen.state.battery_v < BATTERY_MIN_V:
        return f"battery at {seen.state.battery_v:.2f} V, {BATTERY_MIN_V:g} V needed: charge it"
    return None


def _controller(seen: Seen) -> str | None:
    found = seen.link.params.get("stabilizer.controller")
    if found is None or found in CONTROLLERS:
        return None
    return f"stabilizer.controller is {found}, which flies no velocities: set it to 1 (PID)"


def _estimator(seen: Seen) -> str | None:
    found = seen.link.params.get(ESTIMATOR)
    if found is None or found == KALMAN:
        return None
    return f"{ESTIMATOR} is {found}, {KALMAN} (Kalman) needed"


def _position(seen: Seen) -> str | None:
    if seen.health is None or seen.now_s - seen.health.at_s > HEALTH_AGE_MAX_S:
        return "no variance of the position estimate received"
    worst = max(seen.health.variance_m2)
    # a filter that does not run has no variance
    if math.isfinite(sum(seen.health.variance_m2)) and 0.0 < worst <= VARIANCE_MAX_M2:
        return None
    decks = [text for name, text in _POSITION_DECKS.items() if seen.link.params.get(name, "0") != "0"]
    source = decks[0] if decks else "no positioning deck; give poses with --mocap KEY"
    return f"no position estimate (sigma {math.sqrt(abs(worst)):.2g} m): {source}"


def _mocap(seen: Seen) -> str | None:
    return seen.mocap


def _poses(seen: Seen) -> str | None:
    """Without poses the variance stays small for seconds, while the position is 0.65 m off after 2.5 s."""
    if seen.pose_age_s is None or seen.pose_age_s <= POSE_AGE_MAX_S:
        return None
    return "no pose from outside: has motion capture, or the program that sends its poses, stopped?"


def _level(seen: Seen) -> str | None:
    if seen.tilt_rad <= math.radians(TILT_MAX_DEG):
        return None
    return (
        f"markers are tilted by {math.degrees(seen.tilt_rad):.1f} degrees against the body, "
        f"{TILT_MAX_DEG:g} allowed: define the body anew in motion capture while it stands level"
    )


CHECKS: tuple[Callable[[Seen], str | None], ...] = (
    _protocol, _state, _supervisor, _battery, _controller, _estimator, _mocap, _poses, _position, _level,
)  # fmt: skip
