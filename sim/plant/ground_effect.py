"""Thrust gain close to a surface: Cheeseman and Bennett 1955, T/T0 = 1 / (1 - (R/4h)^2), per rotor.

``gain`` multiplies the increase: measured increases of small quadrotors are 1 to 4 times the formula's
(Sanchez-Cuevas 2017). Heights below 20 mm are treated as 20 mm. The effect fades out between 3 R and 4 R.
Over the pad's edge, the fraction of a rotor's disc that is over the pad is linear across the diameter.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Record
from sim.plant.params import Rotor
from sim.plant.rotation import Nine
from sim.plant.rotors import POSITION_X, POSITION_Y

HEIGHT_MIN_M = 0.020
UPRIGHT_COS = 0.5  # cosine of the largest tilt with ground effect, 60 degrees


class GroundRecord(Record):
    """Parameters of the ground effect; lengths in m."""

    radius: float
    arm: float
    above: float  # height of the rotor plane above the centre of mass
    gain: float  # factor on the increase of the thrust
    pad_radius: float
    reach: float  # largest height of the centre of mass with a ground effect, at any tilt


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
    """Compute the factors on the four thrusts; a factor is 1 without a surface nearby.

    ``ex``, ``ey``, ``ez``: vehicle minus pad centre, ENU, m; ``pad_height_m``: height of the pad above the
    floor; ``axes``: body axes in the world.
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
