"""The vehicle's record, and the compiled loop that flies it, set-points and motion capture included.

It needs Python only for what is drawn ahead (noise, chance) and for faults.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

from flightstack.core.safety.barrier import Barrier
from sim.compiled.jit import jitted
from sim.compiled.records import Cell, Motors, Record, Vector
from sim.compiled.rotation import rotation_axes
from sim.firmware.estimator import predict
from sim.firmware.stack import FirmwareRecord, control, listen, oversee
from sim.firmware.supervisor import PERIOD_MS
from sim.plant.ground_effect import GroundRecord, ground_effect
from sim.plant.imu import ImuRecord, measure
from sim.plant.params import STEP_S
from sim.plant.rotors import RotorRecord, turn_rotors
from sim.plant.vehicle_types import BatteryRecord, drain, speed_limit
from sim.plant.wind import WindRecord, blow
from sim.vehicle.mocap import MocapRecord, correct_estimate, measure_pose
from sim.world.contact import ContactRecord, note_contact
from sim.world.world import BodyRecord, DeckRecord, MemoryRecord, contact_count, physics_step, touched
from sim.world.world_xml import ReachRecord

CONTROL_EVERY_MS = 2
WIND_EVERY_MS = 5
BATTERY_EVERY_MS = 10


class JudgeRecord(Record):
    """The barrier flown against, and the extremes since they were last asked for."""

    alpha_1_m: float
    beta_m: float
    pad_radius: float
    h_min: float
    h_min_outside: float  # the same outside the pad's radius
    tumbled: bool


class DragRecord(Record):
    """Rotor drag and weight."""

    xy: float  # N s/m
    along: float  # what drag along body z adds to that
    weight: float  # N


class VehicleRecord(Record):
    """Everything that changes every step."""

    body: BodyRecord
    deck: DeckRecord
    reach: ReachRecord
    memory: MemoryRecord
    rotors: RotorRecord
    ground: GroundRecord
    battery: BatteryRecord
    wind: WindRecord
    drag: DragRecord
    imu: ImuRecord
    firmware: FirmwareRecord
    mocap: MocapRecord
    judge: JudgeRecord
    contact: ContactRecord
    motor_share: Motors  # speed a motor aims at = share * command + held (1 and 0 without a fault)
    motor_held: Motors  # rpm
    drive: Motors  # that speed, rpm
    before_e: Vector  # vehicle minus pad at the beginning of the last step
    before_velocity: Vector


# the very formula of the controller, compiled; a record stands in for the object
_height = cast("Callable[[JudgeRecord, float], float]", jitted(Barrier.height))


@jitted
def sense(vehicle: Cell[VehicleRecord]) -> None:
    """Measure and estimate (500 Hz)."""
    v = vehicle[0]
    measure(v.imu, v.body.velocity, v.body.rates, rotation_axes(v.body.quaternion))
    predict(v.firmware.estimator, v.imu.gyro, v.imu.accel)


@jitted
def cushion(v: VehicleRecord) -> None:
    """Compute the ground-effect factors of the four thrusts."""
    p, d = v.body.position, v.deck.position
    if v.rotors.thrust_n > 0.0:
        axes = rotation_axes(v.body.quaternion)
        ground_effect(v.ground, p[0] - d[0], p[1] - d[1], p[2] - d[2], d[2], axes, v.rotors.cushion)
    else:
        v.rotors.cushion[:] = 1.0


@jitted
def move(v: VehicleRecord) -> None:
    """Move rotors, body and deck by one step under thrust, drag and weight."""
    body, rotors, drag = v.body, v.rotors, v.drag
    for i in range(3):
        v.before_e[i] = body.position[i] - v.deck.position[i]
        v.before_velocity[i] = body.velocity[i]
    for i in range(4):
        v.drive[i] = v.motor_share[i] * v.firmware.commands[i] + v.motor_held[i]
    turn_rotors(rotors, v.drive, body.rates[0], body.rates[1])
    axes = rotation_axes(body.quaternion)
    zx, zy, zz = axes[6], axes[7], axes[8]
    wind, u = v.wind.now, body.velocity
    ax, ay, az = wind[0] - u[0], wind[1] - u[1], wind[2] - u[2]
    along = rotors.thrust_n + drag.along * (ax * zx + ay * zy + az * zz)
    force = (drag.xy * ax + along * zx, drag.xy * ay + along * zy, drag.xy * az + along * zz - drag.weight)
    torque = (rotors.torque_x, rotors.torque_y, rotors.torque_z)
    if physics_step(body, v.deck, v.reach, v.memory, force, torque):
        v.judge.tumbled = True


@jitted
def judge(v: VehicleRecord) -> None:
    """Keep the smallest h."""
    j, p, d = v.judge, v.body.position, v.deck.position
    ex, ey = p[0] - d[0], p[1] - d[1]
    square = ex * ex + ey * ey
    h = p[2] - d[2] - _height(j, math.sqrt(square))
    j.h_min = min(j.h_min, h)
    if square > j.pad_radius * j.pad_radius:
        j.h_min_outside = min(j.h_min_outside, h)


@jitted
def fly(vehicle: Cell[VehicleRecord], now_ms: int, end_ms: int) -> int:
    """Run steps of 1 ms until ``end_ms``.

    Args:
        vehicle: changed in place; what is drawn ahead must suffice (``VehicleSim.supply``).
        now_ms: time of the first step.
        end_ms: not beyond the next event of a fault.

    Returns:
        Time reached.
    """
    v = vehicle[0]
    while now_ms < end_ms:
        listen(v.firmware, now_ms)
        measure_pose(v.mocap, v.body, now_ms)
        if not v.mocap.diverted:
            correct_estimate(v.mocap, v.firmware.estimator, now_ms)
        if now_ms % CONTROL_EVERY_MS == 0:
            sense(vehicle)
            if now_ms % PERIOD_MS == 0:
                oversee(v.firmware, now_ms, v.imu.accel)
            control(v.firmware, speed_limit(v.battery))
            cushion(v)
        if now_ms % WIND_EVERY_MS == 0:
            blow(v.wind)
        if now_ms % BATTERY_EVERY_MS == 0:
            drain(v.battery, v.rotors.rpm, BATTERY_EVERY_MS * STEP_S)
        move(v)
        judge(v)
        if contact_count(v.memory) > 0:
            note_contact(v.contact, v.deck, touched(v.memory), now_ms, v.before_e, v.before_velocity)
        now_ms += 1
    return now_ms
