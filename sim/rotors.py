"""Four rotors: lag, thrust, drag torque, reaction and gyroscopic torque, ground effect, battery.

Body frame FLU. M1 front right turns counter-clockwise, M2 rear right clockwise, M3 rear left
counter-clockwise, M4 front left clockwise (seen from above; firmware power_distribution_quadrotor.c). A
counter-clockwise rotor turns the body clockwise, which is a negative yaw torque.

With MIX_YAW_i = -1 for counter-clockwise rotors, the rotors' angular momentum is h_z = -I_p sum(MIX_YAW_i
w_i), and the body feels -dh/dt - w x h.
"""

from __future__ import annotations

import math

from sim.params import Battery, Plant, Rotor

Four = tuple[float, float, float, float]

RAD_S_PER_RPM = 2.0 * math.pi / 60.0
POSITION_X = (1, -1, -1, 1)  # sign of a rotor's x, M1..M4
POSITION_Y = (-1, -1, 1, 1)
MIX_YAW = (-1, 1, -1, 1)


class Rotors:
    """Rotor speeds and the wrench they make. Plain floats: this runs every physics step.

    Attributes:
        rpm: speeds of M1..M4.
        thrust_n: sum of the thrusts, along body z.
        torque_x, torque_y, torque_z: torque on the body, N m.

    Args:
        rotor: static maps, lag, geometry.
        plant: factors on thrust (and with it torque) and on the lag.
        slow: the slow, asymmetric lag instead of the first-order one.
        step_s: time between calls of ``step``.
    """

    __slots__ = (
        "_arm", "_gain", "_gyro", "_p1", "_p2", "_q1", "_q2", "_reaction", "_slow_fall", "_slow_rise", "rpm",
        "slow", "thrust_n", "torque_x", "torque_y", "torque_z",
    )  # fmt: skip

    def __init__(self, rotor: Rotor, plant: Plant, slow: bool, step_s: float) -> None:
        self._p1 = rotor.thrust_linear_n_rpm * plant.thrust
        self._p2 = rotor.thrust_square_n_rpm2 * plant.thrust
        self._q1 = rotor.torque_linear_n_m_rpm * plant.thrust
        self._q2 = rotor.torque_square_n_m_rpm2 * plant.thrust
        self._arm = rotor.arm_m
        self._gyro = rotor.inertia_kg_m2 * RAD_S_PER_RPM
        self._reaction = self._gyro / step_s
        self._gain = -math.expm1(-step_s / (rotor.lag_s * plant.motor_lag))  # exact for a held command
        self._slow_rise = -math.expm1(-step_s * rotor.slow_rise_1_s / plant.motor_lag)
        self._slow_fall = step_s * rotor.slow_fall_1_rpm_s / plant.motor_lag
        self.slow = slow
        self.rpm: Four = (0.0, 0.0, 0.0, 0.0)
        self.thrust_n = self.torque_x = self.torque_y = self.torque_z = 0.0

    def step(self, command: Four, factors: Four | None, wx: float, wy: float) -> None:
        """Advance the speeds towards ``command`` (rpm) and compute the wrench.

        Args:
            command: commanded speeds, rpm.
            factors: ground-effect factors on the thrusts, or None for none.
            wx: body roll rate, rad/s.
            wy: body pitch rate, rad/s.
        """
        r1, r2, r3, r4 = self.rpm
        c1, c2, c3, c4 = command
        d1, d2, d3, d4 = c1 - r1, c2 - r2, c3 - r3, c4 - r4
        if self.slow:
            rise, fall = self._slow_rise, self._slow_fall
            d1 *= rise if d1 > 0.0 else fall * (c1 + r1)
            d2 *= rise if d2 > 0.0 else fall * (c2 + r2)
            d3 *= rise if d3 > 0.0 else fall * (c3 + r3)
            d4 *= rise if d4 > 0.0 else fall * (c4 + r4)
        else:
            gain = self._gain
            d1, d2, d3, d4 = gain * d1, gain * d2, gain * d3, gain * d4
        r1, r2, r3, r4 = r1 + d1, r2 + d2, r3 + d3, r4 + d4
        self.rpm = (r1, r2, r3, r4)
        p1, p2, q1, q2 = self._p1, self._p2, self._q1, self._q2
        t1, t2, t3, t4 = (p1 + p2 * r1) * r1, (p1 + p2 * r2) * r2, (p1 + p2 * r3) * r3, (p1 + p2 * r4) * r4
        if (
            r1 < 3000.0 or r2 < 3000.0 or r3 < 3000.0 or r4 < 3000.0
        ):  # the fitted parabola dips below zero there
            t1, t2, t3, t4 = max(t1, 0.0), max(t2, 0.0), max(t3, 0.0), max(t4, 0.0)
        if factors is not None:
            f1, f2, f3, f4 = factors
            t1, t2, t3, t4 = f1 * t1, f2 * t2, f3 * t3, f4 * t4
        spin = self._gyro * (r2 + r4 - r1 - r3)  # I_p sum(MIX_YAW_i w_i) = -h_z
        arm = self._arm
        self.thrust_n = t1 + t2 + t3 + t4
        self.torque_x = arm * (t3 + t4 - t1 - t2) + wy * spin
        self.torque_y = arm * (t2 + t3 - t1 - t4) - wx * spin
        self.torque_z = (
            (q1 + q2 * r2) * r2 + (q1 + q2 * r4) * r4 - (q1 + q2 * r1) * r1 - (q1 + q2 * r3) * r3
        ) + self._reaction * (d2 + d4 - d1 - d3)


