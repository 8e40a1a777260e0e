"""Parameters that matter for safety, autopilot by autopilot: what they have to be, and why.

Sources: PX4 ``commander_params.c``, ``mavlink_params.c``, ``multicopter_*_params.c`` and ``failsafe.cpp``
(v1.16); ArduPilot ``ArduCopter/Parameters.cpp``, ``mode_guided.cpp`` and ``events.cpp`` (4.6).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from bridge.mavlink.profiles.autopilots import ARDUPILOT, CRAZYFLIE, OWN_SITL, PX4
from flightstack.core.types import Vec3


class Level(Enum):
    """How bad a finding is."""

    OK = "ok"
    NOTE = "note"  # a person should know
    UNSAFE = "UNSAFE"  # does not arm, unless accepted by name
    ACCEPTED = "accepted"  # unsafe, and accepted by name


class Needs(NamedTuple):
    """What the flight needs of its autopilot."""

    velocity_max_m_s: Vec3  # command box
    altitude_max_m: float  # above the ground
    takeoff_height_m: float
    acceleration_max_m_s2: Vec3  # of the wanted velocity, ENU
    system_id: int = 1  # of the vehicle, and so of the companion, which shares it

    @property
    def horizontal_m_s(self) -> float:
        """Longest horizontal velocity that may be commanded."""
        x, y, _ = self.velocity_max_m_s
        return math.hypot(x, y)

    @property
    def horizontal_m_s2(self) -> float:
        """Largest horizontal acceleration of the wanted velocity."""
        x, y, _ = self.acceleration_max_m_s2
        return math.hypot(x, y)


Values = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Rule:
    """One parameter: what it has to be for this flight, and why."""

    name: str
    safe: Callable[[float, Needs], bool]
    wanted: Callable[[Needs], str]
    why: str  # what happens otherwise
    level: Level = Level.UNSAFE  # of a value that is not safe, and of a value that does not come


@dataclass(frozen=True, slots=True)
class Finding:
    """What became of one rule."""

    name: str
    level: Level
    value: float | None
    wanted: str
    why: str

    @property
    def text(self) -> str:
        """In one line."""
        value = "missing" if self.value is None else f"{self.value:g}"
        line = f"{self.name} is {value}"
        return line if self.level is Level.OK else f"{line}: {self.why}; set it to {self.wanted}"


def judge(
    rules: Sequence[Rule], values: Values, missing: Mapping[str, str], needs: Needs, accepted: Collection[str]
) -> list[Finding]:
    """Judge all rules.

    ``missing`` gives the reason by name. ``accepted`` are names that a person has accepted, whatever they are
    set to.
    """
    return [_finding(rule, values.get(rule.name), missing, needs, accepted) for rule in rules]


def _finding(
    rule: Rule, value: float | None, missing: Mapping[str, str], needs: Needs, accepted: Collection[str]
) -> Finding:
    wanted = rule.wanted(needs)
    if value is not None and rule.safe(value, needs):
        return Finding(rule.name, Level.OK, value, wanted, "")
    level = Level.ACCEPTED if rule.level is Level.UNSAFE and rule.name in accepted else rule.level
    why = rule.why if value is not None else f"{missing.get(rule.name, 'not asked')}; {rule.why}"
    return Finding(rule.name, level, value, wanted, why)


# s without set-points; more is a blind flight at the last velocity, less trips over a late datagram
_LOSS_S = (0.1, 1.0)
_ARMED_S = 5.0  # s armed on the ground until the take-off shows: PX4 was measured with 3.4 to 5.0
_FROM, _TO = "{:g} to {:g}", "at least {:g}"
_Wanted = Callable[[Needs], str]


def _fixed(text: str) -> _Wanted:
    return lambda _needs: text


def _one_of(name: str, values: Mapping[int, str], why: str, level: Level = Level.UNSAFE) -> Rule:
    text = " or ".join(f"{value} ({meaning})" for value, meaning in values.items())
    return Rule(name, lambda value, _: value in values, _fixed(text), why, level)


def _without(name: str, bits: int, wanted: str, why: str) -> Rule:
    return Rule(name, lambda value, _: not int(value) & bits, _fixed(wanted), why)


def _loss_time(name: str, after: str) -> Rule:
    low, high = _LOSS_S
    return Rule(
        name,
        lambda value, _: low <= value <= high + 1e-6,
        _fixed(_FROM.format(low, high)),
        f"s without set-points until {after}; meanwhile it flies on with the last one",
    )


def _speed(name: str, need: Callable[[Needs], float], unit_m_s: float = 1.0) -> Rule:
    """A limit of speed: 1 of the parameter is ``unit_m_s``; rounded up, so that what is said suffices."""

    def least(needs: Needs) -> float:
        return math.ceil(need(needs) / unit_m_s * 100.0 - 1e-6) / 100.0

    return Rule(
        name,
        lambda value, needs: value * unit_m_s >= need(needs) - 1e-6,
        lambda needs: _TO.format(least(needs)),
        "clips set-points: what is flown is not what the safety filter chose",
    )


def _speeds(xy: str, up: str, down: str, unit_m_s: float = 1.0) -> tuple[Rule, ...]:
    return (
        _speed(xy, lambda needs: needs.horizontal_m_s, unit_m_s),
        _speed(up, lambda needs: needs.velocity_max_m_s[2], unit_m_s),
        _speed(down, lambda needs: needs.velocity_max_m_s[2], unit_m_s),
    )


def _acceleration(name: str, need: Callable[[Needs], float]) -> Rule:
    """A limit of acceleration in cm/s^2; rounded up."""

    def least(needs: Needs) -> float:
        return math.ceil(need(needs) * 100.0 - 1e-6)

    return Rule(
        name,
        lambda value, needs: value >= need(needs) * 100.0 - 1e-4,
        lambda needs: _TO.format(least(needs)),
        "cm/s^2, below what the configuration wants: the vehicle lags more than velocity_loop says",
        Level.NOTE,
    )


def _fence_height(name: str, none: str) -> Rule:
    return Rule(
        name,
        lambda value, needs: value <= 0.0 or value >= needs.altitude_max_m,
        lambda needs: f"{none} or {_TO.format(needs.altitude_max_m)}",
        "m above home where the fence breaks off the landing, below limits.altitude_max_m",
    )


_OBL = "after a loss of set-points"
_PX4_SHARED = (
    _loss_time("COM_OF_LOSS_T", "COM_OBL_RC_ACT"),
    *_speeds("MPC_XY_VEL_MAX", "MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN"),
    Rule(
        "COM_DISARM_PRFLT",
        lambda value, _: value < 0.0 or value >= _ARMED_S,
        _fixed(_TO.format(_ARMED_S)),
        "s armed on the ground until it disarms: too short for its own take-off",
    ),
    _fence_height("GF_MAX_VER_DIST", "0 (none)"),
    Rule(
        "GF_MAX_HOR_DIST",
        lambda value, _: value <= 0.0,
        _fixed("0 (none)"),
        "m from home where the fence breaks off the landing: does the target stay within?",
        Level.NOTE,
    ),
    _one_of(
        "GF_ACTION",
        {0: "nothing", 1: "warn", 2: "hold", 3: "return", 5: "land"},
        "outside the fence the motors stop",
    ),
    _one_of(
        "NAV_DLL_ACT",
        {0: "nothing", 1: "hold", 2: "return", 3: "land"},
        "when the ground station falls silent the motors stop",
    ),
    _one_of("COM_LOW_BAT_ACT", {2: "land", 3: "return or land"}, "an empty battery is only told", Level.NOTE),
    _one_of("SYS_FAILURE_EN", {0: "off"}, "command 420 may let sensors and motors fail in flight"),
)

RULES: Mapping[str, tuple[Rule, ...]] = {
    OWN_SITL.name: (
        *_PX4_SHARED,
        _one_of("COM_OBL_RC_ACT", {0: "land", 3: "return", 4: "land", 5: "hold"}, f"{_OBL} it falls"),
        _one_of("COM_RC_IN_MODE", {4: "no sticks"}, "a radio that is not there is waited for"),
    ),
    CRAZYFLIE.name: (),  # no parameters on the wire: the bridge itself checks before it arms
    PX4.name: (
        *_PX4_SHARED,
        _one_of(
            "COM_OBL_RC_ACT",
            {4: "land", 5: "hold"},
            f"{_OBL} it waits for sticks, sinks without any, flies home or stops its motors",
        ),
        _one_of(
            "COM_RC_IN_MODE",
            {4: "no sticks"},
            "without a radio its loss is a fail-safe of its own; with one, mind COM_RCL_EXCEPT instead",
            Level.NOTE,
        ),
        Rule(
            "COM_RCL_EXCEPT",
            lambda value, _: bool(int(value) & 4),
            _fixed("a value with bit 2 (offboard)"),
            "when the radio is lost the landing is broken off",
            Level.NOTE,
        ),
        Rule(
            "COM_RC_OVERRIDE",
            lambda value, _: bool(int(value) & 2),
            _fixed("a value with bit 1 (offboard)"),
            "a pilot's sticks do not take over",
            Level.NOTE,
        ),
        _one_of("MAV_FWDEXTSP", {1: "on"}, "set-points are not handed on to the controllers"),
    ),
    ARDUPILOT.name: (
        _loss_time("GUID_TIMEOUT", "it stops"),
        _without("GUID_OPTIONS", 0x30, "a value without bits 4 and 5", "velocity is not stabilised"),
        *_speeds("WPNAV_SPEED", "WPNAV_SPEED_UP", "WPNAV_SPEED_DN", 0.01),
        _acceleration("WPNAV_ACCEL", lambda needs: needs.horizontal_m_s2),
        _acceleration("WPNAV_ACCEL_Z", lambda needs: needs.acceleration_max_m_s2[2]),
        Rule(
            "DISARM_DELAY",
            lambda value, _: value == 0.0 or value >= _ARMED_S,
            _fixed(f"0 (never) or {_TO.format(_ARMED_S)}"),
            "s armed on the ground until it disarms: too short for its own take-off",
        ),
        Rule("ARMING_CHECK", lambda value, _: value != 0.0, _fixed("1 (all)"), "it arms without its checks"),
        _one_of(
            "FS_EKF_ACTION",
            {1: "land", 2: "altitude hold", 3: "land from every mode"},
            "a lost position estimate is only told",
        ),
        _one_of(
            "FS_GCS_ENABLE",
            {5: "land", 1: "RTL"},
            "when the companion is lost it stops and stays in the air, armed, until the battery is empty",
        ),
        Rule(
            "SYSID_MYGCS",
            lambda value, needs: value == needs.system_id,
            lambda needs: f"{needs.system_id} (the companion's system id, the vehicle's own)",
            "FS_GCS_ENABLE acts when the heartbeats of this system id stop: the loss of the companion "
            "does not count, that of a ground station does",
        ),
        _one_of("FS_THR_ENABLE", {0: "off"}, "when the radio is lost the landing is broken off", Level.NOTE),
        _one_of("BATT_FS_CRT_ACT", {1: "land", 2: "RTL"}, "an empty battery is only told", Level.NOTE),
        _one_of(
            "FENCE_ENABLE",
            {0: "off"},
            "a breach breaks off the landing: is FENCE_ALT_MAX above limits.altitude_max_m?",
            Level.NOTE,
        ),
        _one_of("SYSID_ENFORCE", {1: "on"}, "it obeys every sender, whatever its id", Level.NOTE),
    ),
}
