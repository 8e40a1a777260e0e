"""Rigid bodies, contact and the moving deck, by MuJoCo in 1 ms steps.

MuJoCo's Euler step takes the gyroscopic torque from the start of the step and moves position and attitude
with the velocities at its end. Here the gyroscopic torque is the midpoint rule's, which keeps the energy of a
free rotation, and out of contact position and attitude are put back by half of the step's velocity change
(trapezoidal rule), which makes constant acceleration exact.

Where nothing can be in reach, the step is that of the same model without its search for contacts: the same
numbers, for a third less.
"""

from __future__ import annotations

import math
from copy import copy
from enum import IntFlag
from typing import Annotated

import mujoco

from flightstack.core.types import Vec3
from sim.compiled.jit import jitted
from sim.compiled.records import F64, I64, Quaternion, Record, Vector, new, scalars, writer
from sim.plant.params import STEP_S, Params
from sim.scenarios.scenario import TargetSpec
from sim.world.mujoco_step import contacts, mj_step
from sim.world.raw_memory import address_of, doubles, ints
from sim.world.world_xml import ReachRecord, apart, measure_reach, model_xml


@jitted
def gyroscopic(inertia: F64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Angular velocity cross angular momentum, body frame."""
    jx, jy, jz = inertia[0], inertia[1], inertia[2]
    return ((jz - jy) * y * z, (jx - jz) * z * x, (jy - jx) * x * y)


@jitted
def midpoint_torque(
    inertia: F64, rates: F64, torque: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the torque with which MuJoCo's step equals the implicit midpoint rule with ``torque``."""
    half = 0.5 * STEP_S
    gx, gy, gz = before = gyroscopic(inertia, rates[0], rates[1], rates[2])
    for _ in range(3):  # each gains a factor of rate times half a step, 0.01 at most
        x = rates[0] + half * (torque[0] - gx) / inertia[0]
        y = rates[1] + half * (torque[1] - gy) / inertia[1]
        z = rates[2] + half * (torque[2] - gz) / inertia[2]
        gx, gy, gz = gyroscopic(inertia, x, y, z)
    return (torque[0] + before[0] - gx, torque[1] + before[1] - gy, torque[2] + before[2] - gz)


@jitted
def turn_back(q: F64, x: float, y: float, z: float) -> None:
    """Turn the vehicle's attitude in ``qpos`` back by a small rotation vector in the body frame."""
    x, y, z = -0.5 * x, -0.5 * y, -0.5 * z
    a, b, c, d = q[3], q[4], q[5], q[6]
    w, i = a - b * x - c * y - d * z, b + a * x + c * z - d * y
    j, k = c + a * y + d * x - b * z, d + a * z + b * y - c * x
    scale = 1.0 / math.sqrt(w * w + i * i + j * j + k * k)
    q[3], q[4], q[5], q[6] = w * scale, i * scale, j * scale, k * scale


class ContactBit(IntFlag):
    """What the vehicle touched."""

    PAD = 1
    GROUND = 2
    ROBOT = 4
    PAD_EDGE = 8
    TUMBLED = 16


KIND_OF_GEOM = {
    "floor": ContactBit.GROUND,
    "pad": ContactBit.PAD,
    "robot": ContactBit.ROBOT,
    "lidar": ContactBit.ROBOT,
}
GEOMS_MAX = 16
TOP_NORMAL = 0.7  # a contact whose normal is within 45 degrees of the vertical is with the pad's top
RIM_M = 0.002  # a contact lower than this under the pad's top is with its edge
TUMBLE_COS = 0.5  # tilt beyond 60 degrees

NO_CONTACTS = mujoco.mjtDisableBit.mjDSBL_CONTACT.value | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value

PAD, PAD_EDGE = ContactBit.PAD.value, ContactBit.PAD_EDGE.value
QPOS_DECK, QVEL_DECK = 7, 6  # where the deck's joints begin; the vehicle's free joint comes first
QPOS, QVEL = QPOS_DECK + 4, QVEL_DECK + 4


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


class MemoryRecord(Record):
    """Addresses of the data that MuJoCo and this module exchange; valid while their ``World`` exists."""

    qpos: int
    qvel: int
    applied: int  # generalised forces
    contacts: int  # see ``mujoco_step.Contacts``
    contact_stride: int
    geoms: int
    place: int
    frame: int
    model: int
    free_model: int  # without contacts
    mj_data: int
    kinds: Annotated[I64, GEOMS_MAX]  # ``ContactBit`` of each geom
    inertia: Vector  # of the vehicle, kg m^2


@jitted
def deck_step(deck: DeckRecord, m: MemoryRecord) -> None:
    """Impose the deck's state on MuJoCo, then move it on by one step."""
    p, v = deck.position, deck.velocity
    px, py, pz = p[0], p[1], p[2]
    vx, vy, vz = v[0], v[1], v[2]
    q, u = doubles(m.qpos, QPOS), doubles(m.qvel, QVEL)
    q[QPOS_DECK], q[QPOS_DECK + 1], q[QPOS_DECK + 2], q[QPOS_DECK + 3] = px, py, pz, deck.yaw
    u[QVEL_DECK], u[QVEL_DECK + 1], u[QVEL_DECK + 2], u[QVEL_DECK + 3] = vx, vy, vz, deck.rate
    p[0] = px + deck.along * vx - deck.across * vy
    p[1] = py + deck.along * vy + deck.across * vx
    p[2] = pz + STEP_S * vz
    v[0] = deck.cos_turn * vx - deck.sin_turn * vy
    v[1] = deck.cos_turn * vy + deck.sin_turn * vx
    deck.yaw += deck.rate * STEP_S


@jitted
def physics_step(
    body: BodyRecord,
    deck: DeckRecord,
    reach: ReachRecord,
    m: MemoryRecord,
    force: tuple[float, float, float],
    torque: tuple[float, float, float],
) -> bool:
    """Advance by one step.

    Args:
        body: the vehicle, changed in place.
        deck: changed in place.
        reach: of their shapes.
        m: MuJoCo's memory; its contacts are then those of the state the step began with.
        force: on the centre of mass, weight included, world frame, N.
        torque: body frame, N m.

    Returns:
        Whether the vehicle is tumbled.
    """
    model = m.free_model if apart(reach, body.position, deck.position) else m.model
    deck_step(deck, m)
    qpos, qvel, applied = doubles(m.qpos, QPOS), doubles(m.qvel, QVEL), doubles(m.applied, QVEL)
    torque = midpoint_torque(m.inertia, body.rates, torque)
    for i in range(3):  # a free joint takes its force in the world frame and its torque in the body frame
        applied[i], applied[3 + i] = force[i], torque[i]
    mj_step(model, m.mj_data)
    half, free = 0.5 * STEP_S, contact_count(m) == 0
    if free:
        x, y, z = qvel[3] - body.rates[0], qvel[4] - body.rates[1], qvel[5] - body.rates[2]
        turn_back(qpos, half * x, half * y, half * z)
    for i in range(3):
        if free:
            qpos[i] -= half * (qvel[i] - body.velocity[i])
        body.position[i], body.velocity[i], body.rates[i] = qpos[i], qvel[i], qvel[3 + i]
    for i in range(4):
        body.quaternion[i] = qpos[3 + i]
    qx, qy = body.quaternion[1], body.quaternion[2]
    return bool(qx * qx + qy * qy > 0.5 * (1.0 - TUMBLE_COS))  # body z axis: 1 - 2 (qx^2 + qy^2)


@jitted
def contact_count(m: MemoryRecord) -> int:
    """Number of contacts of the state the last step began with."""
    return int(ints(m.contacts, 1)[0])


@jitted
def touched(m: MemoryRecord) -> int:
    """Contact bits of the state the last step began with."""
    bits, pad_m = 0, doubles(m.qpos, QPOS)[QPOS_DECK + 2]
    for i in range(contact_count(m)):
        at = i * m.contact_stride
        geoms = ints(m.geoms + at, 2)
        kind = m.kinds[geoms[0]] | m.kinds[geoms[1]]
        if kind == PAD:
            normal_z, z = doubles(m.frame + at, 9)[2], doubles(m.place + at, 3)[2]
            if abs(normal_z) < TOP_NORMAL or z < pad_m - RIM_M:
                kind = PAD_EDGE
        bits |= kind
    return bits


class World:
    """The vehicle's rigid body and the deck.

    Attributes:
        memory: for ``physics_step``.
        body: record of the vehicle.
        deck: record of the deck.

    Args:
        params: geometry and contact.
        mass_kg: true mass; the inertia scales with it.
        target: pad and robot shapes.
        body: where to keep the vehicle; None for a place of its own.
        deck: the same for the deck.
        reach: the same for the reach of their shapes.
        memory: the same for where MuJoCo's memory is.
    """

    __slots__ = (
        "_deck_position", "_deck_rate", "_deck_velocity", "_deck_yaw", "_free_model",
        "_model", "_position", "_qpos", "_quaternion", "_qvel", "_rates", "_set_deck",
        "_velocity", "body", "data", "deck", "memory", "reach",
    )  # fmt: skip

    def __init__(
        self,
        params: Params,
        mass_kg: float,
        target: TargetSpec,
        body: BodyRecord | None = None,
        deck: DeckRecord | None = None,
        reach: ReachRecord | None = None,
        memory: MemoryRecord | None = None,
    ) -> None:
        self._model = model = mujoco.MjModel.from_xml_string(model_xml(params, mass_kg, target))
        self._free_model = copy(model)
        self._free_model.opt.disableflags |= NO_CONTACTS
        self.data = data = mujoco.MjData(model)
        self.memory = m = new(MemoryRecord) if memory is None else memory
        m.qpos, m.qvel, m.applied = map(address_of, (data.qpos, data.qvel, data.qfrc_applied))
        m.contacts, m.contact_stride, m.geoms, m.place, m.frame = contacts(model, data)
        m.model, m.free_model, m.mj_data = model._address, self._free_model._address, data._address
        m.kinds[: model.ngeom] = [KIND_OF_GEOM.get(model.geom(i).name, 0) for i in range(model.ngeom)]
        m.inertia[:] = model.body("vehicle").inertia
        self._qpos, self._qvel = data.qpos, data.qvel
        self.body = new(BodyRecord) if body is None else body
        self.deck = new(DeckRecord) if deck is None else deck
        self.reach = new(ReachRecord) if reach is None else reach
        measure_reach(model, self.reach)
        b = self.body
        self._position, self._velocity = b.position, b.velocity
        self._quaternion, self._rates = b.quaternion, b.rates
        self._set_deck = writer(self.deck)
        self._deck_position, self._deck_velocity = self.deck.position, self.deck.velocity
        self._deck_yaw, self._deck_rate = scalars(self.deck, "yaw", "rate")
        self.set_vehicle((0.0, 0.0, 1.0))
        self.set_deck((*target.position_m, target.pad_height_m), 0.0, (0.0, 0.0, 0.0), 0.0)

    def set_vehicle(
        self,
        position: Vec3,
        quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
        velocity: Vec3 = (0.0, 0.0, 0.0),
        rates: Vec3 = (0.0, 0.0, 0.0),
    ) -> None:
        """Place the vehicle."""
        self._position[:], self._quaternion[:] = position, quaternion
        self._velocity[:], self._rates[:] = velocity, rates
        self._qpos[:QPOS_DECK] = (*position, *quaternion)
        self._qvel[:QVEL_DECK] = (*velocity, *rates)

    def set_deck(self, position: Vec3, yaw: float, velocity: Vec3, rate: float) -> None:
        """Place the deck; from here on it moves on an arc: body-frame speed, climb and turn rate constant."""
        turn = rate * STEP_S
        sine = math.sin(0.5 * turn)
        chord = sine / (0.5 * turn) if turn else 1.0  # chord over arc length
        along, across = chord * math.cos(0.5 * turn) * STEP_S, chord * sine * STEP_S
        self._set_deck(*position, *velocity, yaw, rate, math.cos(turn), math.sin(turn), along, across)

    def step(self, force: Vec3, torque: Vec3) -> int:
        """Do one ``physics_step``.

        Returns:
            Contact bits of the state the step began with.
        """
        tumbled = physics_step(self.body, self.deck, self.reach, self.memory, force, torque)
        return self.contacts() | (ContactBit.TUMBLED.value if tumbled else 0)

    @property
    def position(self) -> Vec3:
        """Of the vehicle's centre of mass, ENU, m."""
        x, y, z = self._position.tolist()
        return (x, y, z)

    @property
    def velocity(self) -> Vec3:
        """Of the vehicle's centre of mass, ENU, m/s."""
        x, y, z = self._velocity.tolist()
        return (x, y, z)

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """w, x, y, z; body FLU in world ENU."""
        w, x, y, z = self._quaternion.tolist()
        return (w, x, y, z)

    @property
    def rates(self) -> Vec3:
        """Angular velocity in the body frame, rad/s."""
        x, y, z = self._rates.tolist()
        return (x, y, z)

    @property
    def deck_position(self) -> Vec3:
        """Of the pad centre (top), ENU, m."""
        x, y, z = self._deck_position.tolist()
        return (x, y, z)

    @property
    def deck_velocity(self) -> Vec3:
        """Of the pad centre, ENU, m/s."""
        x, y, z = self._deck_velocity.tolist()
        return (x, y, z)

    @property
    def deck_yaw(self) -> float:
        """Of the deck, rad; not wrapped."""
        return float(self._deck_yaw[0])

    def contacts(self) -> int:
        """Contact bits of the state the last step began with."""
        return touched(self.memory)

    def pad_surface_velocity(self, rx: float, ry: float) -> Vec3:
        """Velocity of the point of the pad at (rx, ry) from its centre, world axes."""
        vx, vy, vz = self.deck_velocity
        rate = float(self._deck_rate[0])
        return (vx - rate * ry, vy + rate * rx, vz)