class GroundEffect:
    """Thrust gain close to a surface: Cheeseman and Bennett 1955, T/T0 = 1 / (1 - (R/4h)^2), per rotor.

    ``gain`` multiplies the increase: measurements on small quadrotors lie 1 to 4 times above the formula
    (Sanchez-Cuevas 2017). Heights below 20 mm count as 20 mm; the effect fades out between 3 R and 4 R. A
    rotor over the edge of the pad gets the share of its disc that is over the pad, linear across its
    diameter.
    """

    __slots__ = ("_above", "_arm", "_gain", "_pad_radius", "_radius", "_reach")

    HEIGHT_MIN_M = 0.020

    def __init__(self, rotor: Rotor, gain: float, pad_radius_m: float) -> None:
        self._radius = rotor.radius_m
        self._arm = rotor.arm_m
        self._above = rotor.above_com_m
        self._gain = gain
        self._pad_radius = pad_radius_m
        self._reach = 4.0 * rotor.radius_m + rotor.arm_m + rotor.above_com_m  # whatever the tilt

    def increase(self, height_m: float) -> float:
        """Return T/T0 - 1 of one rotor whose disc is ``height_m`` above a wide surface."""
        radius = self._radius
        if height_m >= 4.0 * radius or height_m < -self.HEIGHT_MIN_M:
            return 0.0
        ratio = radius / (4.0 * max(height_m, self.HEIGHT_MIN_M))
        square = ratio * ratio
        fade = min(1.0, 4.0 - height_m / radius)
        return self._gain * square / (1.0 - square) * fade * fade * (3.0 - 2.0 * fade)

    def factors(
        self, ex: float, ey: float, ez: float, pad_height_m: float, axes: tuple[float, ...]
    ) -> Four | None:
        """Factors on the four thrusts, or None when nothing is near.

        Args:
            ex: vehicle minus pad centre, east, m.
            ey: the same, north.
            ez: the same, up.
            pad_height_m: height of the pad above the floor.
            axes: body x, y and z axis in the world, nine numbers.
        """
        height = ez + pad_height_m
        reach = self._reach
        outer = self._pad_radius + reach
        over_pad = ez < reach and ex * ex + ey * ey < outer * outer
        if not over_pad and height >= reach:
            return None
        xx, xy, xz, yx, yy, yz, zx, zy, zz = axes
        if zz < 0.5:  # tilted by more than 60 degrees: no cushion
            return None
        arm, above, radius = self._arm, self._above, self._radius
        out = []
        for sx, sy in zip(POSITION_X, POSITION_Y, strict=True):
            a, b = sx * arm, sy * arm
            rz = ez + a * xz + b * yz + above * zz
            increase = self.increase(rz + pad_height_m)
            if over_pad and rz > 0.0:
                rx = ex + a * xx + b * yx + above * zx
                ry = ey + a * xy + b * yy + above * zy
                inside = 0.5 + (self._pad_radius - math.sqrt(rx * rx + ry * ry)) / (2.0 * radius)
                share = min(1.0, max(0.0, inside))
                increase = share * self.increase(rz) + (1.0 - share) * increase
            out.append(1.0 + increase)
        return (out[0], out[1], out[2], out[3])


class BatteryModel:
    """Voltage under load, and the rotor speed it still allows."""

    __slots__ = ("_battery", "_hover_power", "_used_a_s", "voltage_v")

    def __init__(self, battery: Battery, hover_rpm: float) -> None:
        self._battery = battery
        self._hover_power = 4.0 * hover_rpm**3
        self._used_a_s = 0.0
        self.voltage_v = battery.full_v - battery.resistance_ohm * battery.idle_current_a

    def step(self, rpm: Four, dt_s: float) -> None:
        """Draw current for ``dt_s``; power grows with the cube of the speed, scaled to the hover current."""
        b = self._battery
        power = (rpm[0] ** 3 + rpm[1] ** 3 + rpm[2] ** 3 + rpm[3] ** 3) / self._hover_power
        current = b.idle_current_a + b.hover_current_a * power
        self._used_a_s = min(b.charge_a_s, self._used_a_s + current * dt_s)
        rest = b.full_v - (b.full_v - b.empty_v) * self._used_a_s / b.charge_a_s
        self.voltage_v = rest - b.resistance_ohm * current

    @property
    def rpm_max(self) -> float:
        """Speed at full duty cycle."""
        return self._battery.speed_at_zero_v_rpm + self._battery.speed_per_volt_rpm * self.voltage_v
