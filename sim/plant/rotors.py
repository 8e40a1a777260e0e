"""The drive: four rotors with lag, thrust and torques, and the battery that limits their speed.

Body frame FLU. Seen from above, M1 (front right) turns counter-clockwise, M2 (rear right) clockwise, M3 (rear
left) counter-clockwise, M4 (front left) clockwise (firmware power_distribution_quadrotor.c). A
counter-clockwise rotor turns the body clockwise, which is a negative yaw torque.

With MIX_YAW_i = -1 for counter-clockwise rotors, the rotors' angular momentum is h_z = -I_p sum(MIX_YAW_i
w_i), and the torque -dh/dt - w x h acts on the body.

The thrust of a rotor near a surface follows Cheeseman and Bennett 1955: T/T0 = 1 / (1 - (R/4h)^2). ``gain``
multiplies the increase. Measured increases of small quadrotors are 1 to 4 times those of the formula
(Sanchez-Cuevas 2017). Heights h below 20 mm are treated as 20 mm. The effect fades out from h = 3 R to 4 R.
At the pad's edge, the fraction of a rotor's disc over the pad is linear in the distance from the edge.
"""

from __future__ import annotations

import math
from dataclasses import fields

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Motors, Record
from sim.plant.params import Battery, Plant, Rotor
from sim.plant.states import Nine

RAD_S_PER_RPM = 2.0 * math.pi / 60.0
POSITION_X = (1, -1, -1, 1)  # signs of the x positions of the rotors M1..M4
POSITION_Y = (-1, -1, 1, 1)  # signs of the y positions of the rotors M1..M4
MIX_YAW = (-1, 1, -1, 1)
ALWAYS_POSITIVE_RPM = 3000.0  # below this speed the fitted thrust parabola can be negative


class RotorRecord(Record):
    """Rotor speeds, and the resulting force and torque on the body."""

    rpm: Motors
    share: Motors  # thrust and drag torque of each motor, divided by those of the mean motor
    thrust_n: float  # sum of the thrusts along body z
    torque_x: float  # torque on the body, N m
    torque_y: float
    torque_z: float
    ground_factors: Motors  # factors of the ground effect on the thrusts
    p1: float  # thrust = (p1 + p2 rpm) rpm, N
    p2: float
    q1: float  # drag torque = (q1 + q2 rpm) rpm, N m
    q2: float
    arm: float
    gyro: float  # angular momentum of a rotor divided by the rotor speed, N m s / rpm
    reaction: float  # torque on the body divided by a rotor's change of speed in one step, N m / rpm
    gain: float  # gain of the first-order lag in one step; exact for a constant command
    slow_rise: float
    slow_fall: float
    slow: bool


