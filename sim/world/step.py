"""Steps of 1 ms of vehicle and deck; where they may touch, MuJoCo makes the step."""

from __future__ import annotations

import math
from collections.abc import Sequence

from flightstack.compiled.foreign import call, doubles
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Record
from sim.plant.params import STEP_S
from sim.plant.rotation import rotation_axes
from sim.world.bodies import (
    BodyRecord,
    DeckRecord,
    WrenchRecord,
    gyroscopic,
    midpoint_rates,
    move_body,
    move_deck,
)
from sim.world.contact import PAD, touched
from sim.world.rest import RestRecord, carried, look

TUMBLE_COS = 0.5  # 60 degrees


class ReachRecord(Record):
    """How far the shapes extend, m, margin included."""

    vehicle: float  # radius about the centre of mass
    side: float  # radius of the cylinder around it, about the body's z axis
    bottom: float  # bottom of the cylinder along that axis, below zero
    top: float
    robot: float  # radius about the pad's axis
    robot_top: float  # above the pad


class MujocoRecord(Record):
    """Addresses of MuJoCo's function ``mj_step``, of its model and data, and of numbers in the data."""

    mj_step: int
    mj_model: int
    mj_data: int
    positions: int  # QPOS of them
    velocities: int  # QVEL
    applied: int  # generalised forces, QVEL
    sensors: int  # readings of the state before the step, see SENSORS


class WorldRecord(Record):
    """The vehicle's body and the deck."""

    body: BodyRecord
    deck: DeckRecord
    reach: ReachRecord
    wrench: WrenchRecord
    contacts: int  # ``ContactBit`` of the state the last step began with
    rest: RestRecord
    mujoco: MujocoRecord


@jitted
def apart(reach: ReachRecord, body: BodyRecord, deck: DeckRecord) -> bool:
    """Return whether vehicle and floor, and vehicle and robot, cannot touch; False for NaN.

    ``reach``: bounds; ``body``: the vehicle's; ``deck``: the pad's.
    """
    p, d, below = body.position, deck.position, reach.vehicle
    x, y, z = p[0] - d[0], p[1] - d[1], p[2] - d[2]
    square, beside = x * x + y * y, reach.vehicle + reach.robot
    if not (p[2] > below and z > below + reach.robot_top):  # near: how far the tilted cylinder reaches down
        axes = rotation_axes(body.quaternion)
        level, up = math.sqrt(axes[6] * axes[6] + axes[7] * axes[7]), axes[8]
        below = reach.side * level - min(reach.bottom * up, reach.top * up)
    above = z > below + reach.robot_top and square >= 0.0
    return bool(p[2] > below and (above or square > beside * beside))


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
    better; so a step of MuJoCo's that finds no contact does not count. It moves nothing but the vehicle. One
    that rests on the pad is carried, and its contacts stay as they are.
    """
    if carried(world.rest, world.wrench, world.body, world.deck):
        return
    m = world.mujoco
    world.contacts = 0
    if not apart(world.reach, world.body, world.deck):
        ask(world)
        call(m.mj_step, m.mj_model, m.mj_data)
        world.contacts = touched(doubles(m.sensors), world.deck.position[2])
    if world.contacts:
        answer(world.body, m)
    else:
        move_body(world.body, world.wrench)
    move_deck(world.deck)
    look(world.rest, world.body, world.deck, world.contacts == PAD)


@jitted
def tumbled(quaternion: Sequence[float] | F64) -> bool:
    """Whether the body's z axis is tilted by more than 60 degrees."""
    x, y = quaternion[1], quaternion[2]
    return bool(x * x + y * y > 0.5 * (1.0 - TUMBLE_COS))  # body z axis: 1 - 2 (x^2 + y^2)
