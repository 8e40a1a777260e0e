"""Physics steps of 1 ms of vehicle and deck; MuJoCo computes a step in which contact is possible.

A vehicle at rest moves with the pad, without MuJoCo, until the forces or the deck's motion change. On a real
pad static friction holds the vehicle. MuJoCo's contact is soft, so a vehicle at rest creeps under a steady
side force. MuJoCo also takes ten times as long as all other parts of a step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from flightstack.compiled.foreign import Doubles, call, doubles
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Quaternion, Record, Vector
from logs.schema.events import ContactBit
from sim.plant.params import STEP_S, Params
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

WAIT_STEPS = 50  # consecutive steps of 1 ms at rest before the pad carries the vehicle; a bounce is shorter
STILL_M = 1e-4  # maximum allowed motion relative to the pad in these steps, m
DIAGONAL = 1.4143  # ratio of a square's diagonal to its side, rounded up: the feet are at the corners
SAME_RAD = 0.002  # maximum allowed change of attitude in these steps, rad
UPRIGHT = 0.99  # lower limit of the tilt's cosine for a vehicle that stands on all feet
LOADED = 0.5  # lower limit of the load on the feet of a vehicle at rest, divided by the weight
HOLDS = 0.25  # fraction of the holding force (friction, weight) above which MuJoCo computes the steps
TICK_S = 0.01  # assumed time between velocity updates of the deck, s; acceleration = velocity change / time
MOVED_M, TURNED_RAD = 1e-4, 1e-3  # limits of a correction of the deck's pose; a larger change is a jump


class RestRecord(Record):
    """Number of steps at rest on the pad, and the vehicle's pose on the pad."""

    wait_steps: int  # ``WAIT_STEPS``, or more than the steps of a flight, which disables the resting state
    steps: int  # number of consecutive steps at rest
    friction: float
    gravity: float  # gravitational acceleration, m/s^2
    feet_m: float  # distance of the feet from the centre of mass along body x and y
    pad_radius_m: float
    place: Vector  # position from the pad's centre, along the pad's axes, m
    attitude: Quaternion  # attitude in the pad's axes
    deck_position: Vector  # position of the deck after the last step
    deck_velocity: Vector
    deck_yaw: float
    deck_rate: float


def set_up_rest(r: RestRecord, params: Params, pad_radius_m: float) -> None:
    """Fill in the constant values of a record."""
    r.wait_steps, r.friction = WAIT_STEPS, params.contact.friction
    r.gravity, r.pad_radius_m = params.contact.gravity_m_s2, pad_radius_m
    r.feet_m = params.geometry.foot_offset_m


@jitted
def _note_deck(r: RestRecord, deck: DeckRecord) -> None:
    r.deck_yaw, r.deck_rate = deck.yaw, deck.rate
    for i in range(3):
        r.deck_position[i], r.deck_velocity[i] = deck.position[i], deck.velocity[i]


@jitted
def _change(now: F64, before: F64) -> tuple[float, float]:
    """Return the horizontal and the vertical size of a vector's change."""
    x, y = now[0] - before[0], now[1] - before[1]
    return math.sqrt(x * x + y * y), abs(now[2] - before[2])


@jitted
def _holds(r: RestRecord, wrench: WrenchRecord, deck: DeckRecord) -> bool:
    """Whether friction and weight hold the vehicle with margin; False for NaN."""
    force, torque, down = wrench.force, wrench.torque, -wrench.force[2]
    moved_m, raised_m = _change(deck.position, r.deck_position)
    faster_m_s, rises_m_s = _change(deck.velocity, r.deck_velocity)
    speed_m_s = math.sqrt(deck.velocity[0] * deck.velocity[0] + deck.velocity[1] * deck.velocity[1])
    sideways = math.sqrt(force[0] * force[0] + force[1] * force[1]) + wrench.mass * (
        faster_m_s / TICK_S + abs(deck.rate) * speed_m_s
    )
    lever = HOLDS * r.feet_m * down
    return bool(
        down > LOADED * wrench.mass * r.gravity
        and moved_m < MOVED_M
        and raised_m < MOVED_M
        and abs(deck.yaw - r.deck_yaw) < TURNED_RAD
        and abs(deck.rate - r.deck_rate) * r.feet_m < HOLDS * r.friction * r.gravity * TICK_S
        and rises_m_s < HOLDS * r.gravity * TICK_S
        and sideways < HOLDS * r.friction * down
        and abs(torque[0]) < lever
        and abs(torque[1]) < lever
        and abs(torque[2]) < r.friction * lever
    )


@jitted
def _turned(q: F64, yaw: float) -> tuple[float, float, float, float]:
    """Return an attitude (w, x, y, z) that is turned about the vertical by ``yaw``, rad."""
    c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return c * q[0] - s * q[3], c * q[1] - s * q[2], c * q[2] + s * q[1], c * q[3] + s * q[0]


