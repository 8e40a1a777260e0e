"""Slow fail-safes: battery, ground station, geofence. Each speaks once when its condition begins.

So whoever is in charge may go on after a fail-safe has acted, as in PX4; what acts and how is a parameter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flightstack.core.types import Vec3
from sim.autopilot.battery import BatteryGauge, Charge
from sim.autopilot.modes import VehicleLike
from sim.autopilot.parameters import Parameters

HEIGHT_RANGE_M = (0.1, 20.0)  # m above home of take-off and reposition; the room is lower
_REACH_M = 50.0  # m from home that it may be sent to by itself
_PERIOD_S = 0.1  # s; nothing here is faster


class Action(IntEnum):
    """What a fail-safe does, the stronger the higher."""

    NONE = 0
    WARN = 1
    HOLD = 2
    RETURN = 3
    LAND = 4


# Values of PX4's parameters (failsafe.cpp, commander_params.c); what is missing is refused when it is set.
# COM_OBL_RC_ACT = 0 is PX4's position mode: without sticks it cannot be flown, and PX4 too ends by landing.
STREAM_LOST: Mapping[int, Action] = MappingProxyType(
    {0: Action.LAND, 3: Action.RETURN, 4: Action.LAND, 5: Action.HOLD}
)
STATION_LOST: Mapping[int, Action] = MappingProxyType(
    {0: Action.NONE, 1: Action.HOLD, 2: Action.RETURN, 3: Action.LAND}
)
FENCE: Mapping[int, Action] = MappingProxyType(
    {0: Action.NONE, 1: Action.WARN, 2: Action.HOLD, 3: Action.RETURN, 5: Action.LAND}
)
BATTERY: Mapping[tuple[Charge, int], Action] = MappingProxyType(
    {
        **{(Charge.LOW, act): Action.WARN for act in (0, 2, 3)},
        (Charge.CRITICAL, 0): Action.WARN,
        (Charge.CRITICAL, 2): Action.LAND,
        (Charge.CRITICAL, 3): Action.RETURN,
        (Charge.EMERGENCY, 0): Action.WARN,
        (Charge.EMERGENCY, 2): Action.LAND,
        (Charge.EMERGENCY, 3): Action.LAND,
    }
)


class Alarm(NamedTuple):
    """A condition that has just begun, and what is to be done."""

    action: Action
    text: str


class Watches:
    """Looks after battery, ground station and fence ten times a second.

    Attributes:
        battery: charge.
        due_s: when to look next.
    """

    def __init__(self, parameters: Parameters, vehicle: VehicleLike, station_id: str | None = None) -> None:
        self._parameters = parameters
        self._station_id = station_id  # parameter
        self._vehicle = vehicle
        self.battery = BatteryGauge(parameters, vehicle.battery_v, throttle(vehicle))
        self.due_s = -math.inf
        self._last_s: float | None = None
        self._station_s: float | None = None  # when a ground station was heard last
        self._station_lost = False
        self._outside = False

    def heartbeat(self, type_: int, system_id: int, now_s: float) -> bool:
        """Take note of somebody's HEARTBEAT; True when a ground station is back after a loss.

        Which count is the personality's: those of type GCS (PX4), or of one system id (ArduPilot).
        """
        if self._station_id is None:
            counts = type_ == dialect.MAV_TYPE_GCS
        else:
            counts = system_id == self._parameters[self._station_id]
        if not counts:
            return False
        back, self._station_lost, self._station_s = self._station_lost, False, now_s
        return back

    def step(self, now_s: float, position_enu_m: Vec3, home_enu_m: Vec3, *, flying: bool) -> list[Alarm]:
        """Look, if it is time; return what has just begun.

        Args:
            now_s: simulated time.
            position_enu_m: where the vehicle believes to be.
            home_enu_m: home.
            flying: armed and in the air.
        """
        if now_s < self.due_s:
            return []
        dt_s = now_s - self._last_s if self._last_s is not None else 0.0
        self._last_s, self.due_s = now_s, now_s + _PERIOD_S - 1e-6
        alarms = self._watch_battery(dt_s)
        alarms += self._watch_station(now_s, flying)
        alarms += self._watch_fence(position_enu_m, home_enu_m, flying)
        return alarms

    def outside(self, position_enu_m: Vec3, home_enu_m: Vec3) -> str | None:
        """Which limit of the geofence a point breaks, None if none."""
        if FENCE[int(self._parameters["GF_ACTION"])] is Action.NONE:
            return None
        x, y, z = (a - b for a, b in zip(position_enu_m, home_enu_m, strict=True))
        for name, distance_m in (("GF_MAX_HOR_DIST", math.hypot(x, y)), ("GF_MAX_VER_DIST", z)):
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
    return sum(vehicle.motor_commands) / 4.0
