"""Everything that runs on the Crazyflie, wired together: set-points in, rotor speed commands out."""

from __future__ import annotations

from collections import deque

from flightstack.types import Vec3
from sim.firmware.estimator import Estimator
from sim.firmware.mixer import OFF, ThrustMap, mix
from sim.firmware.paper_loop import PaperLoop
from sim.firmware.pid import PidLoop
from sim.firmware.setpoint import STOP, Setpoint, VelocityController
from sim.firmware.supervisor import PERIOD_MS, State, Supervisor
from sim.params import CONTROL_STEP_S, Params
from sim.rotors import Four
from sim.scenario import VehicleSpec, VelocityLoop
from sim.sensors import Imu

LOOPS: dict[VelocityLoop, type[PaperLoop] | type[PidLoop]] = {
    VelocityLoop.PAPER: PaperLoop,
    VelocityLoop.PID: PidLoop,
}
NEVER_MS = 1 << 62
BATTERY_MIN_V = 3.2  # platform_defaults_cf2.h: DEFAULT_BAT_LOW_VOLTAGE
TILT_MAX_COS = 0.5  # arming tilted by more than 60 degrees is refused


class Firmware:
    """Estimator, controllers, mixer and supervisor.

    Attributes:
        commands: rotor speed commands M1..M4, rpm.
        supervisor: its state.
        next_setpoint_ms: when the next set-point on its way arrives.
    """

    def __init__(self, spec: VehicleSpec, params: Params, imu: Imu) -> None:
        self._delay_ms = round(spec.setpoint_delay_s * 1000.0)
        self._gravity = params.contact.gravity_m_s2
        self._imu = imu
        self._map = ThrustMap(params.rotor)
        self._queue: deque[tuple[int, Setpoint]] = deque()
        self._setpoint = STOP
        self._setpoint_ms = 0
        self.controller: VelocityController = LOOPS[spec.velocity_loop](params)
        self.estimator = Estimator(1.0 / spec.mocap.rate_hz, CONTROL_STEP_S, self._gravity)
        self.supervisor = Supervisor()
        self.commands: Four = OFF
        self.next_setpoint_ms = NEVER_MS

    def start_flying(self, setpoint: Setpoint) -> None:
        """Begin armed and in the air at time zero."""
        self._setpoint, self._setpoint_ms = setpoint, 0
        self.supervisor.motors_last_ms = 0
        self.supervisor.enter(State.FLYING, 0)

    def send(self, setpoint: Setpoint, now_ms: int) -> None:
        """Put a set-point on its way; it arrives after the radio's delay."""
        self._queue.append((now_ms + self._delay_ms, setpoint))
        self.next_setpoint_ms = self._queue[0][0]

    def receive(self, now_ms: int) -> None:
        """Take the set-points that have arrived."""
        queue = self._queue
        while queue and queue[0][0] <= now_ms:
            self._setpoint_ms, self._setpoint = queue.popleft()
        self.next_setpoint_ms = queue[0][0] if queue else NEVER_MS

    def arm(self, now_ms: int, battery_v: float) -> str | None:
        """Arm; None if accepted, else the reason."""
        if not self.estimator.valid:
            return "no motion-capture samples"
        if self.estimator.sensed.axes[8] < TILT_MAX_COS:
            return "not upright"
        if battery_v < BATTERY_MIN_V:
            return f"battery at {battery_v:.2f} V, at least {BATTERY_MIN_V} V are needed"
        fresh = not self.supervisor.motors_allowed
        refused = self.supervisor.arm(now_ms)
        if refused is None and fresh:  # what came before counts for nothing
            self._queue.clear()
            self.next_setpoint_ms = NEVER_MS
            self._setpoint, self._setpoint_ms = STOP, now_ms
            self.controller.reset()
        return refused

    def disarm(self, now_ms: int) -> None:
        """Disarm, motors off at once."""
        self.supervisor.disarm(now_ms)
        self.commands = OFF

    def tick(self, now_ms: int, velocity: Vec3, rates: Vec3, axes: tuple[float, ...], rpm_max: float) -> None:
        """Run one control step (500 Hz): measure the true motion, estimate, control, mix."""
        imu, estimator, supervisor = self._imu, self.estimator, self.supervisor
        imu.measure(velocity, rates, axes)
        estimator.predict(imu.gyro, imu.accel)
        if now_ms % PERIOD_MS == 0:
            ax, ay, az = imu.accel
            g = self._gravity
            age = now_ms - self._setpoint_ms
            supervisor.update(now_ms, age, self.commands != OFF, (ax / g, ay / g, az / g))
        setpoint = self._setpoint
        if setpoint.stop or not supervisor.motors_allowed:
            if self.commands != OFF:
                self.controller.reset()
                self.commands = OFF
            return
        thrust, moments = self.controller.update(estimator.sensed, setpoint, supervisor.level)
        self.commands = self._map.speeds(mix(thrust, moments), rpm_max)
