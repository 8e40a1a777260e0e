"""The simulated Crazyflie: body, rotors, firmware, estimator and the deck, in steps of 1 ms.

The result depends only on scenario and seed, not on MAVLink or wall time.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import at_once, compiling, is_kept, is_off
from flightstack.compiled.records import reader
from flightstack.core.types import ZERO, Vec3
from logs.schema.events import ContactBit
from sim.chance import stream
from sim.faults.vehicle_faults import BatteryFaults, Faults, MotorFaults
from sim.firmware.estimator import correct
from sim.firmware.geometric import axes_from_force
from sim.firmware.mixer import OFF
from sim.firmware.setpoint import STOP, set_point
from sim.firmware.stack import Firmware
from sim.firmware.supervisor import PERIOD_MS, STATES, State
from sim.plant.params import CONTROL_STEP_S, STEP_S, Params, Plant
from sim.plant.rotors import drain, speed_at_no_duty, speed_limit
from sim.plant.sensors import NS_PER_MS, Imu, ms_from
from sim.plant.states import Estimate, quaternion_from_axes, rotation_axes
from sim.scenarios.fault_spec import After, Fault, Kind, What
from sim.scenarios.scenario import Scenario
from sim.scenarios.tables import StartKind
from sim.vehicle.judge import NONE_MS
from sim.vehicle.mocap import MocapTape
from sim.vehicle.physics import Physics, fly, run_body, run_firmware

LANDED_AFTER_MS = 150  # time of contact after which the vehicle counts as landed, ms
_KEPT = "vehicle"  # name of the compiled flight code in the cache folder
# length of the warm-up run, ms of simulated time: long enough that every firmware loop runs and a sample of
# motion capture arrives
WARM_UP_MS = 100
_COLLISION = ContactBit.VEHICLE.value
_BROKEN = tuple(Fault(What.MOTOR, Kind.DEAD, motor=motor) for motor in range(1, 5))


class VehicleSim(Physics):
    """One vehicle with its firmware, and its deck; arguments as for ``Physics``."""

    def __init__(
        self, scenario: Scenario, seed: int, params: Params | None = None, plant: Plant | None = None
    ) -> None:
        super().__init__(scenario, seed, params, plant)
        r, params = self.record, self.params
        self._gravity = params.contact.gravity_m_s2
        self._imu = Imu(params.imu, self._gravity, CONTROL_STEP_S, seed, r.imu)
        spec = scenario.vehicle
        self.firmware = Firmware(spec, params, r.firmware)
        self._newest_estimate = self.firmware.estimator.estimate
        self._mocap = MocapTape(spec.mocap, seed, r.mocap, r.world.body, spec.own)
        motors = MotorFaults(r.motor_share, r.motor_held, r.rotors, params.rotor, self._hover_rpm)
        # the owner of the MAVLink connection uses ``faults.link``
        self.faults = Faults(scenario.fault, seed, motors, BatteryFaults(r.battery))
        self._read_commands = reader(r.firmware.commands)
        # set-point that keeps the vehicle in hover at the start in the mean wind, m/s; zero for other starts
        self.trim_velocity_enu_m_s: Vec3 = ZERO
        # part of the radio's delay that is already simulated when a set-point is sent, ms
        self.sent_before_ms = 0
        self._judging[0] = scenario.start.kind is StartKind.HOVER
        if scenario.start.kind is StartKind.HOVER:
            self._start_hover(scenario, seed)
        else:
            x, y = scenario.start.ground_position_m
            self._world.set_vehicle((x, y, -params.geometry.foot_bottom_m - 1e-5))
            self._ground_ms[0], self._since_ms[0] = 0, -LANDED_AFTER_MS
        self._settle()

    def _start_hover(self, scenario: Scenario, seed: int) -> None:
        """Place the vehicle at rest in the air, with rotors and firmware trimmed for the mean wind."""
        r, offset = self.record, scenario.start.offset_m or self._draw_offset(scenario, seed)
        deck, _ = self._world.deck_pose
        position = (deck[0] + offset[0], deck[1] + offset[1], deck[2] + offset[2])
        wx, wy, wz = r.wind.steady.tolist()
        drag_xy, _, drag_z = self.params.body.drag_n_s_m
        zx, zy, zz = 0.0, 0.0, 1.0
        fx = fy = fz = 0.0
        for _ in range(20):  # fixed-point iteration, because drag and tilt depend on each other
            along = (drag_z - drag_xy) * (wx * zx + wy * zy + wz * zz)
            fx, fy = -drag_xy * wx - along * zx, -drag_xy * wy - along * zy
            fz = self._weight_n - drag_xy * wz - along * zz
            length = math.sqrt(fx * fx + fy * fy + fz * fz)
            zx, zy, zz = fx / length, fy / length, fz / length
        self._world.set_vehicle(position, quaternion_from_axes(axes_from_force(fx, fy, fz, 1.0, 0.0)))
        r.rotors.rpm[:] = [
            self.params.rotor.rpm(length / 4.0 / self.plant.thrust / share) for share in self.plant.motors
        ]
        if self.params.rotor.volt_map is not None:
            drain(r.battery, r.rotors.rpm, 0.0)  # the first command depends on the voltage
        r.firmware.commands[:] = r.rotors.rpm
        scale = self.plant.thrust
        force = (fx / scale, fy / scale, fz / scale)
        self.trim_velocity_enu_m_s = self.firmware.start_flying(force, self.plant.motors, self.battery_v)

    def _draw_offset(self, scenario: Scenario, seed: int) -> Vec3:
        rng = stream(seed, "start")
        distance = rng.uniform(*scenario.start.distance_m)
        bearing = rng.uniform(-math.pi, math.pi)
        height = rng.uniform(*scenario.start.h_m) + self._barrier.height(distance)
        return (distance * math.cos(bearing), distance * math.sin(bearing), height)

    def _settle(self) -> None:
        """Set the IMU filters and the estimator to their steady state at the start."""
        position, velocity, quaternion, _ = self.body()
        axes, g = rotation_axes(quaternion), self._gravity
        self._imu.settle(velocity, (g * axes[2], g * axes[5], g * axes[8]))
        self.firmware.estimator.settle(position, velocity, axes, quaternion, self._imu.accel_bias)

    def _fly(self, end_ms: int) -> int:
        if not self.faults.quiet:
            end_ms = min(end_ms, self._fail())
        fly(self.cell, self._ms, end_ms)
        return end_ms

    def supplied_until(self, end_ms: int) -> bool:
        """Draw random numbers in advance; return whether they suffice up to ``end_ms``."""
        if end_ms > self._supplied_ms:
            self._supplied_ms = self._supply()
        return end_ms <= self._supplied_ms

    def flown(self, now_ms: int) -> None:
        """Set the simulated time, ms, after other code has called ``fly``."""
        self._ms = now_ms

    def _supply(self) -> int:
        self._imu.top_up()
        self._mocap.top_up()
        return min(super()._supply(), self._mocap.drawn_until_ms)

    def _fail(self) -> int:
        """Apply the faults that are due; return the time of the next call, ms."""
        faults, mocap, now_ms = self.faults, self._mocap, self._ms
        now_ns = now_ms * NS_PER_MS
        if now_ms % PERIOD_MS == 0 and faults.waits_for(After.TAKEOFF) and self.airborne:
            faults.refer(After.TAKEOFF, now_ns)
        if now_ns >= faults.next_ns:
            faults.run(now_ns)
        if now_ns >= faults.own_state.due_ns:
            faults.own_state.sample(now_ns, self._newest_estimate())
        next_ms = (now_ms // PERIOD_MS + 1) * PERIOD_MS
        self.record.mocap.diverted = faults.mocap.active
        if faults.mocap.active:
            for x, y, z, yaw in faults.mocap.deliver(now_ns, mocap.take(now_ms)):
                correct(self.record.firmware.estimator, x, y, z, yaw)
            next_ms = min(next_ms, mocap.next_ms())
        return min(next_ms, ms_from(faults.next_ns))

    def collide(self) -> None:
        """Simulate a collision with another vehicle: the propellers break, and no motor has thrust."""
        self.record.contact.bits |= _COLLISION
        self.faults.fail(_BROKEN, self._ms * NS_PER_MS)

    def arm(self) -> str | None:
        """Arm the vehicle. Return None if accepted or already armed, else the reason of the rejection."""
        return self.firmware.arm(self._ms, self.battery_v)

    def disarm(self, force: bool) -> str | None:
        """Disarm and stop the motors; ``force``: also in flight. Return the reason of a rejection."""
        if not force and self.armed and self.motors_running and not (self.on_pad or self.on_ground):
            return "in the air; land first, or force"
        self.firmware.disarm(self._ms)
        return None

    def reboot(self) -> str | None:
        """Restart and unlock the firmware. Return None if done, else the reason of the rejection."""
        if self.armed:
            return "armed; disarm first"
        self.firmware.restart(self._ms)
        self.stop_setpoint()
        return None

    def set_velocity(self, velocity_enu_m_s: Vec3, yaw_rad: float) -> None:
        """Send a velocity set-point; after the radio's delay it takes effect, and its age starts."""
        self.firmware.send(set_point(velocity_enu_m_s, yaw_rad), self._ms - self.sent_before_ms)

    def set_position(self, position_enu_m: Vec3, yaw_rad: float) -> None:
        """Send a position set-point to the PID loop, delayed as in ``set_velocity``."""
        setpoint = set_point(yaw_rad=yaw_rad, position=position_enu_m)
        self.firmware.send(setpoint, self._ms - self.sent_before_ms)

    def stop_setpoint(self) -> None:
        """Send a stop set-point; the motors are off until a newer set-point arrives."""
        self.firmware.send(STOP, self._ms - self.sent_before_ms)

    def begin_judging(self) -> None:
        """Start the judged part of the flight: the next touch of the pad counts as the first touch."""
        self._judging[0], self.record.contact.touch_ms = True, NONE_MS

    @property
    def time_s(self) -> float:
        return self._ms * STEP_S

    @property
    def battery_v(self) -> float:
        """Battery voltage under load, V."""
        return float(self._battery_v[0])

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return self.firmware.armed

    @property
    def locked(self) -> bool:
        """Whether the firmware is locked until a reboot (``reboot``)."""
        return self.firmware.state is State.LOCKED

    @property
    def supervisor_state(self) -> int:
        """Index of the supervisor's state in ``STATES``."""
        return STATES.index(self.firmware.state)

    @property
    def state_text(self) -> str:
        return str(self.firmware.state.value)

    @property
    def motors_running(self) -> bool:
        """Whether any motor has a speed command."""
        return self._read_commands() != OFF

    @property
    def motor_commands(self) -> tuple[float, float, float, float]:
        """Speed commands of M1..M4 divided by the highest speed at the current voltage, 0 to 1."""
        limit = speed_limit(self.record.battery)
        m1, m2, m3, m4 = (min(1.0, max(0.0, c / limit)) for c in self._read_commands())
        return (m1, m2, m3, m4)

    @property
    def duty(self) -> tuple[float, float, float, float]:
        """Duty cycles of M1..M4, 0 to 1, for a motor map without battery compensation."""
        at_zero, limit = speed_at_no_duty(self.record.battery), speed_limit(self.record.battery)
        m1, m2, m3, m4 = (
            min(1.0, max(0.0, (c - at_zero) / (limit - at_zero))) for c in self._read_commands()
        )
        return (m1, m2, m3, m4)

    @property
    def landed(self) -> bool:
        """Whether the vehicle has touched pad or floor for 0.15 s."""
        lasts: bool = self._ms - self._since_ms[0] >= LANDED_AFTER_MS
        return lasts and (self.on_pad or self.on_ground)

    def estimate(self) -> Estimate:
        """Return the newest state estimate that has reached the autopilot."""
        newest = self._newest_estimate()
        if self.faults.quiet:
            return newest
        return self.faults.own_state.report(self._ms * NS_PER_MS, newest)


def warm_up(scenario: Scenario) -> None:
    """Compile the code of a flight, or load it from the cache, within some milliseconds."""
    vehicle = VehicleSim(scenario, 0)
    vehicle.arm()
    with compiling(_KEPT, "the simulator, about 10 s, once") as cold:
        if cold:
            at_once(lambda: run_body(vehicle.record, 0), lambda: run_firmware(vehicle.record, 0))
        for _ in range(WARM_UP_MS // 10):
            vehicle.set_velocity((0.0, 0.0, 0.3), 0.0)
            vehicle.advance(10)
            vehicle.truth()
            vehicle.estimate()


def compile_first(scenario: Scenario) -> None:
    """Compile code that is not in the cache before processes with time-outs start.

    Forked processes inherit the compiled code, even where it cannot be stored in the cache.
    """
    if not is_off() and not is_kept(_KEPT):
        warm_up(scenario)
