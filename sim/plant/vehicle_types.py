"""What the simulated vehicle says of itself: what it believes, and what is true."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.core.types import Vec3
from sim.compiled.jit import jitted
from sim.compiled.records import F64, Record, new, scalars
from sim.plant.params import Battery
from sim.plant.rotors import Four


class BatteryRecord(Record):
    """Charge and voltage; the rest as in ``params.Battery``."""

    voltage_v: float  # under load
    used_a_s: float
    hover_power: float  # sum of the cubes of the speeds in hover, rpm^3
    charge_a_s: float
    full_v: float
    empty_v: float
    resistance_ohm: float
    idle_current_a: float
    hover_current_a: float
    speed_at_zero_v_rpm: float
    speed_per_volt_rpm: float


@jitted
def drain(b: BatteryRecord, rpm: F64, dt_s: float) -> None:
    """Draw current for ``dt_s``; power grows with the cube of the speed, scaled to the hover current."""
    power = 0.0
    for i in range(4):
        power += math.pow(rpm[i], 3.0)
    power /= b.hover_power
    current = b.idle_current_a + b.hover_current_a * power
    b.used_a_s = min(b.charge_a_s, b.used_a_s + current * dt_s)
    rest = b.full_v - (b.full_v - b.empty_v) * b.used_a_s / b.charge_a_s
    b.voltage_v = rest - b.resistance_ohm * current


@jitted
def speed_limit(b: BatteryRecord) -> float:
    """Speed at full duty cycle, rpm."""
    return b.speed_at_zero_v_rpm + b.speed_per_volt_rpm * b.voltage_v


class BatteryModel:
    """One cell, full at first.

    Args:
        battery: parameters.
        hover_rpm: speed of all rotors at which it gives its hover current.
        record: where to keep everything; None for a place of its own.
    """

    __slots__ = ("_voltage", "record")

    def __init__(self, battery: Battery, hover_rpm: float, record: BatteryRecord | None = None) -> None:
        self.record = b = new(BatteryRecord) if record is None else record
        self._voltage = scalars(b, "voltage_v")[0]
        b.hover_power = 4.0 * hover_rpm**3
        b.charge_a_s, b.full_v, b.empty_v = battery.charge_a_s, battery.full_v, battery.empty_v
        b.resistance_ohm = battery.resistance_ohm
        b.idle_current_a, b.hover_current_a = battery.idle_current_a, battery.hover_current_a
        b.speed_at_zero_v_rpm = battery.speed_at_zero_v_rpm
        b.speed_per_volt_rpm = battery.speed_per_volt_rpm
        b.voltage_v = battery.full_v - battery.resistance_ohm * battery.idle_current_a

    def step(self, rpm: Four, dt_s: float) -> None:
        """Draw the current of these speeds for ``dt_s``."""
        drain(self.record, np.array(rpm), dt_s)

    @property
    def voltage_v(self) -> float:
        """Voltage under load."""
        return float(self._voltage[0])

    @property
    def rpm_max(self) -> float:
        """Speed at full duty cycle."""
        return speed_limit(self.record)


class Estimate(NamedTuple):
    """What the on-board estimator believes."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # w, x, y, z; FLU body in ENU world
    angular_velocity_flu_rad_s: Vec3
    valid: bool


class Truth(NamedTuple):
    """The true state and what happened since the last call of ``truth`` (fields of TrueState.msg)."""

    time_s: float
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # w, x, y, z; FLU body in ENU world
    angular_velocity_flu_rad_s: Vec3
    rotor_rpm: tuple[float, float, float, float]
    pad_position_enu_m: Vec3
    pad_velocity_enu_m_s: Vec3
    pad_yaw_rad: float
    h_m: float
    h_min_m: float
    h_min_outside_pad_m: float  # +inf if no step was outside the pad's radius
    contacts: int  # bits CONTACT_*
    first_touch_relative_position_enu_m: Vec3  # NaN until there was one
    first_touch_relative_velocity_enu_m_s: Vec3
    first_touch_time_s: float  # NaN until there was one
    motors_running: bool
    battery_v: float
    wind_enu_m_s: Vec3
