"""Rigid bodies, contact and the moving deck, by MuJoCo in 1 ms steps.

MuJoCo's Euler step moves the position with the velocity at the end of the step. Out of contact the position
is put back by half of that step's velocity change (trapezoidal rule), which makes constant acceleration
exact.
"""

from __future__ import annotations

import math
from enum import IntFlag
from typing import NamedTuple

import mujoco

from flightstack.types import Vec3
from sim.jit import jitted
from sim.mujoco_step import I32, contact_count, mj_step
from sim.params import STEP_S, Params
from sim.records import F64, Quaternion, Record, Vector, cell, new
from sim.scenario import TargetSpec
from sim.world_xml import model_xml


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
TOP_NORMAL = 0.7  # a contact whose normal is within 45 degrees of the vertical is with the pad's top
TUMBLE_COS = 0.5  # tilt beyond 60 degrees

QPOS_DECK, QVEL_DECK = 7, 6  # where the deck's joints begin; the vehicle's free joint comes first


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


class Memory(NamedTuple):
    """Where MuJoCo keeps what is exchanged every step.

    MuJoCo never moves these arrays. The memory is good as long as the ``World`` it came from.
    """

    qpos: F64
    qvel: F64
    applied: F64
    contacts: I32  # number of contacts, one element
    model: int  # addresses
    data: int


@jitted
def deck_step(deck: DeckRecord, m: Memory) -> None:
    """Impose the deck's state on MuJoCo, then move it on by one step."""
    p, v = deck.position, deck.velocity
    px, py, pz = p[0], p[1], p[2]
    vx, vy, vz = v[0], v[1], v[2]
    q, u = m.qpos, m.qvel
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
    m: Memory,
    force: tuple[float, float, float],
    torque: tuple[float, float, float],
) -> bool:
    """Advance by one step.

    Args:
        body: the vehicle, changed in place.
        deck: changed in place.
        m: MuJoCo's memory; its contacts are then those of the state the step began with.
        force: on the centre of mass, weight included, world frame, N.
        torque: body frame, N m.

    Returns:
        Whether the vehicle is tumbled.
    """
    deck_step(deck, m)
    for i in range(3):  # a free joint takes its force in the world frame and its torque in the body frame
        m.applied[i], m.applied[3 + i] = force[i], torque[i]
    mj_step(m.model, m.data)
    half = 0.5 * STEP_S
    for i in range(3):
        if m.contacts[0] == 0:
            m.qpos[i] -= half * (m.qvel[i] - body.velocity[i])
        body.position[i], body.velocity[i], body.rates[i] = m.qpos[i], m.qvel[i], m.qvel[3 + i]
    for i in range(4):
        body.quaternion[i] = m.qpos[3 + i]
    qx, qy = body.quaternion[1], body.quaternion[2]
    return bool(qx * qx + qy * qy > 0.5 * (1.0 - TUMBLE_COS))  # body z axis: 1 - 2 (qx^2 + qy^2)


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
    """

    __slots__ = (
        "_deck", "_deck_position", "_deck_rate", "_deck_velocity", "_deck_yaw", "_kinds",
        "_model", "_position", "_quaternion", "_rates",
        "_velocity", "body", "data", "deck", "memory",
    )  # fmt: skip

    def __init__(
        self,
        params: Params,
        mass_kg: float,
        target: TargetSpec,
        body: BodyRecord | None = None,
        deck: DeckRecord | None = None,
    ) -> None:
        self._model = model = mujoco.MjModel.from_xml_string(model_xml(params, mass_kg, target))
        self.data = data = mujoco.MjData(model)
        self.memory = Memory(
            data.qpos, data.qvel, data.qfrc_applied, contact_count(model, data), model._address, data._address
        )
        self._kinds = [int(KIND_OF_GEOM.get(model.geom(i).name, 0)) for i in range(model.ngeom)]
        self.body = new(BodyRecord) if body is None else body
        self.deck = new(DeckRecord) if deck is None else deck
        b = self.body
        self._position, self._velocity = b.position, b.velocity
        self._quaternion, self._rates = b.quaternion, b.rates
        self._deck = cell(self.deck)
        self._deck_position, self._deck_velocity = self.deck.position, self.deck.velocity
        self._deck_yaw, self._deck_rate = self._deck["yaw"], self._deck["rate"]
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
        self.memory.qpos[:QPOS_DECK] = (*position, *quaternion)
        self.memory.qvel[:QVEL_DECK] = (*velocity, *rates)

    def set_deck(self, position: Vec3, yaw: float, velocity: Vec3, rate: float) -> None:
        """Place the deck; from here on it moves on an arc: body-frame speed, climb and turn rate constant."""
        turn = rate * STEP_S
        chord = math.sin(0.5 * turn) / (0.5 * turn) if turn else 1.0  # chord over arc length
        along, across = chord * math.cos(0.5 * turn) * STEP_S, chord * math.sin(0.5 * turn) * STEP_S
        self._deck[0] = (position, velocity, yaw, rate, math.cos(turn), math.sin(turn), along, across)

    def step(self, force: Vec3, torque: Vec3) -> int:
        """Do one ``physics_step``.

        Returns:
            Contact bits of the state the step began with.
        """
        tumbled = physics_step(self.body, self.deck, self.memory, force, torque)
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
        if not self.data.ncon:
            return 0
        contact = self.data.contact
        bits = 0
        for (a, b), z, normal_z in zip(
            contact.geom.tolist(), contact.pos[:, 2].tolist(), contact.frame[:, 2].tolist(), strict=True
        ):
            kind = self._kinds[a] | self._kinds[b]
            if kind == ContactBit.PAD.value and (abs(normal_z) < TOP_NORMAL or z < self.data.qpos[9] - 0.002):
                kind = ContactBit.PAD_EDGE.value
            bits |= kind
        return bits

    def pad_surface_velocity(self, rx: float, ry: float) -> Vec3:
        """Velocity of the point of the pad at (rx, ry) from its centre, world axes."""
        vx, vy, vz = self.deck_velocity
        rate = float(self._deck_rate[0])
        return (vx - rate * ry, vy + rate * rx, vz)
