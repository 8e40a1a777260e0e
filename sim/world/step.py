"""Steps of 1 ms of vehicle and deck; where they may touch, MuJoCo makes the step.

The vehicle is a rigid body. Its rates follow the implicit midpoint rule, which keeps the energy of a free
rotation; position and attitude follow the mean of the velocities before and after the step, which makes
constant acceleration exact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from flightstack.compiled.foreign import call, doubles
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Quaternion, Record, Vector
from sim.plant.params import STEP_S
from sim.world.contact import touched

TUMBLE_COS = 0.5  # 60 degrees


class BodyRecord(Record):
    """The vehicle's rigid body: centre of mass ENU, m and m/s; body FLU in world ENU."""

    position: Vector
    velocity: Vector
    quaternion: Quaternion
    rates: Vector  # body frame, rad/s


class DeckRecord(Record):
    """Pad centre (top), ENU, and the arc on which it moves: how a step turns and shifts it."""

    position: Vector
    velocity: Vector
    yaw: float
    rate: float
    cos_turn: float
    sin_turn: float
    along: float  # of one step, per m/s
    across: float


class ReachRecord(Record):
    """How far the shapes extend, m, margin included."""

    vehicle: float  # radius about the centre of mass
    robot: float  # radius about the pad's axis
    robot_top: float  # above the pad


class WrenchRecord(Record):
    """Force and torque on the vehicle, and what they move."""

    force: Vector  # on the centre of mass, weight included, world frame, N
    torque: Vector  # body frame, N m
    mass: float  # kg
    inertia: Vector  # kg m^2


class MujocoRecord(Record):
    """Addresses of MuJoCo's function ``mj_step``, of its model and data, and of numbers in the data."""

    mj_step: int
    mj_model: int
    mj_data: int
    positions: int  # QPOS of them
    velocities: int  # QVEL
    applied: int  # generalised forces, QVEL
    sensors: int  # of the state the step began with, SENSORS


class WorldRecord(Record):
    """The vehicle's body and the deck."""

    body: BodyRecord
    deck: DeckRecord
    reach: ReachRecord
    wrench: WrenchRecord
    contacts: int  # ``ContactBit`` of the state the last step began with
    mujoco: MujocoRecord


@jitted
def apart(reach: ReachRecord, vehicle: F64, deck: F64) -> bool:
    """Return whether vehicle and floor, and vehicle and robot, cannot touch; False for NaN.

    Args:
        reach: bounds.
        vehicle: centre of mass, ENU, m.
        deck: pad centre, ENU, m.
    """
    x, y, z = vehicle[0] - deck[0], vehicle[1] - deck[1], vehicle[2] - deck[2]
    square, beside = x * x + y * y, reach.vehicle + reach.robot
    above = z > reach.vehicle + reach.robot_top and square >= 0.0
    return bool(vehicle[2] > reach.vehicle and (above or square > beside * beside))


@jitted
def gyroscopic(inertia: F64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Angular velocity cross angular momentum, body frame."""
    jx, jy, jz = inertia[0], inertia[1], inertia[2]
    return ((jz - jy) * y * z, (jx - jz) * z * x, (jy - jx) * x * y)


@jitted
def midpoint_rates(rates: F64, s: WrenchRecord) -> tuple[float, float, float]:
    """Rates in the middle of the step, rad/s."""
    half = 0.5 * STEP_S
    x, y, z = rates[0], rates[1], rates[2]
    for _ in range(4):  # each gains a factor of rate times half a step, 0.01 at most
        gx, gy, gz = gyroscopic(s.inertia, x, y, z)
        x = rates[0] + half * (s.torque[0] - gx) / s.inertia[0]
        y = rates[1] + half * (s.torque[1] - gy) / s.inertia[1]
        z = rates[2] + half * (s.torque[2] - gz) / s.inertia[2]
    return x, y, z


@jitted
def rotate(q: F64, x: float, y: float, z: float) -> None:
    """Turn a unit quaternion by a rotation vector in the body frame, rad."""
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
    """Move the vehicle on by one step without contact."""
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
    """Cosine and sine of the turn of one step, and how far it goes along and across, per m/s; rad/s."""
    turn = rate * STEP_S
    sine = math.sin(0.5 * turn)
    chord = sine / (0.5 * turn) if turn else 1.0  # chord over arc length
    along, across = chord * math.cos(0.5 * turn) * STEP_S, chord * sine * STEP_S
    return math.cos(turn), math.sin(turn), along, across


@jitted
def move_deck(deck: DeckRecord) -> None:
    """Move the deck on by one step."""
    p, v = deck.position, deck.velocity
    vx, vy, vz = v[0], v[1], v[2]
    p[0] += deck.along * vx - deck.across * vy
    p[1] += deck.along * vy + deck.across * vx
    p[2] += STEP_S * vz
    v[0] = deck.cos_turn * vx - deck.sin_turn * vy
    v[1] = deck.cos_turn * vy + deck.sin_turn * vx
    deck.yaw += deck.rate * STEP_S


@jitted
def ask(world: WorldRecord) -> None:
    """Hand the step to MuJoCo."""
    body, deck, s = world.body, world.deck, world.wrench
    positions, velocities = doubles(world.mujoco.positions), doubles(world.mujoco.velocities)
    applied = doubles(world.mujoco.applied)
    for i in range(3):
        positions[i], velocities[i], velocities[3 + i] = body.position[i], body.velocity[i], body.rates[i]
        positions[7 + i], velocities[6 + i] = deck.position[i], deck.velocity[i]
    for i in range(4):
        positions[3 + i] = body.quaternion[i]
    positions[10], velocities[9] = deck.yaw, deck.rate
    # A free joint takes its force in the world frame and its torque in the body frame. With this torque
    # MuJoCo's Euler step ends with the rates of the midpoint rule.
    before = gyroscopic(s.inertia, body.rates[0], body.rates[1], body.rates[2])
    middle = midpoint_rates(body.rates, s)
    for i in range(3):
        applied[i] = s.force[i]
        applied[3 + i] = before[i] + 2.0 / STEP_S * s.inertia[i] * (middle[i] - body.rates[i])


@jitted
def answer(body: BodyRecord, m: MujocoRecord) -> None:
    """Take the vehicle's state from MuJoCo."""
    positions, velocities = doubles(m.positions), doubles(m.velocities)
    for i in range(3):
        body.position[i], body.velocity[i], body.rates[i] = positions[i], velocities[i], velocities[3 + i]
    for i in range(4):
        body.quaternion[i] = positions[3 + i]


@jitted
def physics_step(world: WorldRecord) -> None:
    """Advance by one step.

    MuJoCo's Euler step moves position and attitude with the velocities at its end, which ``move_body`` does
    better; so a step of MuJoCo's that finds no contact does not count. It moves nothing but the vehicle.
    """
    m = world.mujoco
    world.contacts = 0
    if not apart(world.reach, world.body.position, world.deck.position):
        ask(world)
        call(m.mj_step, m.mj_model, m.mj_data)
        world.contacts = touched(doubles(m.sensors), world.deck.position[2])
    if world.contacts:
        answer(world.body, m)
    else:
        move_body(world.body, world.wrench)
    move_deck(world.deck)


@jitted
def tumbled(quaternion: Sequence[float] | F64) -> bool:
    """Whether the body's z axis is tilted by more than 60 degrees."""
    x, y = quaternion[1], quaternion[2]
    return bool(x * x + y * y > 0.5 * (1.0 - TUMBLE_COS))  # body z axis: 1 - 2 (x^2 + y^2)
