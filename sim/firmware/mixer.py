"""Legacy power distribution and the thrust map: counts to rotor speed commands.

After firmware power_distribution_quadrotor.c and motors.c: what a motor lacks above 65535 counts is taken
from all four; counts are linear in thrust (65535 = THRUST_MAX) where the battery is compensated for, and
linear in the mean voltage at the motor where it is not; below THRUST_MIN a motor stops.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from sim.compiled.jit import jitted
from sim.compiled.records import Record
from sim.plant.params import Battery, Params, Rotor
from sim.plant.rotors import Four

COUNTS_MAX = 65535.0
OFF: Four = (0.0, 0.0, 0.0, 0.0)


@jitted
def mix(thrust: float, moments: tuple[int, int, int]) -> Four:
    """Counts of M1..M4 from thrust counts and moment counts about body x, y, z (FLU), capped to 0..65535."""
    mx, my, mz = moments
    r, p = int(mx / 2), int(my / 2)  # int16 halves, cut towards zero
    m1 = thrust - r - p - mz
    m2 = thrust - r + p + mz
    m3 = thrust + r + p - mz
    m4 = thrust + r - p + mz
    if m1 > COUNTS_MAX or m2 > COUNTS_MAX or m3 > COUNTS_MAX or m4 > COUNTS_MAX:
        excess = max(m1, m2, m3, m4) - COUNTS_MAX
        m1, m2, m3, m4 = m1 - excess, m2 - excess, m3 - excess, m4 - excess
    if m1 < 0.0 or m2 < 0.0 or m3 < 0.0 or m4 < 0.0:
        return (max(0.0, m1), max(0.0, m2), max(0.0, m3), max(0.0, m4))
    return (m1, m2, m3, m4)


class MapRecord(Record):
    """Inverse of the thrust map: rpm = (b + sqrt(b^2 + four_a counts)) inverse.

    Without compensation of the battery: rpm = at_zero_rpm + share of full duty * (what it allows above that).
    """

    compensated: bool
    at_zero_rpm: float

    b: float
    four_a: float
    inverse: float
    off_below: float  # counts


@jitted
def motor_speed(m: MapRecord, counts: float, rpm_max: float) -> float:
    """Commanded speed, rpm, not above ``rpm_max`` (what the battery allows)."""
    if counts < m.off_below:
        return 0.0
    if not m.compensated:
        return m.at_zero_rpm + (rpm_max - m.at_zero_rpm) * (counts / COUNTS_MAX)
    return min((m.b + math.sqrt(m.b * m.b + m.four_a * counts)) * m.inverse, rpm_max)


def set_up_map(m: MapRecord, rotor: Rotor, battery: Battery) -> MapRecord:
    """Fill in a record for the nominal static map and the thrust limits of a rotor."""
    m.compensated, m.at_zero_rpm = rotor.battery_compensated, battery.speed_at_zero_v_rpm
    n_per_count = rotor.thrust_max_n / COUNTS_MAX
    m.b = -rotor.thrust_linear_n_rpm
    m.four_a = 4.0 * rotor.thrust_square_n_rpm2 * n_per_count
    m.inverse = 0.5 / rotor.thrust_square_n_rpm2
    m.off_below = rotor.thrust_min_n / n_per_count
    return m


def counts_per_n(params: Params, thrust_n: float, battery_v: float) -> float:
    """Counts per newton of all four nominal motors at this total thrust and this voltage under load."""
    rotor = params.rotor
    if rotor.battery_compensated:
        return COUNTS_MAX / (4.0 * rotor.thrust_max_n)
    volts = params.battery.motor_v(rotor.rpm(thrust_n / 4.0))
    return COUNTS_MAX * volts / battery_v / thrust_n


def nominal_counts_per_n(params: Params) -> float:
    """``counts_per_n`` of the nominal vehicle in hover, with a battery that is half empty."""
    b = params.battery
    under_load_v = 0.5 * (b.full_v + b.empty_v) - b.resistance_ohm * (b.idle_current_a + b.hover_current_a)
    return counts_per_n(params, params.body.mass_kg * params.contact.gravity_m_s2, under_load_v)


def moments_of(counts: Sequence[float]) -> tuple[int, int, int]:
    """Moment counts about body x, y, z with which ``mix`` makes these differences between M1..M4."""
    m1, m2, m3, m4 = counts
    return (
        round((m3 + m4 - m1 - m2) / 2.0),
        round((m2 + m3 - m1 - m4) / 2.0),
        round((m2 + m4 - m1 - m3) / 4.0),
    )
