"""The vehicle's record, and its compiled loop with set-points and motion capture.

Interpreted Python only draws random numbers in advance and applies faults.
"""

from __future__ import annotations

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import Cell, Motors, Record, Vector
from sim.firmware.estimator import predict
from sim.firmware.stack import FirmwareRecord, control, listen, oversee
from sim.firmware.supervisor import PERIOD_MS
from sim.plant.air import DownwashRecord, NoiseRecord, WindRecord, blow, press, vary
from sim.plant.params import STEP_S, Body
from sim.plant.rotors import (
    BatteryRecord,
    GroundRecord,
    RotorRecord,
    drain,
    ground_effect,
    speed_at_no_duty,
    speed_limit,
    turn_rotors,
)
from sim.plant.sensors import ImuRecord, measure
from sim.plant.states import rotation_axes
from sim.vehicle.judge import ContactRecord, JudgeRecord, judge, note_contact
from sim.vehicle.mocap import MocapRecord, correct_estimate, measure_pose
from sim.world.step import WorldRecord, physics_step

CONTROL_EVERY_MS = 2
WIND_EVERY_MS = 5
BATTERY_EVERY_MS = 10


class DragRecord(Record):
    """Rotor drag and weight of the vehicle."""

    moment: float  # moment about the centre of mass from the drag along body x and y, N m per m/s
    damping: float  # torque against roll and pitch rate, N m s
    xy: float  # drag along body x and y, N s/m
    along: float  # additional drag along body z, N s/m
    weight: float  # weight of the vehicle, N


def set_up_drag(drag: DragRecord, body: Body, weight_n: float) -> None:
    drag.xy, drag.along, drag.weight = body.drag_n_s_m[0], body.drag_n_s_m[2] - body.drag_n_s_m[0], weight_n
    drag.moment, drag.damping = body.drag_above_com_m * body.drag_n_s_m[0], body.rate_damping_n_m_s


class VehicleRecord(Record):
    """Complete state of a vehicle; every step changes it."""

    world: WorldRecord
    rotors: RotorRecord
    ground: GroundRecord
    battery: BatteryRecord
    wind: WindRecord
    torque_noise: NoiseRecord
    drag: DragRecord
    downwash: DownwashRecord
    imu: ImuRecord
    firmware: FirmwareRecord
    mocap: MocapRecord
    judge: JudgeRecord
    contact: ContactRecord
    motor_share: Motors  # factor of the command: speed = share * command + held (1 and 0 without a fault)
    motor_held: Motors  # speed of a motor that a fault fixes, rpm
    drive: Motors  # target speeds of the motors, rpm
    before_e: Vector  # vehicle minus pad centre at the start of the last step, m
    before_velocity: Vector


@jitted
def sense(vehicle: Cell[VehicleRecord]) -> None:
    """Run sensors and estimator (500 Hz)."""
    v = vehicle[0]
    measure(v.imu, v.world.body.velocity, v.world.body.rates, rotation_axes(v.world.body.quaternion))
    predict(v.firmware.estimator, v.imu.gyro, v.imu.accel)


@jitted
def apply_ground_effect(v: VehicleRecord) -> None:
    """Update the ground effect's factors on the four thrusts."""
    p, d = v.world.body.position, v.world.deck.position
    if v.rotors.thrust_n > 0.0:
        axes = rotation_axes(v.world.body.quaternion)
        ground_effect(v.ground, p[0] - d[0], p[1] - d[1], p[2] - d[2], d[2], axes, v.rotors.ground_factors)
    else:
        v.rotors.ground_factors[:] = 1.0


@jitted
def push(v: VehicleRecord) -> None:
    """Advance the rotors by one step; add up the forces and torques of thrust, drag, weight and jets."""
    body, rotors, drag, wrench = v.world.body, v.rotors, v.drag, v.world.wrench
    for i in range(3):
        v.before_e[i] = body.position[i] - v.world.deck.position[i]
        v.before_velocity[i] = body.velocity[i]
    for i in range(4):
        v.drive[i] = v.motor_share[i] * v.firmware.commands[i] + v.motor_held[i]
    turn_rotors(rotors, v.drive, body.rates[0], body.rates[1])
    axes = rotation_axes(body.quaternion)
    zx, zy, zz = axes[6], axes[7], axes[8]
    wind, u, force = v.wind.now, body.velocity, wrench.force
    ax, ay, az = wind[0] - u[0], wind[1] - u[1], wind[2] - u[2]
    along = rotors.thrust_n + drag.along * (ax * zx + ay * zy + az * zz)
    force[0], force[1] = drag.xy * ax + along * zx, drag.xy * ay + along * zy
    force[2] = drag.xy * az + along * zz - drag.weight
    wrench.torque[0], wrench.torque[1], wrench.torque[2] = rotors.torque_x, rotors.torque_y, rotors.torque_z
    if drag.moment != 0.0 or drag.damping != 0.0:
        beside, ahead = ax * axes[3] + ay * axes[4] + az * axes[5], ax * axes[0] + ay * axes[1] + az * axes[2]
        wrench.torque[0] -= drag.moment * beside + drag.damping * body.rates[0]
        wrench.torque[1] += drag.moment * ahead - drag.damping * body.rates[1]
    if v.torque_noise.on and rotors.thrust_n > 0.0:
        for i in range(3):
            wrench.torque[i] += v.torque_noise.now[i]
    if v.downwash.on:
        press(v.downwash, axes, force, wrench.torque)


@jitted
def surround(v: VehicleRecord, now_ms: int) -> None:
    """Advance wind, torque noise and battery."""
    if now_ms % WIND_EVERY_MS == 0:
        blow(v.wind)
        vary(v.torque_noise)
    if now_ms % BATTERY_EVERY_MS == 0:
        drain(v.battery, v.rotors.rpm, BATTERY_EVERY_MS * STEP_S)


@jitted
def move(v: VehicleRecord, now_ms: int) -> None:
    """Advance body and deck by one step and update the judged quantities."""
    physics_step(v.world)
    judge(v.judge, v.world)
    if v.world.contacts:
        note_contact(v.contact, v.world, now_ms, v.before_e, v.before_velocity)


@jitted
def fly(vehicle: Cell[VehicleRecord], begin_ms: int, end_ms: int) -> None:
    """Run steps of 1 ms until ``end_ms``, or earlier until the next start or end of a fault.

    Enough random numbers must have been drawn (``VehicleSim.advance`` draws them).
    """
    v = vehicle[0]
    for now_ms in range(begin_ms, end_ms):
        listen(v.firmware, now_ms)
        measure_pose(v.mocap, v.world.body, now_ms)
        if not v.mocap.diverted:
            correct_estimate(v.mocap, v.firmware.estimator, v.world.body, now_ms)
        if now_ms % CONTROL_EVERY_MS == 0:
            sense(vehicle)
            if now_ms % PERIOD_MS == 0:
                oversee(v.firmware, now_ms, v.imu.accel)
            v.firmware.thrust_map.no_duty_rpm = speed_at_no_duty(v.battery)
            control(v.firmware, speed_limit(v.battery))
            apply_ground_effect(v)
        surround(v, now_ms)
        push(v)
        move(v, now_ms)
