"""What the autopilot does with its vehicle: arming, modes, and fail-safes."""

from __future__ import annotations

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import yaw_from_quaternion
from bridge.mavlink.server.owner import ControlOwner, Right, Sender
from bridge.mavlink.server.parameters import Parameters
from bridge.mavlink.server.profile import AIRBORNE_STATE, POSITION_SOURCE, FlightMode
from bridge.mavlink.server.setpoints import Setpoint
from bridge.mavlink.server.telemetry import Battery
from bridge.mavlink.server.texts import Texts
from flightstack.core.types import ZERO, Vec3
from sim.autopilot.pilot import Event, Goal, Pilot
from sim.autopilot.vehicle_like import Standing, VehicleLike
from sim.autopilot.watches import STATION_LOST, Watches

HEIGHT_RANGE_M = (0.1, 20.0)  # m above home of take-off and reposition; the room is lower
_REACH_M = 50.0  # m from home of a reposition
# Mode that COM_OBL_RC_ACT selects (PX4 failsafe.cpp). 0 is the position mode: without sticks it cannot be
# flown, and PX4 too ends by landing.
STREAM_LOST: Mapping[int, FlightMode] = {0: FlightMode.LAND, 4: FlightMode.LAND, 5: FlightMode.HOLD}
_ESTIMATE_LOST_S = 0.5  # s without a valid estimate until it lands by itself


