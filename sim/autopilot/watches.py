"""Slow fail-safes: battery, ground station, geofence. Each acts once, when its condition begins.

So a client can fly on after a fail-safe has acted, as with PX4; parameters say which action is taken.

The battery's charge is that of PX4 battery.cpp: the cell's voltage, plus what the load takes at this
throttle, between the voltages of an empty and a full cell. Both are smoothed, or every climb would look like
an empty battery.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.server.parameters import Parameters
from bridge.mavlink.server.profile import FlightMode
from flightstack.compiled.records import Record, Vector
from flightstack.core.numeric import numeric
from flightstack.core.types import Vec3
from sim.autopilot.vehicle_like import VehicleLike

HEIGHT_RANGE_M = (0.1, 20.0)  # m above home of take-off and reposition; the room is lower
_REACH_M = 50.0  # m from home that it may be sent to by itself
PERIOD_S = 0.1 - 1e-6  # s; nothing here is faster

_SMOOTH_S = 1.0  # s, time constant
_BETTER = 0.03  # of charge above a threshold until the level gets better again


class Action(IntEnum):
    """What a fail-safe does, the stronger the higher."""

    NONE = 0
    WARN = 1
    HOLD = 2
    RETURN = 3
    LAND = 4


class Charge(IntEnum):
    """How bad it is; the values are those of MAV_BATTERY_CHARGE_STATE."""

    OK = 1
    LOW = 2
    CRITICAL = 3
    EMERGENCY = 4


# Values of PX4's parameters (failsafe.cpp, commander_params.c); what is missing is refused when it is set.
# COM_OBL_RC_ACT = 0 is PX4's position mode: without sticks it cannot be flown, and PX4 too ends by landing.
STREAM_LOST: Mapping[int, Action] = {0: Action.LAND, 3: Action.RETURN, 4: Action.LAND, 5: Action.HOLD}
STATION_LOST: Mapping[int, Action] = {0: Action.NONE, 1: Action.HOLD, 2: Action.RETURN, 3: Action.LAND}
FENCE: Mapping[int, Action] = {
    0: Action.NONE,
    1: Action.WARN,
    2: Action.HOLD,
    3: Action.RETURN,
    5: Action.LAND,
}
BATTERY: Mapping[tuple[Charge, int], Action] = {
    **{(Charge.LOW, act): Action.WARN for act in (0, 2, 3, 5)},
    (Charge.CRITICAL, 0): Action.WARN,
    (Charge.CRITICAL, 2): Action.LAND,
    **{(Charge.CRITICAL, act): Action.RETURN for act in (3, 5)},
    (Charge.EMERGENCY, 0): Action.WARN,
    **{(Charge.EMERGENCY, act): Action.LAND for act in (2, 3, 5)},
}


# Mode of an action, and how a text calls it.
ACTION_MODES: Mapping[Action, tuple[FlightMode, str]] = {
    Action.HOLD: (FlightMode.HOLD, "holding"),
    Action.RETURN: (FlightMode.RETURN, "returning"),
    Action.LAND: (FlightMode.LAND, "landing"),
}
# A mode that already does what a fail-safe wants, or more.
STRENGTH: Mapping[FlightMode, Action] = {FlightMode.RETURN: Action.RETURN, FlightMode.LAND: Action.LAND}
_THRESHOLDS = (
    (Charge.EMERGENCY, "BAT_EMERGEN_THR"),
    (Charge.CRITICAL, "BAT_CRIT_THR"),
    (Charge.LOW, "BAT_LOW_THR"),
)
_FENCE_M = ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST")  # from home, level and up; 0: no bound


class Alarm(NamedTuple):
    """A condition that has just begun, and what is to be done."""

    action: Action
    text: str


@numeric
def smoothed(before: float, measured: float, dt_s: float) -> float:
    """Value that follows a measured one slowly."""
    return before + (1.0 - math.exp(-dt_s / _SMOOTH_S)) * (measured - before)


@numeric
def charge_left(voltage_v: float, throttle: float, empty_v: float, full_v: float, drop_v: float) -> float:
    """Charge, 0 to 1, of a cell under load; ``drop_v`` is what full throttle takes from its voltage."""
    rest_v = voltage_v + drop_v * throttle
    return min(max((rest_v - empty_v) / max(full_v - empty_v, 0.01), 0.0), 1.0)


class WatchRecord(Record):
    """Within which bounds ``Watches.step`` finds nothing new."""

    due_s: float  # when it looks next
    last_s: float  # when it looked last
    voltage_v: float  # of the battery, smoothed, as the throttle is
    throttle: float
    empty_v: float  # of the battery, as ``charge_left`` takes them
    full_v: float
    drop_v: float
    least: float  # charge
    until_s: float  # a ground station may count as lost from then on
    home: Vector  # where the fence stands, ENU, m
    reach_m: float  # of the fence, level and up
    height_m: float


class BatteryGauge:
    """Charge left and its level; while armed the level only gets worse, as in PX4 (failsafe.cpp).

    Attributes:
        voltage_v, throttle: smoothed.
        remaining: 0 to 1.
        level: against BAT_LOW_THR, BAT_CRIT_THR and BAT_EMERGEN_THR.
    """

    def __init__(self, parameters: Parameters, voltage_v: float, throttle: float) -> None:
        self._parameters = parameters
        self.voltage_v, self.throttle = voltage_v, throttle
        self.remaining, self.level = 1.0, Charge.OK
        self.step(voltage_v, throttle, 0.0, armed=False)

    def step(self, voltage_v: float, throttle: float, dt_s: float, *, armed: bool) -> Charge | None:
        """Take a measurement.

        ``voltage_v`` is that of the one cell under load, ``throttle`` the mean of the motors' commands, 0 to
        1. While ``armed`` the level only gets worse.

        Returns:
            The level when it has just become worse.
        """
        self.passed(smoothed(self.voltage_v, voltage_v, dt_s), smoothed(self.throttle, throttle, dt_s))
        before = self.level
        better = before if armed else self._judge(self.remaining - _BETTER)
        self.level = max(self._judge(self.remaining), min(before, better))
        return self.level if self.level > before else None

    def passed(self, voltage_v: float, throttle: float) -> None:
        """Take smoothed values that do not change the level."""
        self.voltage_v, self.throttle = voltage_v, throttle
        self.remaining = charge_left(voltage_v, throttle, *self.curve)

    @property
    def curve(self) -> Vec3:
        """Voltages of an empty and of a full cell, and what full throttle takes."""
        p = self._parameters
        return p["BAT1_V_EMPTY"], p["BAT1_V_CHARGED"], p["BAT1_V_LOAD_DROP"]

    @property
    def critical(self) -> bool:
        """Whether the charge is too low to take off."""
        return self.level >= Charge.CRITICAL

    def _judge(self, remaining: float) -> Charge:
        for level, name in _THRESHOLDS:
            if remaining < self._parameters[name]:
                return level
        return Charge.OK


class Watches:
    """Looks after battery, ground station and fence ten times a second.

    Attributes:
        battery: charge.
        due_s: when to look next.
    """

    def __init__(self, parameters: Parameters, vehicle: VehicleLike) -> None:
        self._parameters = parameters
        self._vehicle = vehicle
        self.battery = BatteryGauge(parameters, vehicle.battery_v, throttle(vehicle))
        self.due_s = -math.inf
        self._last_s: float | None = None
        self._station_s: float | None = None  # when a ground station was heard last
        self._station_lost = False
        self._outside = False

    def heartbeat(self, type_: int, now_s: float) -> bool:
        """Take note of a HEARTBEAT; True when a ground station is back after a loss."""
        if type_ != dialect.MAV_TYPE_GCS:
            return False
        back, self._station_lost, self._station_s = self._station_lost, False, now_s
        return back

    def step(self, now_s: float, position_enu_m: Vec3, home_enu_m: Vec3, *, flying: bool) -> list[Alarm]:
        """Look, if it is time; return what has just begun."""
        if now_s < self.due_s:
            return []
        dt_s = now_s - self._last_s if self._last_s is not None else 0.0
        self._last_s, self.due_s = now_s, now_s + PERIOD_S
        alarms = self._watch_battery(dt_s)
        alarms += self._watch_station(now_s, flying)
        alarms += self._watch_fence(position_enu_m, home_enu_m, flying)
        return alarms

    def calm(self, home_enu_m: Vec3) -> tuple[float, ...]:
        """Numbers of a ``WatchRecord``; where something is not as it should be, ``until_s`` is past."""
        gauge, station_s, p = self.battery, self._station_s, self._parameters
        least = max(p[name] for _, name in _THRESHOLDS)
        until_s = math.inf if self._station_lost or station_s is None else station_s + p["COM_DL_LOSS_T"]
        last_s = self._last_s
        if last_s is None or self._outside or gauge.level is not Charge.OK:
            until_s, last_s = -math.inf, -math.inf
        bounded = FENCE[int(p["GF_ACTION"])] is not Action.NONE
        reach_m, height_m = (p[name] if bounded and p[name] > 0.0 else math.inf for name in _FENCE_M)
        return (
            self.due_s, last_s, gauge.voltage_v, gauge.throttle, *gauge.curve, least, until_s, *home_enu_m,
            reach_m, height_m,
        )  # fmt: skip

    def passed(self, last_s: float, voltage_v: float, throttle: float) -> None:
        """Take note of what somebody else saw within the bounds of ``calm``."""
        self._last_s, self.due_s = last_s, last_s + PERIOD_S
        self.battery.passed(voltage_v, throttle)

    def outside(self, position_enu_m: Vec3, home_enu_m: Vec3) -> str | None:
        """Which limit of the geofence a point breaks, None if none."""
        if FENCE[int(self._parameters["GF_ACTION"])] is Action.NONE:
            return None
        x, y, z = (a - b for a, b in zip(position_enu_m, home_enu_m, strict=True))
        for name, distance_m in zip(_FENCE_M, (math.hypot(x, y), z), strict=True):
            limit_m = self._parameters[name]
            if limit_m > 0.0 and distance_m > limit_m:
                return f"{distance_m:.1f} m, {name} is {limit_m:g}"
        return None

    def too_far(self, point_enu_m: Vec3, home_enu_m: Vec3) -> str | None:
        """Why it is not sent to a point by itself, None if it may be."""
        x, y, z = (a - b for a, b in zip(point_enu_m, home_enu_m, strict=True))
        low, high = HEIGHT_RANGE_M
        if not low <= z <= high:
            return f"{z:.4g} m above home, {low:g} to {high:g}"
        if math.hypot(x, y) > _REACH_M:
            return f"{math.hypot(x, y):.4g} m from home, at most {_REACH_M:g}"
        return self.outside(point_enu_m, home_enu_m)

    def _watch_battery(self, dt_s: float) -> list[Alarm]:
        vehicle = self._vehicle
        level = self.battery.step(vehicle.battery_v, throttle(vehicle), dt_s, armed=vehicle.armed)
        if level is None:
            return []
        action = BATTERY[level, int(self._parameters["COM_LOW_BAT_ACT"])]
        return [Alarm(action, f"Battery {level.name.lower()}, {100 * self.battery.remaining:.0f} %")]

    def _watch_station(self, now_s: float, flying: bool) -> list[Alarm]:
        limit_s = self._parameters["COM_DL_LOSS_T"]
        if self._station_lost or self._station_s is None or now_s - self._station_s <= limit_s:
            return []
        self._station_lost = True
        action = STATION_LOST[int(self._parameters["NAV_DLL_ACT"])]
        if not flying or action is Action.NONE:
            return []
        return [Alarm(action, f"No ground station for {limit_s:g} s")]

    def _watch_fence(self, position_enu_m: Vec3, home_enu_m: Vec3, flying: bool) -> list[Alarm]:
        where = self.outside(position_enu_m, home_enu_m) if flying else None
        before, self._outside = self._outside, where is not None
        if where is None or before:
            return []
        return [Alarm(FENCE[int(self._parameters["GF_ACTION"])], f"Outside the geofence: {where}")]


def throttle(vehicle: VehicleLike) -> float:
    """Mean of the motors' commands, 0 to 1."""
    m1, m2, m3, m4 = vehicle.motor_commands
    return (m1 + m2 + m3 + m4) / 4.0  # sum() rounds differently from Python 3.12 on
