"""Checks of the autopilot ten times a second: the charge of the battery, and the ground station.

The charge is that of PX4 battery.cpp: the cell's voltage, plus what the load takes at this throttle, between
the voltages of an empty and a full cell. Voltage and throttle are smoothed, or every climb would indicate
an empty battery.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.server.parameters import Parameters
from bridge.mavlink.server.profile import FlightMode
from flightstack.compiled.records import Record
from flightstack.core.numeric import numeric
from sim.autopilot.vehicle_like import VehicleLike

PERIOD_S = 0.1 - 1e-6  # s; nothing here is faster
_SMOOTH_S = 1.0  # s, time constant

# Mode that NAV_DLL_ACT selects when the ground station is lost (PX4 failsafe.cpp, commander_params.c)
STATION_LOST: Mapping[int, FlightMode | None] = {0: None, 1: FlightMode.HOLD, 3: FlightMode.LAND}


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
    """State of ``Watches``, and the time until which ``Watches.step`` has no new result."""

    due_s: float  # time of the next check
    last_s: float  # time of the last check
    voltage_v: float  # of the battery, smoothed, as the throttle is
    throttle: float
    until_s: float  # a ground station may count as lost from then on


class Watches:
    """Smooths voltage and throttle, and notices that the ground station is lost."""

    def __init__(self, parameters: Parameters, vehicle: VehicleLike) -> None:
        self._parameters = parameters
        self._vehicle = vehicle
        self.due_s = -math.inf  # time of the next check, s
        self._voltage_v, self._throttle = vehicle.battery_v, throttle(vehicle)
        self._last_s: float | None = None
        self._station_s: float | None = None  # newest heartbeat of a ground station
        self._station_lost = False

    @property
    def charge(self) -> float:
        """Charge left, 0 to 1."""
        p = self._parameters
        curve = p["BAT1_V_EMPTY"], p["BAT1_V_CHARGED"], p["BAT1_V_LOAD_DROP"]
        return charge_left(self._voltage_v, self._throttle, *curve)

    def heartbeat(self, type_: int, now_s: float) -> bool:
        """Record a HEARTBEAT; True when a ground station is back after a loss."""
        if type_ != dialect.MAV_TYPE_GCS:
            return False
        back, self._station_lost, self._station_s = self._station_lost, False, now_s
        return back

    def step(self, now_s: float) -> bool:
        """Check when it is due; True when the ground station has just been lost."""
        if now_s < self.due_s:
            return False
        dt_s = now_s - self._last_s if self._last_s is not None else 0.0
        self._last_s, self.due_s = now_s, now_s + PERIOD_S
        self._voltage_v = smoothed(self._voltage_v, self._vehicle.battery_v, dt_s)
        self._throttle = smoothed(self._throttle, throttle(self._vehicle), dt_s)
        limit_s = self._parameters["COM_DL_LOSS_T"]
        if self._station_lost or self._station_s is None or now_s - self._station_s <= limit_s:
            return False
        self._station_lost = True
        return True

    def calm(self) -> tuple[float, ...]:
        """Numbers of a ``WatchRecord``; before the first look ``until_s`` is past."""
        station_s = None if self._station_lost else self._station_s
        until_s = math.inf if station_s is None else station_s + self._parameters["COM_DL_LOSS_T"]
        if self._last_s is None:
            return self.due_s, -math.inf, self._voltage_v, self._throttle, -math.inf
        return self.due_s, self._last_s, self._voltage_v, self._throttle, until_s

    def passed(self, last_s: float, voltage_v: float, throttle: float) -> None:
        """Take over the values of a batch of ticks before ``until_s``."""
        self._last_s, self.due_s = last_s, last_s + PERIOD_S
        self._voltage_v, self._throttle = voltage_v, throttle


def throttle(vehicle: VehicleLike) -> float:
    """Mean of the motors' commands, 0 to 1."""
    m1, m2, m3, m4 = vehicle.motor_commands
    return (m1 + m2 + m3 + m4) / 4.0  # sum() rounds differently from Python 3.12 on