@jitted
def look(r: RestRecord, body: BodyRecord, deck: DeckRecord, on_pad: bool) -> None:
    """Count a step at rest; called at the end of a step, after the deck has moved.

    ``body``: the vehicle; ``on_pad``: whether in this step the vehicle touched the top of the pad and nothing
    else.
    """
    q = body.quaternion
    x, y = body.position[0] - deck.position[0], body.position[1] - deck.position[1]
    upright = rotation_axes(q)[8] > UPRIGHT
    if not (on_pad and upright and math.sqrt(x * x + y * y) + DIAGONAL * r.feet_m < r.pad_radius_m):
        r.steps = 0
        return
    c, s = math.cos(deck.yaw), math.sin(deck.yaw)
    x, y, z = c * x + s * y, c * y - s * x, body.position[2] - deck.position[2]
    place, attitude, now = r.place, r.attitude, _turned(q, -deck.yaw)
    dx, dy, dz = x - place[0], y - place[1], z - place[2]
    product = now[0] * attitude[0] + now[1] * attitude[1] + now[2] * attitude[2] + now[3] * attitude[3]
    same = abs(product) > 1.0 - SAME_RAD * SAME_RAD / 8.0  # cosine of half the angle between both attitudes
    if not (same and dx * dx + dy * dy + dz * dz < STILL_M * STILL_M):
        r.steps = 0
    r.steps += 1
    if r.steps == 1 or r.steps == r.wait_steps:
        place[0], place[1], place[2] = x, y, z
        attitude[0], attitude[1], attitude[2], attitude[3] = now
    if r.steps == r.wait_steps:
        _note_deck(r, deck)


@jitted
def carried(r: RestRecord, wrench: WrenchRecord, body: BodyRecord, deck: DeckRecord) -> bool:
    """If the vehicle rests on the pad, advance vehicle and deck by one step; else only return False."""
    if r.steps < r.wait_steps:
        return False
    if not _holds(r, wrench, deck):
        r.steps = 0
        return False
    move_deck(deck)
    _note_deck(r, deck)
    c, s = math.cos(deck.yaw), math.sin(deck.yaw)
    x, y = c * r.place[0] - s * r.place[1], s * r.place[0] + c * r.place[1]
    p, v, q = body.position, body.velocity, body.quaternion
    p[0], p[1], p[2] = deck.position[0] + x, deck.position[1] + y, deck.position[2] + r.place[2]
    v[0], v[1], v[2] = deck.velocity[0] - deck.rate * y, deck.velocity[1] + deck.rate * x, deck.velocity[2]
    q[0], q[1], q[2], q[3] = _turned(r.attitude, deck.yaw)
    axes = rotation_axes(q)
    for i in range(3):
        body.rates[i] = axes[2 + 3 * i] * deck.rate
    return True


TOP_NORMAL = 0.7  # lower limit of the contact normal's |z| for a contact with the pad's top; about 45 degrees
RIM_M = 0.002  # depth below the pad's top beyond which a contact counts as contact with the edge, m

# order of the sensor readings: one for the floor, one for the robot below the pad, then all pad contacts
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


TUMBLE_COS = 0.5  # cosine of 60 degrees: a larger tilt counts as a tumble


class ReachRecord(Record):
    """Outer bounds of the shapes, m, margin included."""

    vehicle: float  # radius of a sphere around the vehicle, about the centre of mass
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
    contacts: int  # ``ContactBit`` values of the contacts at the start of the last step
    rest: RestRecord
    mujoco: MujocoRecord


@jitted
def apart(reach: ReachRecord, body: BodyRecord, deck: DeckRecord) -> bool:
    """Whether the vehicle certainly touches neither floor nor robot; False for NaN.

    ``reach``: bounds of the shapes; ``body``: the vehicle; ``deck``: the pad.
    """
    p, d, below = body.position, deck.position, reach.vehicle
    x, y, z = p[0] - d[0], p[1] - d[1], p[2] - d[2]
    square, beside = x * x + y * y, reach.vehicle + reach.robot
    if not (p[2] > below and z > below + reach.robot_top):  # close bodies: test the lowest point
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

    MuJoCo's Euler step uses the velocities at the end of the step. ``move_body`` is more accurate and
    therefore replaces a MuJoCo step without contact. MuJoCo moves only the vehicle. A vehicle at rest moves
    with the pad, and its contact bits do not change.
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
    """Whether the body's z axis is tilted by more than 60 degrees."""
    x, y = quaternion[1], quaternion[2]
    return bool(x * x + y * y > 0.5 * (1.0 - TUMBLE_COS))  # body z axis: 1 - 2 (x^2 + y^2)