@jitted
def turn_rotors(r: RotorRecord, command: F64, wx: float, wy: float) -> None:
    """Advance the speeds towards ``command`` (rpm); compute force and torque; ``wx``, ``wy``: rad/s."""
    r1, r2, r3, r4 = r.rpm[0], r.rpm[1], r.rpm[2], r.rpm[3]
    c1, c2, c3, c4 = command[0], command[1], command[2], command[3]
    d1, d2, d3, d4 = c1 - r1, c2 - r2, c3 - r3, c4 - r4
    if r.slow:  # falling: d rpm/dt = k (c^2 - r^2), linearly implicit step of second order; rising: exact
        d1 *= r.slow_rise if d1 > 0.0 else r.slow_fall * (c1 + r1) / (1.0 + r.slow_fall * r1)
        d2 *= r.slow_rise if d2 > 0.0 else r.slow_fall * (c2 + r2) / (1.0 + r.slow_fall * r2)
        d3 *= r.slow_rise if d3 > 0.0 else r.slow_fall * (c3 + r3) / (1.0 + r.slow_fall * r3)
        d4 *= r.slow_rise if d4 > 0.0 else r.slow_fall * (c4 + r4) / (1.0 + r.slow_fall * r4)
    else:
        d1, d2, d3, d4 = r.gain * d1, r.gain * d2, r.gain * d3, r.gain * d4
    r1, r2, r3, r4 = r1 + d1, r2 + d2, r3 + d3, r4 + d4
    r.rpm[0], r.rpm[1], r.rpm[2], r.rpm[3] = r1, r2, r3, r4
    p1, p2, q1, q2 = r.p1, r.p2, r.q1, r.q2
    t1, t2, t3, t4 = (p1 + p2 * r1) * r1, (p1 + p2 * r2) * r2, (p1 + p2 * r3) * r3, (p1 + p2 * r4) * r4
    if min(r1, r2, r3, r4) < ALWAYS_POSITIVE_RPM:
        t1, t2, t3, t4 = max(t1, 0.0), max(t2, 0.0), max(t3, 0.0), max(t4, 0.0)
    f, s = r.ground_factors, r.share
    t1, t2, t3, t4 = f[0] * t1 * s[0], f[1] * t2 * s[1], f[2] * t3 * s[2], f[3] * t4 * s[3]
    spin = r.gyro * (r2 + r4 - r1 - r3)  # I_p sum(MIX_YAW_i w_i) = -h_z
    r.thrust_n = t1 + t2 + t3 + t4
    r.torque_x = r.arm * (t3 + t4 - t1 - t2) + wy * spin
    r.torque_y = r.arm * (t2 + t3 - t1 - t4) - wx * spin
    r.torque_z = (
        s[1] * ((q1 + q2 * r2) * r2)
        + s[3] * ((q1 + q2 * r4) * r4)
        - s[0] * ((q1 + q2 * r1) * r1)
        - s[2] * ((q1 + q2 * r3) * r3)
    ) + r.reaction * (d2 + d4 - d1 - d3)


def set_up_rotors(r: RotorRecord, rotor: Rotor, plant: Plant, slow: bool, step_s: float) -> None:
    """Initialise the record of resting rotors; ``slow``: with the slow, asymmetric lag."""
    r.p1 = rotor.thrust_linear_n_rpm * plant.thrust
    r.p2 = rotor.thrust_square_n_rpm2 * plant.thrust
    r.q1 = rotor.torque_linear_n_m_rpm * plant.thrust
    r.q2 = rotor.torque_square_n_m_rpm2 * plant.thrust
    r.arm = rotor.arm_m
    r.gyro = rotor.inertia_kg_m2 * RAD_S_PER_RPM
    r.reaction = r.gyro / step_s
    r.gain = -math.expm1(-step_s / (rotor.lag_s * plant.motor_lag))
    r.slow_rise = -math.expm1(-step_s * rotor.slow_rise_1_s / plant.motor_lag)
    r.slow_fall = step_s * rotor.slow_fall_1_rpm_s / plant.motor_lag
    r.slow = slow
    r.ground_factors[:], r.share[:] = 1.0, plant.motors


class BatteryRecord(Record):
    """Charge and voltage of the battery, and the parameters of ``params.Battery``."""

    voltage_v: float  # voltage under load, V
    sag_v: float  # voltage drop under load, V
    used_a_s: float
    hover_power: float  # sum of the cubed rotor speeds in hover, rpm^3
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
    """Discharge for ``dt_s``; the current of each motor is proportional to the cube of its speed."""
    power = 0.0
    for i in range(4):
        power += math.pow(rpm[i], 3.0)
    power /= b.hover_power
    current = b.idle_current_a + b.hover_current_a * power
    b.used_a_s = min(b.charge_a_s, b.used_a_s + current * dt_s)
    rest = b.full_v - (b.full_v - b.empty_v) * b.used_a_s / b.charge_a_s
    b.sag_v = b.resistance_ohm * current
    b.voltage_v = rest - b.sag_v


@jitted
def speed_at_no_duty(b: BatteryRecord) -> float:
    """Return the rotor speed at zero duty cycle, rpm, of the linear map from duty cycle to speed.

    Motors draw current in pulses. During a pulse the voltage is lower by sag / duty, so the mean motor
    voltage is duty * (voltage at rest) - sag. The voltage under load is (voltage at rest) - sag.
    """
    return b.speed_at_zero_v_rpm - b.speed_per_volt_rpm * b.sag_v


