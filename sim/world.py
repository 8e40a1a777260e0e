"""Rigid bodies, contact and the moving deck, by MuJoCo in 1 ms steps.

MuJoCo's Euler step moves the position with the velocity at the end of the step. Out of contact the position
is put back by half of that step's velocity change (trapezoidal rule), which makes constant acceleration
exact.
"""

from __future__ import annotations

import math
import struct
from enum import IntFlag

import mujoco
import numpy as np

from flightstack.types import Vec3
from sim.params import STEP_S, Params
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

_THREE = struct.Struct("3d")
_FOUR = struct.Struct("4d")
_SIX = struct.Struct("6d")
_SEVEN = struct.Struct("7d")


class World:
    """The vehicle's rigid body and the deck.

    Attributes:
        position, velocity: of the vehicle's centre of mass, ENU, m and m/s.
        quaternion: w, x, y, z; body FLU in world ENU.
        rates: angular velocity in the body frame, rad/s.
        deck_position, deck_velocity: of the pad centre (top), ENU.
        deck_yaw, deck_rate: rad and rad/s.

    Args:
        params: geometry and contact.
        mass_kg: true mass; the inertia scales with it.
        target: pad and robot shapes.
    """

    __slots__ = (
        "_applied", "_arc", "_kinds", "_model", "_pad", "_qpos", "_qvel", "data", "deck_position",
        "deck_rate", "deck_velocity", "deck_yaw", "position", "quaternion", "rates", "velocity",
    )  # fmt: skip

    def __init__(self, params: Params, mass_kg: float, target: TargetSpec) -> None:
        self._model = model = mujoco.MjModel.from_xml_string(model_xml(params, mass_kg, target))
        self.data = mujoco.MjData(model)
        # MuJoCo never moves these arrays, so that views stay good; struct on them is faster than indexing
        self._qpos = memoryview(self.data.qpos).cast("B")
        self._qvel = memoryview(self.data.qvel).cast("B")
        self._applied = memoryview(self.data.qfrc_applied).cast("B")
        self._kinds = [int(KIND_OF_GEOM.get(model.geom(i).name, 0)) for i in range(model.ngeom)]
        self._pad = model.geom("pad").id
        self.position: Vec3 = (0.0, 0.0, 1.0)
        self.velocity: Vec3 = (0.0, 0.0, 0.0)
        self.quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
        self.rates: Vec3 = (0.0, 0.0, 0.0)
        self.set_deck((*target.position_m, target.pad_height_m), 0.0, (0.0, 0.0, 0.0), 0.0)

    def set_vehicle(
        self,
        position: Vec3,
        quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
        velocity: Vec3 = (0.0, 0.0, 0.0),
        rates: Vec3 = (0.0, 0.0, 0.0),
    ) -> None:
        """Place the vehicle."""
        self.position, self.quaternion, self.velocity, self.rates = position, quaternion, velocity, rates
        _SEVEN.pack_into(self._qpos, 0, *position, *quaternion)
        _SIX.pack_into(self._qvel, 0, *velocity, *rates)

    def set_deck(self, position: Vec3, yaw: float, velocity: Vec3, rate: float) -> None:
        """Place the deck; from here on it moves on an arc: body-frame speed, climb and turn rate constant."""
        self.deck_position, self.deck_yaw, self.deck_velocity, self.deck_rate = position, yaw, velocity, rate
        turn = rate * STEP_S
        chord = math.sin(0.5 * turn) / (0.5 * turn) if turn else 1.0  # chord over arc length
        self._arc = (
            math.cos(turn), math.sin(turn),
            chord * math.cos(0.5 * turn) * STEP_S, chord * math.sin(0.5 * turn) * STEP_S,
        )  # fmt: skip

    def step(self, force: Vec3, torque: Vec3) -> int:
        """Advance by one step.

        Args:
            force: on the centre of mass, weight included, world frame, N.
            torque: body frame, N m.

        Returns:
            Contact bits of the state the step began with.
        """
        data = self.data
        px, py, pz = self.deck_position
        vx, vy, vz = self.deck_velocity
        yaw = self.deck_yaw
        _FOUR.pack_into(self._qpos, 56, px, py, pz, yaw)
        _FOUR.pack_into(self._qvel, 48, vx, vy, vz, self.deck_rate)
        # a free joint takes its force in the world frame and its torque in the body frame
        _SIX.pack_into(self._applied, 0, *force, *torque)
        mujoco.mj_step(self._model, data)
        cos_t, sin_t, along, across = self._arc
        self.deck_position = (px + along * vx - across * vy, py + along * vy + across * vx, pz + STEP_S * vz)
        self.deck_velocity = (cos_t * vx - sin_t * vy, cos_t * vy + sin_t * vx, vz)
        self.deck_yaw = yaw + self.deck_rate * STEP_S
        x, y, z, qw, qx, qy, qz = _SEVEN.unpack_from(self._qpos, 0)
        ux, uy, uz, wx, wy, wz = _SIX.unpack_from(self._qvel, 0)
        contacts = 0
        if data.ncon:
            contacts = self._classify()
        else:
            ox, oy, oz = self.velocity
            half = 0.5 * STEP_S
            x, y, z = x - half * (ux - ox), y - half * (uy - oy), z - half * (uz - oz)
            _THREE.pack_into(self._qpos, 0, x, y, z)
        self.position = (x, y, z)
        self.quaternion = (qw, qx, qy, qz)
        self.velocity = (ux, uy, uz)
        self.rates = (wx, wy, wz)
        if qx * qx + qy * qy > 0.5 * (1.0 - TUMBLE_COS):  # body z axis: 1 - 2 (qx^2 + qy^2)
            contacts |= ContactBit.TUMBLED.value
        return contacts

    def _classify(self) -> int:
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
        return (vx - self.deck_rate * ry, vy + self.deck_rate * rx, vz)


def rotation_axes(quaternion: tuple[float, float, float, float]) -> tuple[float, ...]:
    """Body x, y and z axis in the world (columns of the rotation matrix), nine numbers."""
    w, x, y, z = quaternion
    return (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


def quaternion_from_axes(axes: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Quaternion (w, x, y, z), w >= 0, of the rotation with these body axes in the world."""
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, np.array(axes).reshape(3, 3).T.ravel())
    w, x, y, z = (out if out[0] >= 0.0 else -out).tolist()
    return (w, x, y, z)
