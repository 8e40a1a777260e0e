"""Motion of the vehicle's rigid body without contact, and of the deck, which moves on an arc.

The body rates follow the implicit midpoint rule, which keeps the energy of a free rotation. Position and
attitude use the mean of the velocities before and after the step, which is exact for constant acceleration.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Quaternion, Record, Vector
from sim.plant.params import STEP_S


class BodyRecord(Record):
    """Vehicle's rigid body: centre of mass in ENU, m and m/s; attitude of body FLU in world ENU."""

    position: Vector
    velocity: Vector
    quaternion: Quaternion
    rates: Vector  # angular velocity, body frame, rad/s


class DeckRecord(Record):
    """State of the pad centre (top side) in ENU, and the rotation and displacement of one step on its arc."""

    position: Vector
    velocity: Vector
    yaw: float
    rate: float
    cos_turn: float
    sin_turn: float
    along: float  # displacement along the velocity in one step, per m/s
    across: float  # displacement to the left of the velocity in one step, per m/s


class WrenchRecord(Record):
    """Force and torque on the vehicle, and its mass and inertia."""

    force: Vector  # force on the centre of mass, weight included, world frame, N
    torque: Vector  # torque about the centre of mass, body frame, N m
    mass: float  # mass of the vehicle, kg
    inertia: Vector  # moments of inertia, body axes, kg m^2


@jitted
def gyroscopic(inertia: F64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the cross product of angular velocity and angular momentum, body frame, N m."""
    jx, jy, jz = inertia[0], inertia[1], inertia[2]
    return ((jz - jy) * y * z, (jx - jz) * z * x, (jy - jx) * x * y)


@jitted
def midpoint_rates(rates: F64, s: WrenchRecord) -> tuple[float, float, float]:
    """Return the body rates in the middle of the step, rad/s."""
    half = 0.5 * STEP_S
    x, y, z = rates[0], rates[1], rates[2]
    for _ in range(4):  # each iteration multiplies the error by (rate * half a step), which is at most 0.01
        gx, gy, gz = gyroscopic(s.inertia, x, y, z)
        x = rates[0] + half * (s.torque[0] - gx) / s.inertia[0]
        y = rates[1] + half * (s.torque[1] - gy) / s.inertia[1]
        z = rates[2] + half * (s.torque[2] - gz) / s.inertia[2]
    return x, y, z


@jitted
def rotate(q: F64, x: float, y: float, z: float) -> None:
    """Rotate a unit quaternion by a rotation vector in the body frame, rad."""
    half = 0.5 * math.sqrt(x * x + y * y + z * z)
    share = 0.5 * math.sin(half) / half if half > 0.0 else 0.5
    x, y, z, turn = share * x, share * y, share * z, math.cos(half)
    a, b, c, d = q[0], q[1], q[2], q[3]
    w, i = a * turn - b * x - c * y - d * z, b * turn + a * x + c * z - d * y
    j, k = c * turn + a * y + d * x - b * z, d * turn + a * z + b * y - c * x
    scale = 1.0 / math.sqrt(w * w + i * i + j * j + k * k)
    q[0], q[1], q[2], q[3] = w * scale, i * scale, j * scale, k * scale


@jitted
def move_body(body: BodyRecord, s: WrenchRecord) -> None:
    """Advance the vehicle by one step without contact."""
    x, y, z = midpoint_rates(body.rates, s)
    rotate(body.quaternion, STEP_S * x, STEP_S * y, STEP_S * z)
    body.rates[0] = 2.0 * x - body.rates[0]
    body.rates[1] = 2.0 * y - body.rates[1]
    body.rates[2] = 2.0 * z - body.rates[2]
    for i in range(3):
        half_gain = 0.5 * STEP_S * s.force[i] / s.mass
        body.position[i] += STEP_S * (body.velocity[i] + half_gain)
        body.velocity[i] += 2.0 * half_gain


@jitted
def arc_of_step(rate: float) -> tuple[float, float, float, float]:
    """Return cosine and sine of one step's turn, then ``along`` and ``across``; ``rate``: rad/s."""
    turn = rate * STEP_S
    sine = math.sin(0.5 * turn)
    chord = sine / (0.5 * turn) if turn else 1.0  # ratio of chord to arc length
    along, across = chord * math.cos(0.5 * turn) * STEP_S, chord * sine * STEP_S
    return math.cos(turn), math.sin(turn), along, across


@jitted
def move_deck(deck: DeckRecord) -> None:
    """Advance the deck by one step."""
    p, v = deck.position, deck.velocity
    vx, vy, vz = v[0], v[1], v[2]
    p[0] += deck.along * vx - deck.across * vy
    p[1] += deck.along * vy + deck.across * vx
    p[2] += STEP_S * vz
    v[0] = deck.cos_turn * vx - deck.sin_turn * vy
    v[1] = deck.cos_turn * vy + deck.sin_turn * vx
    deck.yaw += deck.rate * STEP_S
