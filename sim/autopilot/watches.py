"""Filters battery voltage and throttle, from which the charge follows, and detects standing on a surface.

The charge is computed as in PX4 battery.cpp. The voltage under load plus the voltage drop at this throttle is
compared with the voltages of an empty and a full cell. Voltage and throttle are low-pass filtered, because
otherwise every climb would indicate an empty battery.
"""

from __future__ import annotations

import math

from bridge.mavlink.server.parameters import Parameters
from flightstack.compiled.records import Record
from flightstack.core.numeric import numeric
from sim.vehicle.vehicle import VehicleSim

PERIOD_S = 0.1 - 1e-6  # time between two checks, s
_SMOOTH_S = 1.0  # time constant of the low-pass filter


@numeric
def smoothed(before: float, measured: float, dt_s: float) -> float:
    """Return the new output of a first-order low-pass filter."""
    return before + (1.0 - math.exp(-dt_s / _SMOOTH_S)) * (measured - before)


@numeric
def charge_left(voltage_v: float, throttle: float, empty_v: float, full_v: float, drop_v: float) -> float:
    """Return the charge, 0 to 1, of a cell under load; ``drop_v``: voltage drop at full throttle."""
    rest_v = voltage_v + drop_v * throttle
    return min(max((rest_v - empty_v) / max(full_v - empty_v, 0.01), 0.0), 1.0)


class WatchRecord(Record):
    """State of ``Watches``."""

    due_s: float  # time of the next check
    last_s: float  # time of the last check
    voltage_v: float  # battery voltage, low-pass filtered
    throttle: float  # mean motor command, low-pass filtered


class Watches:
    """Filters voltage and throttle ten times a second."""

    def __init__(self, parameters: Parameters, vehicle: VehicleSim) -> None:
        self._parameters = parameters
        self._vehicle = vehicle
        self.due_s = -math.inf  # time of the next check, s
        self._voltage_v, self._throttle = vehicle.battery_v, throttle(vehicle)
        self._last_s: float | None = None

    @property
    def charge(self) -> float:
        """Remaining charge, 0 to 1."""
        p = self._parameters
        curve = p["BAT1_V_EMPTY"], p["BAT1_V_CHARGED"], p["BAT1_V_LOAD_DROP"]
        return charge_left(self._voltage_v, self._throttle, *curve)

    def step(self, now_s: float) -> None:
        """Filter voltage and throttle if the time of the next check has come."""
        if now_s < self.due_s:
            return
        dt_s = now_s - self._last_s if self._last_s is not None else 0.0
        self._last_s, self.due_s = now_s, now_s + PERIOD_S
        self._voltage_v = smoothed(self._voltage_v, self._vehicle.battery_v, dt_s)
        self._throttle = smoothed(self._throttle, throttle(self._vehicle), dt_s)

    def values(self) -> tuple[float, ...] | None:
        """Return the values of a ``WatchRecord``; None before the first check."""
        return None if self._last_s is None else (self.due_s, self._last_s, self._voltage_v, self._throttle)

    def passed(self, last_s: float, voltage_v: float, throttle: float) -> None:
        """Store the values after a batch of ticks."""
        self._last_s, self.due_s = last_s, last_s + PERIOD_S
        self._voltage_v, self._throttle = voltage_v, throttle


def throttle(vehicle: VehicleSim) -> float:
    """Return the mean of the motor commands, 0 to 1."""
    m1, m2, m3, m4 = vehicle.motor_commands
    return (m1 + m2 + m3 + m4) / 4.0  # not sum(), whose rounding changed in Python 3.12


_CONTACT_S = 0.3  # time of unbroken contact after which the vehicle counts as standing; bounces are shorter
_NO_CONTACT_S = 0.1  # time without contact after which the vehicle counts as flying


class Standing:
    """Detects from lasting contact that the vehicle stands on a surface."""

    def __init__(self, vehicle: VehicleSim) -> None:
        self._vehicle = vehicle
        self.now = vehicle.landed or vehicle.on_pad or vehicle.on_ground  # whether it stands on a surface
        self.since_s = 0.0  # time at which this state started, s
        self._contact = self.now
        self._changed_s = 0.0

    @property
    def settled(self) -> bool:
        """Whether the newest contact reading agrees with ``now``."""
        return self._contact == self.now

    def watch(self, now_s: float, armed: bool) -> None:
        """Read the contacts; call it at every tick."""
        vehicle = self._vehicle
        contact = vehicle.on_pad or vehicle.on_ground or vehicle.landed
        if contact != self._contact:
            self._contact, self._changed_s = contact, now_s
        if contact == self.now:
            return
        lasted_s = now_s - self._changed_s
        if not armed or lasted_s >= (_CONTACT_S if contact else _NO_CONTACT_S) - 1e-9:
            self.now = contact or not armed
            self.since_s = now_s
