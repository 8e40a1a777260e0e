"""Physics of one vehicle without its autopilot, and the compiled loop with set-points and motion capture.

The physics consists of world, rotors, battery, wind, deck, and the true state. Interpreted Python only draws
random numbers in advance and applies faults.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Cell, Motors, Record, Vector, cell, new, reader, scalars
from flightstack.core.numeric import twin, wrapped
from flightstack.core.safety.barrier import barrier_h
from flightstack.core.types import Vec3
from logs.schema.events import ContactBit
from logs.schema.rows import TrueStateRow
from sim.firmware.estimator import predict
from sim.firmware.setpoint import receive
from sim.firmware.stack import FirmwareRecord, control, oversee, running
from sim.firmware.supervisor import PERIOD_MS
from sim.plant.air import (
    DownwashRecord,
    NoiseRecord,
    WindRecord,
    blow,
    press,
    set_up_downwash,
    set_up_noise,
    set_up_wind,
    vary,
)
from sim.plant.params import STEP_S, Params, Plant, able_to_hover, load
from sim.plant.params import Body as BodyParams
from sim.plant.rotors import (
    BatteryRecord,
    GroundRecord,
    RotorRecord,
    drain,
    ground_effect,
    set_up_battery,
    set_up_ground,
    set_up_rotors,
    speed_at_no_duty,
    speed_limit,
    turn_rotors,
)
from sim.plant.sensors import NS_PER_MS, ImuRecord, measure
from sim.plant.states import TRUTH, Body, rotation_axes, truth_row
from sim.robot import TargetModel
from sim.scenarios.scenario import Scenario
from sim.vehicle.judge import GAP_MS, NONE_MS, ContactRecord, JudgeRecord, judge, note_contact
from sim.vehicle.mocap import MocapRecord, correct_estimate, measure_pose
from sim.world.step import WorldRecord, physics_step
from sim.world.world import World

CONTROL_EVERY_MS = 2
WIND_EVERY_MS = 5
BATTERY_EVERY_MS = 10


class DragRecord(Record):
    """Rotor drag and weight of the vehicle."""

    moment: float  # moment about the centre of mass from the drag along body x and y, N m per m/s
    damping: float  # torque against a roll or pitch rate divided by the rate, N m s
    xy: float  # drag along body x and y divided by the velocity, N s/m
    along: float  # additional drag along body z divided by the velocity, N s/m
    weight: float  # weight of the vehicle, N


def set_up_drag(drag: DragRecord, body: BodyParams, weight_n: float) -> None:
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
    motor_share: Motors  # factor of the command: speed = share * command + held; without a fault 1 and 0
    motor_held: Motors  # speed of a motor that a fault fixes, rpm
    drive: Motors  # target speeds of the motors after faults, rpm
    before_e: Vector  # vehicle minus pad centre at the start of the last step, m
    before_velocity: Vector


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
def run_firmware(v: VehicleRecord, now_ms: int) -> None:
    """Run sensors and firmware for one step; the random numbers must have been drawn (``advance``)."""
    receive(v.firmware.inbox, v.firmware.setpoint, now_ms)
    measure_pose(v.mocap, v.world.body, now_ms)
    if not v.mocap.diverted:
        correct_estimate(v.mocap, v.firmware.estimator, v.world.body, now_ms)
    if now_ms % CONTROL_EVERY_MS == 0:
        axes = rotation_axes(v.world.body.quaternion)
        measure(v.imu, v.world.body.velocity, v.world.body.rates, axes)
        predict(v.firmware.estimator, v.imu.gyro, v.imu.accel)
        if now_ms % PERIOD_MS == 0:
            oversee(v.firmware, now_ms, v.imu.accel)
        v.firmware.thrust_map.no_duty_rpm = speed_at_no_duty(v.battery)
        control(v.firmware, speed_limit(v.battery))
        apply_ground_effect(v)


@jitted
def run_body(v: VehicleRecord, now_ms: int) -> None:
    """Run surroundings, rotors, body and deck for one step."""
    surround(v, now_ms)
    push(v)
    move(v, now_ms)


@jitted
def fly(vehicle: Cell[VehicleRecord], begin_ms: int, end_ms: int) -> None:
    """Run steps of 1 ms until ``end_ms``; the random numbers must have been drawn (``advance``)."""
    v = vehicle[0]
    for now_ms in range(begin_ms, end_ms):
        run_firmware(v, now_ms)
        run_body(v, now_ms)


AIRBORNE_AFTER_MS = 200  # time without contact after which the vehicle counts as airborne, ms
SUPPLY_MS = 320  # time for which random numbers are drawn in advance, ms; the IMU uses six every 2 ms
TUMBLED = ContactBit.TUMBLED.value


def _turned_back(angle_rad: float) -> float:
    return wrapped(angle_rad)


_wrapped, _h = twin(_turned_back, jitted), twin(barrier_h, jitted)


@jitted
def write_truth(vehicle: Cell[VehicleRecord], now_ms: int, row: F64) -> None:
    """Write the true state, and extremes and contacts since the last call, to ``row`` (TRUTH,)."""
    v = vehicle[0]
    body, deck, j, c = v.world.body, v.world.deck, v.judge, v.contact
    p, d = body.position, deck.position
    h = _h(j.alpha_1_m, j.beta_m, (p[0] - d[0], p[1] - d[1], p[2] - d[2]))
    row[0] = now_ms * STEP_S
    for i in range(3):
        row[1 + i], row[4 + i], row[11 + i] = p[i], body.velocity[i], body.rates[i]
        row[18 + i], row[21 + i], row[38 + i] = d[i], deck.velocity[i], v.wind.now[i]
    for i in range(4):
        row[7 + i], row[14 + i] = body.quaternion[(i + 1) % 4], v.rotors.rpm[i]  # order x, y, z, w
    row[24], row[25], row[26], row[27] = (
        _wrapped(deck.yaw),
        h,
        j.h_min if j.h_min < h else h,
        j.h_min_outside,
    )
    row[28] = c.bits | (TUMBLED if j.tumbled else 0)
    touched = c.touch_ms != NONE_MS
    for i in range(3):
        row[29 + i] = c.touch_e[i] if touched else math.nan
        row[32 + i] = c.touch_velocity[i] if touched else math.nan
    row[35] = c.touch_ms * STEP_S if touched else math.nan
    row[36], row[37] = 1.0 if running(v.firmware.commands) else 0.0, v.battery.voltage_v
    j.h_min = j.h_min_outside = math.inf
    j.tumbled = False
    c.bits = 0


class Physics(ABC):
    """Body and surroundings of one vehicle; ``plant`` replaces the ratios drawn from the seed."""

    def __init__(
        self, scenario: Scenario, seed: int, params: Params | None = None, plant: Plant | None = None
    ) -> None:
        self.params = params = params or load(scenario.vehicle.airframe)
        if plant is None:
            plant, reserve = Plant.draw(scenario.vehicle, seed), scenario.vehicle.hover_reserve
            plant = able_to_hover(plant, params, reserve) if reserve > 0.0 else plant
        self.plant = plant  # ratios of this vehicle's true parameters to the nominal parameters
        mass_kg = params.body.mass_kg * plant.mass
        self._weight_n = mass_kg * params.contact.gravity_m_s2
        # record: state of the 1 ms steps, one contiguous array; cell: the same array for compiled code
        self.record = r = new(VehicleRecord)
        self.cell = cell(r)
        self._ms = self._supplied_ms = 0  # simulated time; time up to which random numbers are drawn
        self._world = World(params, mass_kg, scenario.target, r.world)
        set_up_rotors(r.rotors, params.rotor, plant, scenario.vehicle.slow_motors, STEP_S)
        pad_radius = scenario.target.pad_radius_m
        set_up_ground(r.ground, params.rotor, scenario.vehicle.ground_effect_gain, pad_radius)
        # rotor speed in hover without wind, rpm
        self._hover_rpm = params.rotor.rpm(self._weight_n / 4.0 / plant.thrust)
        set_up_battery(r.battery, params.battery, self._hover_rpm, plant.battery_charge)
        (self._battery_v,) = scalars(r.battery, "voltage_v")
        shape, step_s = params.torque_noise, WIND_EVERY_MS * STEP_S
        self._tapes = (
            set_up_wind(r.wind, scenario.wind, params.wind, seed, step_s),
            set_up_noise(r.torque_noise, shape.rms_n_m, shape.time_s, seed, "torque.noise", step_s),
        )
        set_up_drag(r.drag, params.body, self._weight_n)
        set_up_downwash(r.downwash, params.body, params.rotor, params.geometry)
        self._barrier = judge = scenario.judged_by
        cell(r.judge)[0] = (judge.alpha_1_m, judge.beta_m, pad_radius, math.inf, math.inf, False)
        r.contact.since_ms = r.contact.pad_ms = r.contact.ground_ms = r.contact.touch_ms = NONE_MS
        # arrays with one element in the memory of the record
        self._since_ms, self._pad_ms, self._ground_ms, self._judging = scalars(
            r.contact, "since_ms", "pad_ms", "ground_ms", "judging"
        )
        self._row = np.empty(TRUTH)
        self._read_row = reader(self._row)
        self.set_deck(*TargetModel(scenario.target, seed).pad)

    def set_deck(
        self, position_enu_m: Vec3, yaw_rad: float, velocity_enu_m_s: Vec3, yaw_rate_rad_s: float
    ) -> None:
        """Set the true pose and velocity of the pad centre, which moves on an arc until the next call."""
        self._world.set_deck(position_enu_m, yaw_rad, velocity_enu_m_s, yaw_rate_rad_s)

    def advance(self, steps: int) -> None:
        """Run ``steps`` physics steps of 1 ms."""
        end_ms = self._ms + steps
        while self._ms < end_ms:
            if self._ms >= self._supplied_ms:
                self._supplied_ms = self._supply()
            self._ms = self._fly(min(end_ms, self._supplied_ms))
        if not self._judging[0] and self.airborne:
            self._judging[0] = True

    def _supply(self) -> int:
        """Draw random numbers for the compiled code; return the time up to which they suffice, ms."""
        for tape in self._tapes:
            tape.top_up()
        return self._ms + SUPPLY_MS

    @abstractmethod
    def _fly(self, end_ms: int) -> int:
        """Run steps, at most up to ``end_ms``; return the time reached, ms."""

    @property
    def on_pad(self) -> bool:
        """Whether the vehicle touches the pad's top; a gap of at most 30 ms does not end the contact."""
        return bool(self._ms - self._pad_ms[0] <= GAP_MS)

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle touches the floor."""
        return bool(self._ms - self._ground_ms[0] <= GAP_MS)

    @property
    def airborne(self) -> bool:
        """Whether the vehicle has been without contact for ``AIRBORNE_AFTER_MS``."""
        return bool(self._ms - max(self._pad_ms[0], self._ground_ms[0]) > AIRBORNE_AFTER_MS)

    def body(self) -> Body:
        """Return the current true motion."""
        return self._world.body()

    @property
    def deck_pose(self) -> tuple[Vec3, float]:
        """Position of the pad centre, ENU, m, and its heading, rad."""
        return self._world.deck_pose

    def truth_values(self) -> tuple[float, ...]:
        """Return the ``TRUTH`` values now: the true state, and extremes and contacts since the last call."""
        write_truth(self.cell, self._ms, self._row)
        return self._read_row()

    def truth(self) -> TrueStateRow:
        """Return ``truth_values`` as a row of the log."""
        return truth_row(self.truth_values(), self._ms * NS_PER_MS)