@jitted
def speed_limit(b: BatteryRecord) -> float:
    """Return the rotor speed at full duty cycle, rpm."""
    return b.speed_at_zero_v_rpm + b.speed_per_volt_rpm * b.voltage_v


def set_up_battery(b: BatteryRecord, battery: Battery, hover_rpm: float, charge: float) -> None:
    """Initialise the record; ``hover_rpm``: rotor speed at the hover current; ``charge``: 0 to 1."""
    b.hover_power = 4.0 * hover_rpm**3
    for field in fields(battery):
        setattr(b, field.name, getattr(battery, field.name))
    b.used_a_s = (1.0 - charge) * battery.charge_a_s
    rest_v = battery.full_v - (battery.full_v - battery.empty_v) * (1.0 - charge)
    b.sag_v = battery.resistance_ohm * battery.idle_current_a
    b.voltage_v = rest_v - b.sag_v


HEIGHT_MIN_M = 0.020
UPRIGHT_COS = 0.5  # cosine of the tilt above which no ground effect acts, 60 degrees


class GroundRecord(Record):
    """Parameters of the ground effect; lengths in m."""

    radius: float
    arm: float
    above: float  # height of the rotor plane above the centre of mass
    gain: float  # factor on the increase of the thrust
    pad_radius: float
    reach: float  # height of the centre of mass above which no ground effect acts at any tilt


@jitted
def thrust_increase(g: GroundRecord, height_m: float) -> float:
    """Return T/T0 - 1 of one rotor whose disc is ``height_m`` above a wide surface."""
    if height_m >= 4.0 * g.radius or height_m < -HEIGHT_MIN_M:
        return 0.0
    ratio = g.radius / (4.0 * max(height_m, HEIGHT_MIN_M))
    square = ratio * ratio
    fade = min(1.0, 4.0 - height_m / g.radius)
    return g.gain * square / (1.0 - square) * fade * fade * (3.0 - 2.0 * fade)


@jitted
def ground_effect(
    g: GroundRecord, ex: float, ey: float, ez: float, pad_height_m: float, axes: Nine, factors: F64
) -> None:
    """Compute the ground effect's factors on the four thrusts; a factor is 1 without a surface nearby.

    ``ex``, ``ey``, ``ez``: vehicle minus pad centre, ENU, m; ``pad_height_m``: height of the pad, m.
    """
    factors[:] = 1.0
    height = ez + pad_height_m
    outer = g.pad_radius + g.reach
    over_pad = ez < g.reach and ex * ex + ey * ey < outer * outer
    xx, xy, xz, yx, yy, yz, zx, zy, zz = axes
    if (not over_pad and height >= g.reach) or zz < UPRIGHT_COS:
        return
    for i in range(4):
        a, b = POSITION_X[i] * g.arm, POSITION_Y[i] * g.arm
        rz = ez + a * xz + b * yz + g.above * zz
        increase = thrust_increase(g, rz + pad_height_m)
        if over_pad and rz > 0.0:
            rx = ex + a * xx + b * yx + g.above * zx
            ry = ey + a * xy + b * yy + g.above * zy
            inside = 0.5 + (g.pad_radius - math.sqrt(rx * rx + ry * ry)) / (2.0 * g.radius)
            share = min(1.0, max(0.0, inside))
            increase = share * thrust_increase(g, rz) + (1.0 - share) * increase
        factors[i] = 1.0 + increase


def set_up_ground(g: GroundRecord, rotor: Rotor, gain: float, pad_radius_m: float) -> GroundRecord:
    """Initialise the record for one vehicle and a round pad; ``gain`` multiplies the increase."""
    g.radius, g.arm, g.above = rotor.radius_m, rotor.arm_m, rotor.above_com_m
    g.gain, g.pad_radius = gain, pad_radius_m
    g.reach = 4.0 * rotor.radius_m + rotor.arm_m + rotor.above_com_m
    return g
