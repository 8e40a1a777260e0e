"""Rigid bodies, contact and the moving deck, by MuJoCo in 1 ms steps.

MuJoCo's Euler step takes the gyroscopic torque from the start of the step and moves position and attitude
with the velocities at its end. Here the gyroscopic torque is the midpoint rule's, which keeps the energy of a
free rotation, and out of contact position and attitude are put back by half of the step's velocity change
(trapezoidal rule), which makes constant acceleration exact.
"""

from __future__ import annotations

import math
from enum import IntFlag
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from flightstack.types import Vec3
from sim.jit import jitted
from sim.mujoco_step import I32, contacts, mj_step
from sim.params import STEP_S, Params
from sim.records import F64, Quaternion, Record, Vector, cell, new
from sim.scenario import TargetSpec
from sim.world_rotation import midpoint_torque, turn_back
from sim.world_xml import model_xml

I64 = npt.NDArray[np.int64]


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
RIM_M = 0.002  # a contact lower than this under the pad's top is with its edge
TUMBLE_COS = 0.5  # tilt beyond 60 degrees

PAD, PAD_EDGE = ContactBit.PAD.value, ContactBit.PAD_EDGE.value
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
    geoms: I32  # the contacts, see ``mujoco_step.Contacts``
    place: F64
    frame: F64
    kinds: I64  # ``ContactBit`` of each geom
    inertia: F64  # of the vehicle, kg m^2
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
    torque = midpoint_torque(m.inertia, body.rates, torque)
    for i in range(3):  # a free joint takes its force in the world frame and its torque in the body frame
        m.applied[i], m.applied[3 + i] = force[i], torque[i]
    mj_step(m.model, m.data)
    half = 0.5 * STEP_S
    if m.contacts[0] == 0:
        x, y, z = m.qvel[3] - body.rates[0], m.qvel[4] - body.rates[1], m.qvel[5] - body.rates[2]
        turn_back(m.qpos, half * x, half * y, half * z)
    for i in range(3):
        if m.contacts[0] == 0:
            m.qpos[i] -= half * (m.qvel[i] - body.velocity[i])
        body.position[i], body.velocity[i], body.rates[i] = m.qpos[i], m.qvel[i], m.qvel[3 + i]
    for i in range(4):
        body.quaternion[i] = m.qpos[3 + i]
    qx, qy = body.quaternion[1], body.quaternion[2]
    return bool(qx * qx + qy * qy > 0.5 * (1.0 - TUMBLE_COS))  # body z axis: 1 - 2 (qx^2 + qy^2)


@jitted
def touched(m: Memory) -> int:
    """Contact bits of the state the last step began with."""
    bits = 0
    for i in range(m.contacts[0]):
        kind = m.kinds[m.geoms[i, 0]] | m.kinds[m.geoms[i, 1]]
        if kind == PAD and (abs(m.frame[i, 2]) < TOP_NORMAL or m.place[i, 2] < m.qpos[QPOS_DECK + 2] - RIM_M):
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
    """

    __slots__ = (
        "_deck", "_deck_position", "_deck_rate", "_deck_velocity", "_deck_yaw",
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
        kinds = [int(KIND_OF_GEOM.get(model.geom(i).name, 0)) for i in range(model.ngeom)]
        self.memory = Memory(
            data.qpos, data.qvel, data.qfrc_applied, *contacts(model, data), np.array(kinds),
            model.body("vehicle").inertia.copy(), model._address, data._address,
        )  # fmt: skip
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
        return touched(self.memory)

    def pad_surface_velocity(self, rx: float, ry: float) -> Vec3:
        """Velocity of the point of the pad at (rx, ry) from its centre, world axes."""
        vx, vy, vz = self.deck_velocity
        rate = float(self._deck_rate[0])
        return (vx - rate * ry, vy + rate * rx, vz)
