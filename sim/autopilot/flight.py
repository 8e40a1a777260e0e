"""Arming, modes and fail-safes of the simulated vehicle, with two inputs: charge and ground contact.

The charge is computed as in PX4 battery.cpp. The voltage under load plus the voltage drop at this throttle is
compared with the voltages of an empty and a full cell. Voltage and throttle are low-pass filtered, because
otherwise every climb would indicate an empty battery.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import yaw_from_quaternion
from bridge.mavlink.profiles import OWN_SITL
from bridge.mavlink.server.commander import Battery, Commander, Sender, Setpoint
from bridge.mavlink.server.parameters import Parameters
from bridge.mavlink.server.profile import POSITION_SOURCE, FlightMode
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import Cell, Record, cell, new, scalars
from sim.autopilot.pilot import Event, Pilot
from sim.vehicle.vehicle import VehicleSim

PERIOD_S = 0.1 - 1e-6  # time between two filter steps, s; 1e-6 s allow for rounding
_SMOOTH_S = 1.0  # time constant of the low-pass filter, s


class WatchRecord(Record):
    """State of ``Watches``."""

    due_s: float  # time of the next filter step
    last_s: float  # time of the last filter step; NaN before the first
    voltage_v: float  # battery voltage, low-pass filtered
    throttle: float  # mean motor command, low-pass filtered


@jitted
def check(watches: Cell[WatchRecord], now_s: float, voltage_v: float, throttle: float) -> None:
    """Filter voltage and throttle with a first-order low-pass filter; set the time of the next step."""
    w = watches[0]
    dt_s = now_s - w.last_s if w.last_s == w.last_s else 0.0
    share = 1.0 - math.exp(-dt_s / _SMOOTH_S)
    w.voltage_v += share * (voltage_v - w.voltage_v)
    w.throttle += share * (throttle - w.throttle)
    w.last_s, w.due_s = now_s, now_s + PERIOD_S


class Watches:
    """Filters voltage and throttle ten times a second."""

    def __init__(self, parameters: Parameters, vehicle: VehicleSim) -> None:
        self._parameters = parameters
        self._vehicle = vehicle
        record = new(WatchRecord, (-math.inf, math.nan, vehicle.battery_v, throttle(vehicle)))
        self.cell = cell(record)  # state for compiled code
        self._due_s, self._voltage_v, self._throttle = scalars(record, "due_s", "voltage_v", "throttle")

    @property
    def charge(self) -> float:
        """Remaining charge, 0 to 1."""
        p = self._parameters
        empty_v, full_v, drop_v = p["BAT1_V_EMPTY"], p["BAT1_V_CHARGED"], p["BAT1_V_LOAD_DROP"]
        rest_v: float = self._voltage_v[0] + drop_v * self._throttle[0]
        return min(max((rest_v - empty_v) / max(full_v - empty_v, 0.01), 0.0), 1.0)

    def step(self, now_s: float) -> None:
        """Filter voltage and throttle if the next filter step is due."""
        if now_s >= self._due_s[0]:
            check(self.cell, now_s, self._vehicle.battery_v, throttle(self._vehicle))


def throttle(vehicle: VehicleSim) -> float:
    """Return the mean of the motor commands, 0 to 1."""
    m1, m2, m3, m4 = vehicle.motor_commands
    return (m1 + m2 + m3 + m4) / 4.0  # not sum(), whose rounding changed in Python 3.12


_CONTACT_S = 0.3  # unbroken contact after which the vehicle counts as standing, s; bounces are shorter
_NO_CONTACT_S = 0.1  # time without contact after which the vehicle counts as flying, s


class Standing:
    """Detects from lasting contact that the vehicle stands on a surface."""

    def __init__(self, vehicle: VehicleSim) -> None:
        self._vehicle = vehicle
        self.now = vehicle.landed or vehicle.on_pad or vehicle.on_ground  # whether the vehicle stands
        self.since_s = 0.0  # time since which ``now`` has its value, s
        self._contact = self.now
        self._changed_s = 0.0

    @property
    def settled(self) -> bool:
        """Whether the newest contact reading agrees with ``now``."""
        return self._contact == self.now

    def watch(self, now_s: float, armed: bool) -> None:
        """Read the contacts; call it at every tick."""
        vehicle = self._vehicle
        contact = vehicle.on_pad or vehicle.on_ground or vehicle.landed
        if contact != self._contact:
            self._contact, self._changed_s = contact, now_s
        if contact == self.now:
            return
        lasted_s = now_s - self._changed_s
        if not armed or lasted_s >= (_CONTACT_S if contact else _NO_CONTACT_S) - 1e-9:
            self.now = contact or not armed
            self.since_s = now_s


HEIGHT_RANGE_M = (0.1, 20.0)  # allowed take-off height above home, m; the room is lower
# Mode that COM_OBL_RC_ACT selects (PX4 failsafe.cpp). Value 0 selects position mode, which needs stick
# input; without this input PX4 lands, too.
STREAM_LOST: Mapping[int, FlightMode] = {0: FlightMode.LAND, 4: FlightMode.LAND, 5: FlightMode.HOLD}
_ESTIMATE_LOST_S = 0.5  # time without a valid estimate after which the vehicle lands, s


class Flight(Commander):
    mark = OWN_SITL.mark
    sensors = Commander.sensors | dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    height_range_m = HEIGHT_RANGE_M

    def __init__(self, vehicle: VehicleSim, parameters: Parameters, period_s: float) -> None:
        super().__init__()
        self.vehicle = vehicle
        x, y, _ = vehicle.estimate().position_enu_m
        self.home_enu_m = (x, y, 0.0)
        self.pilot = Pilot(vehicle, parameters)
        self.watches = Watches(parameters, vehicle)
        self.ground = Standing(vehicle)
        self._parameters = parameters
        self._was_armed = vehicle.armed
        self._flew = vehicle.armed and not self.ground.now  # whether the vehicle has flown since arming
        self._control_s: float | None = None
        self._period_s = period_s
        self._armed_s = 0.0
        self._estimate_seen_s = 0.0

    @property
    def armed(self) -> bool:
        return self.vehicle.armed

    @property
    def battery(self) -> Battery:
        """Battery state, with PX4's estimate of the charge."""
        return Battery(self.vehicle.battery_v, round(100 * self.watches.charge))

    @property
    def standing(self) -> bool:
        return self.ground.now

    @property
    def stream_lost_s(self) -> float:
        return self._parameters["COM_OF_LOSS_T"]

    @property
    def positioned(self) -> bool:
        """Whether the position estimate is valid for flight."""
        return self.vehicle.estimate().valid

    @property
    def airborne(self) -> bool:
        return self.vehicle.armed and not self.standing

    def sensors_healthy(self, _now_s: float) -> int:
        """Return the bits of position and fence; without the fence bit MAVProxy reports a fence breach."""
        return (POSITION_SOURCE if self.positioned else 0) | int(dialect.MAV_SYS_STATUS_GEOFENCE)

    def problems(self, _now_s: float) -> list[str]:
        found = []
        if self.vehicle.locked:
            found.append("firmware is locked, restart it (command 246)")
        if not self.positioned:
            found.append("no position estimate")
        return found

    def _why_no_mode(self, _mode: FlightMode, _now_s: float) -> str | None:
        return None if self.positioned else "no position estimate"

    def _height_m(self) -> float:
        return self.vehicle.estimate().position_enu_m[2]

    def _default_takeoff_z_m(self) -> float:
        if self.mode is FlightMode.TAKEOFF:
            return self.takeoff_z_m
        ground_z_m = self._height_m() if self.standing else self.home_enu_m[2]
        return ground_z_m + self._parameters["MIS_TAKEOFF_ALT"]

    def _take(self, setpoint: Setpoint, _now_s: float) -> None:
        self.pilot.take(setpoint)

    def _begin(self, _now_s: float) -> None:
        self.pilot.begin()

    def arm(self, now_s: float) -> str | None:
        """Arm the vehicle; return the reason of a refusal. The motors idle until a mode commands thrust."""
        if self.vehicle.armed:
            return None
        problems = self.problems(now_s)
        if self.mode is FlightMode.LAND:
            problems.append(f"mode is {self.mode.value}")
        reason = problems[0] if problems else self.vehicle.arm()
        if reason is not None:
            return f"Arming refused: {reason}"
        self._armed_s, self._flew, self._was_armed = now_s, False, True
        self.pilot.begin()
        self.texts.say(dialect.MAV_SEVERITY_INFO, "Armed")
        return None

    def disarm(self, now_s: float, *, force: bool) -> str | None:
        if not self.vehicle.armed:
            self.vehicle.disarm(force)  # a disarm also resets the firmware's crash state
            return None
        if self.airborne and not force:
            return "Disarming refused: not landed"
        reason = self.vehicle.disarm(force)
        if reason is not None:
            return f"Disarming refused: {reason}"
        self._after_disarm("Disarmed by force" if force else "Disarmed", now_s)
        return None

    def terminate(self, now_s: float) -> str | None:
        return self.disarm(now_s, force=True) if self.armed else "Termination refused: not armed"

    def reboot(self, now_s: float) -> str | None:
        """Restart the firmware, also if locked; parameters, home and boot clock do not change."""
        if self.vehicle.armed:
            return "Reboot refused: armed"
        reason = self.vehicle.reboot()
        if reason is not None:
            return f"Reboot refused: {reason}"
        self._enter(FlightMode.HOLD, now_s)
        self.texts.say(dialect.MAV_SEVERITY_INFO, "Firmware restarted")
        return None

    def flown(self, now_s: float, setpoint: Setpoint | None, sender: Sender) -> None:
        """Update the state after ticks that flew set-points without ``control``; ``setpoint``: newest."""
        self._control_s = self._estimate_seen_s = now_s
        if setpoint is not None:
            self._owner, self._setpoint_s = sender, now_s
            self.pilot.handed_on(setpoint)

    @property
    def stream_ends_s(self) -> float:
        """Time at which the stream of set-points times out if no set-point arrives, s."""
        return self._setpoint_s + self.stream_lost_s

    def yaw_rad(self) -> float:
        return yaw_from_quaternion(self.vehicle.estimate().quaternion)

    def control(self, now_s: float) -> None:
        """Run modes and fail-safes; call it at every tick, after the messages and before the physics."""
        dt_s = now_s - self._control_s if self._control_s is not None else self._period_s
        self._control_s = now_s
        vehicle, ground = self.vehicle, self.ground
        estimate, armed = vehicle.estimate(), vehicle.armed
        if estimate.valid:
            self._estimate_seen_s = now_s
        ground.watch(now_s, armed)
        standing = ground.now
        if not standing:
            self._flew = True
        if self._was_armed and not armed:
            self._after_disarm("Disarmed by the firmware", now_s, dialect.MAV_SEVERITY_CRITICAL)
        self._failsafes(now_s)
        self.watches.step(now_s)
        if armed and standing:
            self._disarm_idle(now_s)
            armed = vehicle.armed
        if armed:
            event = self.pilot.fly(self.mode, self.takeoff_z_m, estimate, standing, dt_s)
            if event is not None:
                self._follow(event, now_s)

    def _follow(self, event: Event, now_s: float) -> None:
        if event is Event.ARRIVED:
            self._enter(FlightMode.HOLD, now_s)
            self.pilot.go_on()
        elif event is Event.LANDED:
            self._try_disarm("Landed, disarmed", now_s)
        else:
            self.texts.refuse("Set-point clipped to MPC_XY_VEL_MAX or MPC_Z_VEL_MAX", now_s)

    def _after_disarm(self, text: str, now_s: float, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        self.texts.say(severity, text)
        self.pilot.stop()
        self._owner = None
        self._was_armed = self._flew = False
        if self.mode is not FlightMode.OFFBOARD:  # OFFBOARD remains until its stream ends
            self._enter(FlightMode.HOLD, now_s)
        self.failsafe = False

    def _failsafes(self, now_s: float) -> None:
        if self.mode is FlightMode.OFFBOARD and not self._streamed(now_s):
            if self.vehicle.armed:
                mode = STREAM_LOST[int(self._parameters["COM_OBL_RC_ACT"])]
                self._fall_back(now_s, mode, f"No set-points for {self.stream_lost_s:.3g} s")
            else:
                self._enter(FlightMode.HOLD, now_s)
        lost = now_s - self._estimate_seen_s > _ESTIMATE_LOST_S
        if lost and self.airborne and self.mode is not FlightMode.LAND:
            self._fall_back(now_s, FlightMode.LAND, "No position estimate")

    def _fall_back(self, now_s: float, mode: FlightMode, text: str) -> None:
        """Change to ``mode`` because of a failure; on the ground, or without a position, change to LAND."""
        if self.standing or not self.positioned:
            mode = FlightMode.LAND  # LAND disarms on the ground and needs no position
        doing = "landing" if mode is FlightMode.LAND else "holding"
        self.texts.say(dialect.MAV_SEVERITY_CRITICAL, f"{text}: {doing}")
        self._enter(mode, now_s, failsafe=True, restart=True)

    def _disarm_idle(self, now_s: float) -> None:
        if not self._flew:
            if now_s - self._armed_s >= self._parameters["COM_DISARM_PRFLT"]:
                self._try_disarm("Disarmed: no take-off", now_s)
        elif now_s - self.ground.since_s >= self._parameters["COM_DISARM_LAND"]:
            self._try_disarm("Disarmed: landed", now_s)

    def _try_disarm(self, text: str, now_s: float) -> None:
        self.vehicle.stop_setpoint()
        if self.vehicle.disarm(False) is None:
            self._after_disarm(text, now_s)
