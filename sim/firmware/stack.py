"""Everything that runs on the Crazyflie, wired together: set-points in, rotor speed commands out."""

from __future__ import annotations

import math
from collections import deque

from flightstack.types import Vec3
from sim.firmware.estimator import Estimator, EstimatorRecord
from sim.firmware.mixer import OFF, MapRecord, ThrustMap, mix, motor_speed
from sim.firmware.paper_loop import PaperLoop, PaperRecord, paper_reset, paper_update
from sim.firmware.pid import CascadeRecord, PidLoop, cascade_reset, cascade_update
from sim.firmware.setpoint import STOP, Setpoint, SetpointRecord, VelocityController
from sim.firmware.supervisor import State, Supervisor
from sim.jit import jitted
from sim.params import CONTROL_STEP_S, Params
from sim.records import Motors, Record, cell
from sim.rotors import Four
from sim.scenario import VehicleSpec, VelocityLoop

NEVER_MS = 1 << 62
BATTERY_MIN_V = 3.2  # platform_defaults_cf2.h: DEFAULT_BAT_LOW_VOLTAGE
TILT_MAX_COS = 0.5  # arming tilted by more than 60 degrees is refused


PAPER, PID = 0, 1


class FirmwareRecord(Record):
    """All that the Crazyflie remembers, but for the supervisor and set-points on their way."""

    estimator: EstimatorRecord
    setpoint: SetpointRecord
    motors_allowed: bool  # by the supervisor
    level: bool
    loop: int  # PAPER or PID
    paper: PaperRecord
    pid: CascadeRecord
    thrust_map: MapRecord
    commands: Motors  # rotor speed commands, rpm


@jitted
def forget(f: FirmwareRecord) -> None:
    """Reset the velocity loop; the rates of the last flight are nothing to take a derivative with."""
    if f.loop == PAPER:
        paper_reset(f.paper)
        f.paper.attitude.wx = math.nan
    else:
        cascade_reset(f.pid)


@jitted
def control(f: FirmwareRecord, rpm_max: float) -> None:
    """Run the velocity loop and the mixer once (500 Hz); motors off without set-point or permission."""
    if f.setpoint.stop or not f.motors_allowed:
        if f.commands[0] != 0.0 or f.commands[1] != 0.0 or f.commands[2] != 0.0 or f.commands[3] != 0.0:
            forget(f)
            f.commands[:] = 0.0
        return
    if f.loop == PAPER:
        thrust, moments = paper_update(f.paper, f.estimator.sensed, f.setpoint, f.level)
    else:
        thrust, moments = cascade_update(f.pid, f.estimator.sensed, f.setpoint, f.level)
    counts = mix(thrust, moments)
    for i in range(4):
        f.commands[i] = motor_speed(f.thrust_map, counts[i], rpm_max)


class Firmware:
    """Estimator, controllers, mixer and supervisor.

    Attributes:
        supervisor: its state.
        next_setpoint_ms: when the next set-point on its way arrives.
    """

    def __init__(self, spec: VehicleSpec, params: Params, record: FirmwareRecord) -> None:
        self.record = record
        self._commands = record.commands
        self._setpoint = cell(record.setpoint)
        self._allowed, self._level = cell(record)["motors_allowed"], cell(record)["level"]
        self._delay_ms = round(spec.setpoint_delay_s * 1000.0)
        self._gravity = params.contact.gravity_m_s2
        ThrustMap(params.rotor, record.thrust_map)
        self._queue: deque[tuple[int, Setpoint]] = deque()
        self._setpoint_ms = 0
        self._take(STOP, 0)
        paper, pid = PaperLoop(params, record.paper), PidLoop(params, record.pid)
        record.loop = {VelocityLoop.PAPER: PAPER, VelocityLoop.PID: PID}[spec.velocity_loop]
        self.controller: VelocityController = paper if record.loop == PAPER else pid
        period_s = 1.0 / spec.mocap.rate_hz
        self.estimator = Estimator(period_s, CONTROL_STEP_S, self._gravity, record.estimator)
        self.supervisor = Supervisor()
        self.next_setpoint_ms = NEVER_MS

    @property
    def commands(self) -> Four:
        """Rotor speed commands M1..M4, rpm."""
        m1, m2, m3, m4 = self._commands.tolist()
        return (m1, m2, m3, m4)

    @commands.setter
    def commands(self, commands: Four) -> None:
        self._commands[:] = commands

    def _take(self, setpoint: Setpoint, since_ms: int) -> None:
        self._setpoint_ms = since_ms
        self._setpoint[0] = setpoint.fields()

    def _obey(self) -> None:
        """Hand the supervisor's decision to the controllers."""
        self._allowed[0], self._level[0] = self.supervisor.motors_allowed, self.supervisor.level

    def start_flying(self, setpoint: Setpoint) -> None:
        """Begin armed and in the air at time zero."""
        self._take(setpoint, 0)
        self.supervisor.motors_last_ms = 0
        self.supervisor.enter(State.FLYING, 0)
        self._obey()

    def send(self, setpoint: Setpoint, now_ms: int) -> None:
        """Put a set-point on its way; it arrives after the radio's delay."""
        self._queue.append((now_ms + self._delay_ms, setpoint))
        self.next_setpoint_ms = self._queue[0][0]

    def receive(self, now_ms: int) -> None:
        """Take the set-points that have arrived."""
        queue = self._queue
        while queue and queue[0][0] <= now_ms:
            since_ms, setpoint = queue.popleft()
            self._take(setpoint, since_ms)
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
            self._take(STOP, now_ms)
            self.controller.reset()
        self._obey()
        return refused

    def disarm(self, now_ms: int) -> None:
        """Disarm, motors off at once."""
        self.supervisor.disarm(now_ms)
        self._obey()
        self.commands = OFF

    def supervise(self, now_ms: int, accel: Vec3) -> None:
        """Run the supervisor; call every ``PERIOD_MS``, between estimate and control."""
        ax, ay, az = accel
        g = self._gravity
        age_ms = now_ms - self._setpoint_ms
        self.supervisor.update(now_ms, age_ms, self.commands != OFF, (ax / g, ay / g, az / g))
        self._obey()
