"""Legacy power distribution and the thrust map: counts to rotor speed commands.

After firmware power_distribution_quadrotor.c and motors.c: what a motor lacks above 65535 counts is taken
from all four; counts are linear in thrust (65535 = THRUST_MAX) since the battery is compensated for; below
THRUST_MIN a motor stops.
"""

from __future__ import annotations

import math

from sim.params import Rotor
from sim.rotors import Four

COUNTS_MAX = 65535.0
OFF: Four = (0.0, 0.0, 0.0, 0.0)


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


class ThrustMap:
    """Counts of a motor to the speed that gives that thrust with the nominal propeller.

    Args:
        rotor: nominal static map and thrust limits.
    """

    __slots__ = ("_b", "_bb", "_four_a", "_inverse", "_n_per_count", "_off_below")

    def __init__(self, rotor: Rotor) -> None:
        self._b = -rotor.thrust_linear_n_rpm
        self._bb = self._b * self._b
        self._n_per_count = rotor.thrust_max_n / COUNTS_MAX
        self._four_a = 4.0 * rotor.thrust_square_n_rpm2 * self._n_per_count
        self._inverse = 0.5 / rotor.thrust_square_n_rpm2
        self._off_below = rotor.thrust_min_n / self._n_per_count

    def speeds(self, counts: Four, rpm_max: float) -> Four:
        """Commanded speeds, rpm, not above ``rpm_max`` (what the battery allows)."""
        b, bb, k, inverse, off = self._b, self._bb, self._four_a, self._inverse, self._off_below
        sqrt = math.sqrt
        m1, m2, m3, m4 = counts
        r1 = (b + sqrt(bb + k * m1)) * inverse if m1 >= off else 0.0
        r2 = (b + sqrt(bb + k * m2)) * inverse if m2 >= off else 0.0
        r3 = (b + sqrt(bb + k * m3)) * inverse if m3 >= off else 0.0
        r4 = (b + sqrt(bb + k * m4)) * inverse if m4 >= off else 0.0
        if r1 > rpm_max or r2 > rpm_max or r3 > rpm_max or r4 > rpm_max:
            return (min(r1, rpm_max), min(r2, rpm_max), min(r3, rpm_max), min(r4, rpm_max))
        return (r1, r2, r3, r4)
