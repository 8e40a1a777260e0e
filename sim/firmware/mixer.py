"""The firmware's legacy power distribution and thrust map, which convert counts to rotor speed commands.

The mixer follows firmware power_distribution_quadrotor.c and motors.c: the excess of a motor above full duty
is subtracted from all four motors. In the firmware's map, counts are linear in thrust (65535 = THRUST_MAX).
Below THRUST_MIN a motor stops. A map to volts (``Rotor.volt_map``) converts counts to volts, limited to the
battery voltage; without this map counts are limited to 65535.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Motors, Record
from sim.plant.params import Battery, Four, Params, Rotor

COUNTS_MAX = 65535.0
VOLTS_FIRST = 3.0  # initial value of Newton's method, V
NEWTON_STEPS = 6  # number of steps from 3 V to any result from 0.5 to 6 V; error below 1e-9 V
OFF: Four = (0.0, 0.0, 0.0, 0.0)


@jitted
def spread(thrust: float, moments: tuple[int, int, int]) -> Four:
    """Return unlimited counts of M1..M4 from thrust and moment counts about body x, y, z (FLU)."""
    mx, my, mz = moments
    r, p = int(mx / 2), int(my / 2)  # the firmware truncates the halves to int16
    return (thrust - r - p - mz, thrust - r + p + mz, thrust + r + p - mz, thrust + r - p + mz)


@jitted
def cap(motors: Four, most: float) -> Four:
    """Subtract the excess of a motor above ``most`` from all four; no result is below 0."""
    m1, m2, m3, m4 = motors
    if m1 > most or m2 > most or m3 > most or m4 > most:
        excess = max(m1, m2, m3, m4) - most
        m1, m2, m3, m4 = m1 - excess, m2 - excess, m3 - excess, m4 - excess
    if m1 < 0.0 or m2 < 0.0 or m3 < 0.0 or m4 < 0.0:
        return (max(0.0, m1), max(0.0, m2), max(0.0, m3), max(0.0, m4))
    return (m1, m2, m3, m4)


class MapRecord(Record):
    """Inverse of the thrust map: rpm = (b + sqrt(b^2 + four_a counts)) inverse.

    With ``in_volts``, ``volt_map`` maps a voltage to counts, and the duty cycle is this voltage divided by
    the battery voltage: rpm = no_duty_rpm + duty (rpm_max - no_duty_rpm).
    """

    in_volts: bool
    volt_map: Motors
    at_zero_rpm: float
    per_volt_rpm: float
    no_duty_rpm: float  # motor speed at duty cycle 0 (``speed_at_no_duty``), rpm
    b: float
    four_a: float
    inverse: float
    off_below: float  # counts below which a motor stops


@jitted
def motor_speed(m: MapRecord, counts: float, rpm_max: float) -> float:
    """Return the commanded speed of a motor, rpm; the battery limits it to ``rpm_max``."""
    if counts < m.off_below:
        return 0.0
    return min((m.b + math.sqrt(m.b * m.b + m.four_a * counts)) * m.inverse, rpm_max)


@jitted
def motor_volts(m: MapRecord, counts: float) -> float:
    """Return the commanded mean voltage of a motor, V; 0: the motor stops."""
    if counts < m.off_below:
        return 0.0
    k, share, volts = m.volt_map, counts / COUNTS_MAX, VOLTS_FIRST
    for _ in range(NEWTON_STEPS):
        value = k[0] + volts * (k[1] + volts * (k[2] + volts * k[3])) - share
        volts -= value / (k[1] + volts * (2.0 * k[2] + volts * 3.0 * k[3]))
    return volts


@jitted
def motor_speeds(
    m: MapRecord, thrust: float, moments: tuple[int, int, int], rpm_max: float, commands: F64
) -> None:
    """Compute the commanded speeds of M1..M4, rpm; ``rpm_max``: speed at full duty cycle."""
    wanted = spread(thrust, moments)
    if not m.in_volts:
        counts = cap(wanted, COUNTS_MAX)
        for i in range(4):
            commands[i] = motor_speed(m, counts[i], rpm_max)
        return
    battery_v = (rpm_max - m.at_zero_rpm) / m.per_volt_rpm
    per_v = (rpm_max - m.no_duty_rpm) / battery_v
    w1, w2, w3, w4 = wanted
    volts = cap((motor_volts(m, w1), motor_volts(m, w2), motor_volts(m, w3), motor_volts(m, w4)), battery_v)
    for i in range(4):
        commands[i] = m.no_duty_rpm + per_v * volts[i] if volts[i] > 0.0 else 0.0


def set_up_map(m: MapRecord, rotor: Rotor, battery: Battery) -> MapRecord:
    """Fill in the record for the nominal static map and the thrust limits of a rotor."""
    m.at_zero_rpm, m.per_volt_rpm = battery.speed_at_zero_v_rpm, battery.speed_per_volt_rpm
    if rotor.volt_map is not None:
        m.in_volts, m.volt_map[:] = True, rotor.volt_map
    n_per_count = rotor.thrust_max_n / COUNTS_MAX
    m.b = -rotor.thrust_linear_n_rpm
    m.four_a = 4.0 * rotor.thrust_square_n_rpm2 * n_per_count
    m.inverse = 0.5 / rotor.thrust_square_n_rpm2
    m.off_below = rotor.thrust_min_n / n_per_count
    return m


def counts_per_n(params: Params, thrust_n: float, battery_v: float | None = None) -> float:
    """Return the thrust-command counts per newton of total thrust, for four nominal motors near hover.

    ``battery_v``: battery voltage, V; None: that of a half-empty battery.
    """
    rotor, battery = params.rotor, params.battery
    if rotor.volt_map is None:
        return COUNTS_MAX / (4.0 * rotor.thrust_max_n)
    if battery_v is None:
        battery_v = 0.5 * (battery.full_v + battery.empty_v) - battery.hover_sag_v
    volts = battery_v * battery.hover_duty(rotor.rpm(thrust_n / 4.0), battery_v)
    k0, k1, k2, k3 = rotor.volt_map
    return COUNTS_MAX * (k0 + volts * (k1 + volts * (k2 + volts * k3))) / thrust_n


def moments_of(counts: Sequence[float]) -> tuple[int, int, int]:
    """Return moment counts about body x, y, z for which ``spread`` gives these differences between M1..M4."""
    m1, m2, m3, m4 = counts
    return (
        round((m3 + m4 - m1 - m2) / 2.0),
        round((m2 + m3 - m1 - m4) / 2.0),
        round((m2 + m4 - m1 - m3) / 4.0),
    )
