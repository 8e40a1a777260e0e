"""The whole firmware model: computes rotor speed commands from set-points."""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Motors, Record, scalars
from flightstack.core.types import ZERO, Vec3
from sim.firmware import supervisor
from sim.firmware.estimator import Estimator, EstimatorRecord
from sim.firmware.geometric import PaperRecord, paper_reset, paper_trim, paper_update, set_up_paper
from sim.firmware.mixer import OFF, MapRecord, counts_per_n, moments_of, motor_speeds, set_up_map
from sim.firmware.pid import CascadeRecord, cascade_reset, cascade_trim, cascade_update, set_up_cascade
from sim.firmware.setpoint import STOP, Inbox, InboxRecord, Setpoint, SetpointRecord, set_point
from sim.firmware.supervisor import STATES, State, SupervisorRecord, flies, supervise
from sim.plant.params import Four, Params
from sim.scenarios.tables import VehicleSpec, VelocityLoop

BATTERY_MIN_V = 3.2  # minimum battery voltage for arming (platform_defaults_cf2.h: DEFAULT_BAT_LOW_VOLTAGE)
TILT_MAX_COS = 0.5  # cosine of the maximum tilt for arming, 60 degrees

PAPER, PID = 0, 1


class FirmwareRecord(Record):
    """State of the Crazyflie's firmware, and set-points in transit."""

    estimator: EstimatorRecord
    inbox: InboxRecord
    setpoint: SetpointRecord
    supervisor: SupervisorRecord
    gravity: float
    loop: int  # velocity loop: PAPER or PID
    paper: PaperRecord
    pid: CascadeRecord
    thrust_map: MapRecord
    commands: Motors  # rotor speed commands, rpm


@jitted
def running(commands: F64) -> bool:
    """Whether any motor has a speed command."""
    return bool(commands[0] != 0.0 or commands[1] != 0.0 or commands[2] != 0.0 or commands[3] != 0.0)


@jitted
def oversee(f: FirmwareRecord, now_ms: int, accel: F64) -> None:
    """Run the supervisor; call it every ``PERIOD_MS``, between estimator and controller."""
    g, age_ms = f.gravity, now_ms - f.inbox.taken_ms
    supervise(f.supervisor, now_ms, age_ms, running(f.commands), accel[0] / g, accel[1] / g, accel[2] / g)
    f.estimator.body_z = f.estimator.by_pose and flies(f.supervisor)


@jitted
def forget(f: FirmwareRecord) -> None:
    """Reset the velocity loop and the last rates between two flights."""
    if f.loop == PAPER:
        paper_reset(f.paper)
        f.paper.wx = math.nan
    else:
        cascade_reset(f.pid)


@jitted
def control(f: FirmwareRecord, rpm_max: float) -> None:
    """Run velocity loop and mixer once (500 Hz); stop the motors if disarmed or on a stop set-point."""
    if f.setpoint.stop or not f.supervisor.motors_allowed:
        if running(f.commands):
            forget(f)
            f.commands[:] = 0.0
        return
    if f.loop == PAPER:
        thrust, moments = paper_update(f.paper, f.estimator.sensed, f.setpoint, f.supervisor.level)
    else:
        thrust, moments = cascade_update(f.pid, f.estimator.sensed, f.setpoint, f.supervisor.level)
    motor_speeds(f.thrust_map, thrust, moments, rpm_max, f.commands)


class Firmware:
    """Estimator, controllers, mixer and supervisor of one vehicle; ``record`` stores the state."""

    def __init__(self, spec: VehicleSpec, params: Params, record: FirmwareRecord) -> None:
        self.record = r = record
        self.delay_ms = round(spec.setpoint_delay_s * 1000.0)
        self._params = params
        r.gravity = gravity = params.contact.gravity_m_s2
        set_up_map(r.thrust_map, params.rotor, params.battery)
        self._inbox = Inbox(r.inbox, r.setpoint)
        self._inbox.set(STOP, 0)
        set_up_paper(r.paper, params)
        set_up_cascade(r.pid, params)
        r.loop = {VelocityLoop.PAPER: PAPER, VelocityLoop.PID: PID}[spec.velocity_loop]
        self.estimator = Estimator(r.estimator, 1.0 / spec.mocap.rate_hz, gravity, spec.known_drag_1_s)
        self._state, self._armed = scalars(r.supervisor, "state", "motors_allowed")
        supervisor.restart(r.supervisor)

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return bool(self._armed[0])

    @property
    def state(self) -> State:
        """State of the supervisor."""
        return STATES[int(self._state[0])]

    def start_flying(self, force: Vec3, motors: Four, battery_v: float) -> Vec3:
        """Start armed in hover at yaw 0 and time zero; return the velocity set-point of the hover.

        ``force``: force of nominal motors, world, N; ``motors``: thrust of each motor divided by their mean.
        """
        r, trim = self.record, ZERO
        thrust_n = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
        per_n = counts_per_n(self._params, thrust_n, battery_v)
        if r.loop == PAPER:
            trim = paper_trim(r.paper, force, per_n)
        else:
            shares_n = (thrust_n / share for share in motors)
            each = [counts_per_n(self._params, share_n, battery_v) * share_n for share_n in shares_n]
            cascade_trim(r.pid, force, per_n, moments_of(each))
        self._inbox.set(set_point(trim), 0)
        supervisor.start_flying(r.supervisor)
        return trim

    def send(self, setpoint: Setpoint, now_ms: int) -> None:
        """Send a set-point; it arrives after the radio's delay."""
        self._inbox.send(setpoint, now_ms + self.delay_ms)

    def arm(self, now_ms: int, battery_v: float) -> str | None:
        """Arm the vehicle; return None, or the reason of the rejection."""
        r = self.record
        if not self.estimator.valid:
            return "no motion-capture samples"
        if r.estimator.sensed.axes[8] < TILT_MAX_COS:
            return "not upright"
        if battery_v < BATTERY_MIN_V:
            return f"battery at {battery_v:.2f} V, at least {BATTERY_MIN_V} V are needed"
        fresh = not self.armed
        refused = supervisor.arm(r.supervisor, now_ms)
        if refused is None and fresh:  # earlier set-points no longer apply
            self._inbox.set(STOP, now_ms)
            if r.loop == PAPER:
                paper_reset(r.paper)
            else:
                cascade_reset(r.pid)
        return refused

    def disarm(self, now_ms: int) -> None:
        """Disarm and stop the motors immediately."""
        supervisor.disarm(self.record.supervisor, now_ms)
        self.record.commands[:] = OFF

    def restart(self, now_ms: int) -> None:
        """Restart and unlock the firmware."""
        supervisor.restart(self.record.supervisor)
        self.disarm(now_ms)
