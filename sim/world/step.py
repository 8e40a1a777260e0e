"""Physics steps of 1 ms of vehicle and deck; MuJoCo computes the step if they may be in contact."""

from __future__ import annotations

import math
from collections.abc import Sequence

from flightstack.compiled.foreign import Doubles, call, doubles
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Record
from logs.schema.events import ContactBit
from sim.plant.params import STEP_S
from sim.plant.states import rotation_axes
from sim.world.bodies import (
    BodyRecord,
    DeckRecord,
    WrenchRecord,
    gyroscopic,
    midpoint_rates,
    move_body,
    move_deck,
)
from sim.world.rest import RestRecord, carried, look

TOP_NORMAL = 0.7  # smallest |z| of the contact normal for a contact with the pad's top; about 45 degrees
RIM_M = 0.002  # depth below the pad's top beyond which a contact counts as contact with the edge, m

# Layout of the sensor readings: one for the floor, one for the robot below the pad, then all pad contacts.
PAD_CONTACTS = 16  # maximum number of pad contacts: up to two for each of the vehicle's nine shapes
PER_CONTACT = 7  # values per contact: whether it exists, position (world, m), normal
SENSORS = 2 + PAD_CONTACTS * PER_CONTACT


PAD, GROUND, ROBOT, PAD_EDGE = (
    ContactBit.PAD.value, ContactBit.GROUND.value, ContactBit.ROBOT.value, ContactBit.PAD_EDGE.value,
)  # fmt: skip


@jitted
def touched(sensors: Doubles, pad_m: float) -> int:
    """Return the contact bits. ``sensors``: ``SENSORS`` readings; ``pad_m``: height of the pad's top, m."""
    bits = GROUND if sensors[0] > 0.0 else 0
    if sensors[1] > 0.0:
        bits |= ROBOT
    for i in range(PAD_CONTACTS):
        at = 2 + PER_CONTACT * i
        if sensors[at] == 0.0:
            break
        on_top = abs(sensors[at + 6]) >= TOP_NORMAL and sensors[at + 3] >= pad_m - RIM_M
        bits |= PAD if on_top else PAD_EDGE
    return bits


TUMBLE_COS = 0.5  # cosine of 60 degrees, the tilt of a tumble


class ReachRecord(Record):
    """Outer bounds of the shapes, m, margin included."""

    vehicle: float  # radius about the centre of mass
    side: float  # radius of the cylinder around the vehicle, about the body's z axis
    bottom: float  # bottom of this cylinder on the body's z axis, negative
    top: float  # top of this cylinder on the body's z axis
    robot: float  # radius of the robot about the pad's axis
    robot_top: float  # highest point of the robot above the pad's top


class MujocoRecord(Record):
    """Addresses of MuJoCo's function ``mj_step``, of its model and data, and of arrays in the data."""

    mj_step: int
    mj_model: int
    mj_data: int
    positions: int  # address of the generalised positions, ``QPOS`` numbers
    velocities: int  # address of the generalised velocities, ``QVEL`` numbers
    applied: int  # address of the generalised forces, ``QVEL`` numbers
    sensors: int  # address of the sensor readings before the step, ``SENSORS`` numbers


class WorldRecord(Record):
    """Memory of the physics: states of vehicle and deck, bounds, forces and contacts."""

    body: BodyRecord
    deck: DeckRecord
    reach: ReachRecord
    wrench: WrenchRecord
    contacts: int  # ``ContactBit`` of the state before the last step
    rest: RestRecord
    mujoco: MujocoRecord


@jitted
def apart(reach: ReachRecord, body: BodyRecord, deck: DeckRecord) -> bool:
    """Return whether the vehicle certainly touches neither floor nor robot; False for NaN.

    ``reach``: bounds of the shapes; ``body``: the vehicle; ``deck``: the pad.
    """
    p, d, below = body.position, deck.position, reach.vehicle
    x, y, z = p[0] - d[0], p[1] - d[1], p[2] - d[2]
    square, beside = x * x + y * y, reach.vehicle + reach.robot
    if not (p[2] > below and z > below + reach.robot_top):  # close bodies: test the cylinder's lowest point
        axes = rotation_axes(body.quaternion)
        level, up = math.sqrt(axes[6] * axes[6] + axes[7] * axes[7]), axes[8]
        below = reach.side * level - min(reach.bottom * up, reach.top * up)
    above = z > below + reach.robot_top and square >= 0.0
    return bool(p[2] > below and (above or square > beside * beside))


@jitted
def to_mujoco(world: WorldRecord) -> None:
    """Write the state, force and torque of this step into MuJoCo's data."""
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
    """Read the vehicle's state from MuJoCo."""
    positions, velocities = doubles(m.positions), doubles(m.velocities)
    for i in range(3):
        body.position[i], body.velocity[i], body.rates[i] = positions[i], velocities[i], velocities[3 + i]
    for i in range(4):
        body.quaternion[i] = positions[3 + i]


@jitted
def physics_step(world: WorldRecord) -> None:
    """Advance vehicle and deck by one step.

    MuJoCo's Euler step uses the velocities at the end of the step. ``move_body`` is more accurate, so it
    replaces a MuJoCo step without contact. MuJoCo moves only the vehicle. A vehicle at rest moves with the
    pad, and its contact bits do not change.
    """
    if carried(world.rest, world.wrench, world.body, world.deck):
        return
    m = world.mujoco
    world.contacts = 0
    if not apart(world.reach, world.body, world.deck):
        to_mujoco(world)
        call(m.mj_step, (m.mj_model, m.mj_data))
        world.contacts = touched(doubles(m.sensors), world.deck.position[2])
    if world.contacts:
        answer(world.body, m)
    else:
        move_body(world.body, world.wrench)
    move_deck(world.deck)
    look(world.rest, world.body, world.deck, world.contacts == PAD)


@jitted
def tumbled(quaternion: Sequence[float] | F64) -> bool:
    """Return whether the body's z axis is tilted by more than 60 degrees."""
    x, y = quaternion[1], quaternion[2]
    return bool(x * x + y * y > 0.5 * (1.0 - TUMBLE_COS))  # body z axis: 1 - 2 (x^2 + y^2)