class Flight:
    """Modes, arming and fail-safes. Methods that can refuse return the reason, or None when done.

    Attributes:
        mode: flight mode; meaningful also while disarmed.
        failsafe: the present mode was not asked for but forced by a failure.
        texts: what it says.
        pilot, ground: flies the mode; watches the contacts.
        watches: slow fail-safes, with the battery.
    """

    arming = False  # the firmware answers at once

    def __init__(
        self,
        vehicle: VehicleLike,
        parameters: Parameters,
        period_s: float,
        trim_enu_m_s: Vec3 = ZERO,
    ) -> None:
        self.vehicle = vehicle
        self.mode = FlightMode.HOLD
        self.failsafe = False
        self.texts = Texts()
        x, y, _ = vehicle.estimate().position_enu_m
        self.pilot = Pilot(vehicle, parameters, (x, y, 0.0), trim_enu_m_s)
        self.watches = Watches(parameters, vehicle)
        self._parameters = parameters
        self.ground = Standing(vehicle)
        self._owner = ControlOwner()
        self._setpoint_s = -math.inf
        self._was_armed = vehicle.armed
        self._flew = vehicle.armed and not self.ground.now  # since arming
        self._control_s: float | None = None
        self._period_s = period_s
        self._armed_s = 0.0
        self._estimate_seen_s = 0.0

    @property
    def armed(self) -> bool:
        """Motors may run."""
        return self.vehicle.armed

    @property
    def battery(self) -> Battery:
        """Battery, with PX4's estimate of its charge."""
        return Battery(self.vehicle.battery_v, round(100 * self.watches.charge))

    @property
    def standing(self) -> bool:
        """On the ground or on the pad, not just touching."""
        return self.ground.now

    @property
    def home_enu_m(self) -> Vec3:
        """Home, local."""
        return self.pilot.home_enu_m

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        return int(dialect.MAV_LANDED_STATE_ON_GROUND) if self.standing else AIRBORNE_STATE[self.mode]

    @property
    def positioned(self) -> bool:
        """Whether there is a position to fly by."""
        return self.vehicle.estimate().valid

    @property
    def airborne(self) -> bool:
        """Armed and off the ground."""
        return self.vehicle.armed and not self.standing

    def sensors_healthy(self, _now_s: float) -> int:
        """The position, and the fence that it does not have: else MAVProxy reports a breach."""
        return (POSITION_SOURCE if self.positioned else 0) | int(dialect.MAV_SYS_STATUS_GEOFENCE)

    def problems(self, _now_s: float) -> list[str]:
        """Reasons why the vehicle would not arm now; empty when ready."""
        found = []
        if self.vehicle.locked:
            found.append("firmware is locked, restart it (command 246)")
        if not self.positioned:
            found.append("no position estimate")
        return found

    def forbids(self, sender: Sender, right: Right, now_s: float) -> str | None:
        """Why this sender may not do something now; on the ground and disarmed everybody may."""
        if not self.vehicle.armed:
            return None
        return self._owner.forbids(sender, right, now_s, self._parameters["COM_OF_LOSS_T"])

    def arm(self, now_s: float) -> str | None:
        """Arm; nothing moves before a mode says so."""
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
        self.say(dialect.MAV_SEVERITY_INFO, "Armed")
        return None

    def disarm(self, _now_s: float, *, force: bool) -> str | None:
        """Disarm; in the air only by force."""
        if not self.vehicle.armed:
            self.vehicle.disarm(force)  # also clears the firmware's memory of a crash
            return None
        if self.airborne and not force:
            return "Disarming refused: not landed"
        reason = self.vehicle.disarm(force)
        if reason is not None:
            return f"Disarming refused: {reason}"
        self._after_disarm("Disarmed by force" if force else "Disarmed")
        return None

    def reboot(self) -> str | None:
        """Restart the firmware, also a locked one; parameters, home and boot clock stay."""
        if self.vehicle.armed:
            return "Reboot refused: armed"
        reason = self.vehicle.reboot()
        if reason is not None:
            return f"Reboot refused: {reason}"
        self._enter(FlightMode.HOLD)
        self.say(dialect.MAV_SEVERITY_INFO, "Firmware restarted")
        return None

    def take_off(self, height_m: float | None, _now_s: float) -> str | None:
        """Climb and hold there; when disarmed, as soon as it is armed. It never descends for that.

        ``height_m`` is local, 0.1 to 20 m above home; None: MIS_TAKEOFF_ALT above where it stands.
        """
        if not self.positioned:
            return "Take-off refused: no position estimate"
        z, home_m = self.vehicle.estimate().position_enu_m[2], self.home_enu_m[2]
        taking_off = self.mode is FlightMode.TAKEOFF
        if height_m is None:
            if taking_off:
                return None
            height_m = (z if self.standing else home_m) + self._parameters["MIS_TAKEOFF_ALT"]
        low, high = HEIGHT_RANGE_M
        if not low <= height_m - home_m <= high:
            return f"Take-off refused: {height_m - home_m:.4g} m above home, {low:g} to {high:g}"
        if taking_off and height_m == self.pilot.takeoff_height_m:
            return None
        if not self.standing and height_m < z:
            self.say(dialect.MAV_SEVERITY_NOTICE, "Already higher than the take-off height")
            height_m = z
        self.pilot.takeoff_height_m = height_m
        self._enter(FlightMode.TAKEOFF)
        return None

    def land(self, _now_s: float) -> None:
        """Land where it is. On the ground there is nothing to do."""
        if self.vehicle.armed:
            self._enter(FlightMode.LAND)

    def set_mode(self, mode: FlightMode, now_s: float) -> str | None:
        """Change the mode."""
        if mode is FlightMode.TAKEOFF:
            return self.take_off(None, now_s)
        if mode is FlightMode.LAND:
            self.land(now_s)
            return None
        if not self.vehicle.estimate().valid:
            return f"Mode {mode.value} refused: no position estimate"
        if mode is FlightMode.OFFBOARD and not self._stream_alive(now_s):
            return "Mode offboard refused: no set-points"
        self._enter(mode, restart=mode is FlightMode.HOLD and self.pilot.goal is not None)
        return None

    def reposition(self, goal: Goal) -> str | None:
        """Fly to a point near home and hold there."""
        if not self.vehicle.estimate().valid:
            return "Reposition refused: no position estimate"
        if not self.airborne:
            return "Reposition refused: not in the air"
        x, y, z = (a - b for a, b in zip(goal.point_enu_m, self.home_enu_m, strict=True))
        low, high = HEIGHT_RANGE_M
        if not low <= z <= high:
            return f"Reposition refused: {z:.4g} m above home, {low:g} to {high:g}"
        if math.hypot(x, y) > _REACH_M:
            return f"Reposition refused: {math.hypot(x, y):.4g} m from home, at most {_REACH_M:g}"
        if self.mode is not FlightMode.HOLD or goal != self.pilot.goal:
            self._enter(FlightMode.HOLD, restart=True, goal=goal)
        return None

    def take_setpoint(self, setpoint: Setpoint, sender: Sender, now_s: float) -> str | None:
        """Take a valid set-point; it is flown in OFFBOARD only, but keeps the stream alive in all modes."""
        reason = self._owner.admit(sender, now_s, self._parameters["COM_OF_LOSS_T"])
        if reason is None:
            self.pilot.take(setpoint)
            self._setpoint_s = now_s
        return reason

    def flown(self, now_s: float, setpoint: Setpoint | None, sender: Sender) -> None:
        """Take note of ticks until now past ``control``; of the last one's set-point if they had one each."""
        self._control_s = self._estimate_seen_s = now_s
        if setpoint is not None:
            self._owner.admit(sender, now_s, self._parameters["COM_OF_LOSS_T"])
            self._setpoint_s = now_s
            self.pilot.handed_on(setpoint)

    @property
    def stream_ends_s(self) -> float:
        """When the stream of set-points counts as ended, if none comes."""
        return self._setpoint_s + self._parameters["COM_OF_LOSS_T"]

    def yaw_rad(self) -> float:
        """Present heading by the estimate."""
        return yaw_from_quaternion(self.vehicle.estimate().quaternion)

    def say(self, severity: int, text: str) -> None:
        """Add the text of an event."""
        self.texts.say(severity, text)

    def control(self, now_s: float) -> None:
        """Fly: call it at every tick, after the messages and before the physics."""
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
            self._after_disarm("Disarmed by the firmware", dialect.MAV_SEVERITY_CRITICAL)
        self._failsafes(now_s)
        if self.watches.step(now_s) and armed and not standing:
            mode = STATION_LOST[int(self._parameters["NAV_DLL_ACT"])]
            if mode is not None:
                self._fall_back(mode, f"No ground station for {self._parameters['COM_DL_LOSS_T']:g} s")
        if armed and standing:
            self._disarm_idle(now_s)
            armed = vehicle.armed
        if armed:
            event = self.pilot.fly(self.mode, estimate, standing, dt_s)
            if event is not None:
                self._follow(event, now_s)

    def _follow(self, event: Event, now_s: float) -> None:
        if event is Event.ARRIVED:
            self._enter(FlightMode.HOLD)
            self.pilot.go_on()
        elif event is Event.LANDED:
            self._try_disarm("Landed, disarmed")
        else:
            self.texts.refuse("Set-point clipped to MPC_XY_VEL_MAX or MPC_Z_VEL_MAX", now_s)

    def _enter(
        self, mode: FlightMode, *, failsafe: bool = False, restart: bool = False, goal: Goal | None = None
    ) -> None:
        self.failsafe = failsafe
        if mode is self.mode and not restart:
            return
        if mode is not self.mode:
            self.say(dialect.MAV_SEVERITY_INFO, f"Mode {mode.value}")
        self.mode = mode
        self.pilot.begin(goal)

    def _after_disarm(self, text: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        self.say(severity, text)
        self.pilot.stop()
        self._owner.release()
        self._was_armed = self._flew = False
        if self.mode is not FlightMode.OFFBOARD:  # that one ends with its stream, as the companion expects
            self._enter(FlightMode.HOLD)
        self.failsafe = False

    def _stream_alive(self, now_s: float) -> bool:
        return now_s - self._setpoint_s <= self._parameters["COM_OF_LOSS_T"] + 1e-9

    def _failsafes(self, now_s: float) -> None:
        if self.mode is FlightMode.OFFBOARD and not self._stream_alive(now_s):
            if self.vehicle.armed:
                limit_s = self._parameters["COM_OF_LOSS_T"]
                mode = STREAM_LOST[int(self._parameters["COM_OBL_RC_ACT"])]
                self._fall_back(mode, f"No set-points for {limit_s:.3g} s")
            else:
                self._enter(FlightMode.HOLD)
        lost = now_s - self._estimate_seen_s > _ESTIMATE_LOST_S
        if lost and self.airborne and self.mode is not FlightMode.LAND:
            self._fall_back(FlightMode.LAND, "No position estimate")

    def _fall_back(self, mode: FlightMode, text: str) -> None:
        """Hold or land because of a failure; on the ground, or without a position, land."""
        if self.standing or not self.positioned:
            mode = FlightMode.LAND  # which disarms what stands, and needs no position
        if self.mode is FlightMode.LAND:
            self.say(dialect.MAV_SEVERITY_CRITICAL, text)
            return
        doing = "landing" if mode is FlightMode.LAND else "holding"
        self.say(dialect.MAV_SEVERITY_CRITICAL, f"{text}: {doing}")
        self._enter(mode, failsafe=True, restart=True)

    def _disarm_idle(self, now_s: float) -> None:
        if not self._flew:
            if now_s - self._armed_s >= self._parameters["COM_DISARM_PRFLT"]:
                self._try_disarm("Disarmed: no take-off")
        elif now_s - self.ground.since_s >= self._parameters["COM_DISARM_LAND"]:
            self._try_disarm("Disarmed: landed")

    def _try_disarm(self, text: str) -> None:
        self.vehicle.stop_setpoint()
        if self.vehicle.disarm(False) is None:
            self._after_disarm(text)
