"""Legacy power distribution and the thrust map: counts to rotor speed commands.

After firmware power_distribution_quadrotor.c and motors.c: what a motor lacks above 65535 counts is taken
from all four; counts are linear in thrust (65535 = THRUST_MAX) since the battery is compensated for; below
THRUST_MIN a motor stops.
"""

from __future__ import annotations

import math

from sim.compiled.jit import jitted
from sim.compiled.records import Record
from sim.plant.params import Rotor
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
    """Inverse of the thrust map: rpm = (b + sqrt(b^2 + four_a counts)) inverse."""

    b: float
    four_a: float
    inverse: float
    off_below: float  # counts


@jitted
def motor_speed(m: MapRecord, counts: float, rpm_max: float) -> float:
    """Commanded speed, rpm, not above ``rpm_max`` (what the battery allows)."""
    if counts < m.off_below:
        return 0.0
    return min((m.b + math.sqrt(m.b * m.b + m.four_a * counts)) * m.inverse, rpm_max)


def set_up_map(m: MapRecord, rotor: Rotor) -> MapRecord:
    """Fill in a record for the nominal static map and the thrust limits of a rotor."""
    n_per_count = rotor.thrust_max_n / COUNTS_MAX
    m.b = -rotor.thrust_linear_n_rpm
    m.four_a = 4.0 * rotor.thrust_square_n_rpm2 * n_per_count
    m.inverse = 0.5 / rotor.thrust_square_n_rpm2
    m.off_below = rotor.thrust_min_n / n_per_count
    return m
