"""What the autopilot does with its vehicle: arming, modes, its own flying, and fail-safes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import yaw_from_quaternion
from flightstack.types import ZERO, Vec3
from sim.autopilot_control import OwnLimits, PositionHold
from sim.autopilot_modes import AIRBORNE_STATE, EstimateLike, FlightMode, VehicleLike
from sim.autopilot_parameters import Parameters
from sim.autopilot_setpoints import ControlOwner, Sender, Setpoint

_CONTACT_S = 0.3  # s of unbroken contact until the vehicle counts as standing; bounces are shorter
_NO_CONTACT_S = 0.1  # s without contact until it counts as flying again
_ESTIMATE_LOST_S = 0.5  # s without a valid estimate until it lands by itself
_ARRIVED_M = 0.05  # m, half the Crazyflie's size: take-off height reached
_ARRIVED_M_S = 0.15  # m/s
_TAKEOFF_RANGE_M = (0.1, 20.0)  # m; the room is lower


class Text(NamedTuple):
    """Something a person should know."""

    severity: int  # MAV_SEVERITY
    text: str


class Flight:
    """Modes, arming and fail-safes. Methods that can refuse return the reason, or None when done.

    Attributes:
        mode: flight mode; meaningful also while disarmed.
        failsafe: the present mode was not asked for but forced by a failure.
        standing: on the ground or on the pad, not just touching.
        texts: what happened since somebody cleared the list.
    """

    def __init__(
        self, vehicle: VehicleLike, parameters: Parameters, period_s: float, trim_enu_m_s: Vec3 = ZERO
    ) -> None:
        self.vehicle = vehicle
        self.mode = FlightMode.HOLD
        self.failsafe = False
        self.standing = vehicle.landed or vehicle.on_pad or vehicle.on_ground
        self.texts: list[Text] = []
        self.velocity_setpoint_enu_m_s: Vec3 | None = None  # handed to the firmware last
        self._parameters = parameters
        self._hold = PositionHold(trim_enu_m_s)
        self._owner = ControlOwner()
        self._setpoint: Setpoint | None = None
        self._setpoint_s = -math.inf
        self._fresh = False  # the set-point has not been handed on yet
        self._engaged = False  # the position loop has taken over in this mode
        self._takeoff_height_m = parameters["MIS_TAKEOFF_ALT"]
        self._yaw_rad = 0.0  # heading to hold
        self._was_armed = vehicle.armed
        self._flew = vehicle.armed and not self.standing  # since arming
        self._control_s: float | None = None
        self._period_s = period_s
        self._contact_changed_s = 0.0
        self._contact = self.standing
        self._armed_s = 0.0
        self._standing_since_s = 0.0
        self._estimate_seen_s = 0.0
        self._fly: dict[FlightMode, Callable[[EstimateLike, float], None]] = {
            FlightMode.HOLD: self._fly_hold,
            FlightMode.TAKEOFF: self._fly_takeoff,
            FlightMode.LAND: self._fly_land,
            FlightMode.OFFBOARD: self._fly_offboard,
        }

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        return dialect.MAV_LANDED_STATE_ON_GROUND if self.standing else AIRBORNE_STATE[self.mode]

    @property
    def airborne(self) -> bool:
        """Armed and off the ground."""
        return self.vehicle.armed and not self.standing

    def problems(self) -> list[str]:
        """Reasons why the vehicle would not arm now; empty when ready."""
        found = []
        if self.vehicle.locked:
            found.append("firmware is locked, restart it")
        if not self.vehicle.estimate().valid:
            found.append("no position estimate")
        return found

    def arm(self, now_s: float) -> str | None:
        """Arm; nothing moves before a mode says so."""
        if self.vehicle.armed:
            return None
        problems = self.problems()
        if self.mode is FlightMode.LAND:
            problems.append("mode is land")
        reason = problems[0] if problems else self.vehicle.arm()
        if reason is not None:
            return f"Arming refused: {reason}"
        self._armed_s, self._flew, self._was_armed, self._engaged = now_s, False, True, False
        self.say(dialect.MAV_SEVERITY_INFO, "Armed")
        return None

    def disarm(self, *, force: bool) -> str | None:
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

    def take_off(self, height_m: float | None) -> str | None:
        """Climb to a height above home and hold there; when disarmed, as soon as it is armed.

        Args:
            height_m: 0.1 to 20 m; None: MIS_TAKEOFF_ALT.
        """
        height_m = self._parameters["MIS_TAKEOFF_ALT"] if height_m is None else height_m
        low, high = _TAKEOFF_RANGE_M
        if not low <= height_m <= high:
            return f"Take-off refused: {height_m:.4g} m, {low:g} to {high:g}"
        if not self.vehicle.estimate().valid:
            return "Take-off refused: no position estimate"
        if self.mode is FlightMode.TAKEOFF and height_m == self._takeoff_height_m:
            return None
        self._takeoff_height_m = height_m
        self._enter(FlightMode.TAKEOFF)
        return None

    def land(self) -> None:
        """Land where it is; nothing can refuse that. On the ground there is nothing to do."""
        if self.vehicle.armed:
            self._enter(FlightMode.LAND)

    def set_mode(self, mode: FlightMode, now_s: float) -> str | None:
        """Change the mode."""
        if mode is FlightMode.TAKEOFF:
            return self.take_off(None)
        if mode is FlightMode.LAND:
            self.land()
            return None
        if not self.vehicle.estimate().valid:
            return f"Mode {mode.value} refused: no position estimate"
        if mode is FlightMode.OFFBOARD and not self._stream_alive(now_s):
            return "Mode offboard refused: no set-points"
        self._enter(mode)
        return None

    def take_setpoint(self, setpoint: Setpoint, sender: Sender, now_s: float) -> str | None:
        """Take a valid set-point; it is flown in OFFBOARD only, but keeps the stream alive in all modes."""
        reason = self._owner.admit(sender, now_s, self._parameters["COM_OF_LOSS_T"])
        if reason is None:
            self._setpoint, self._setpoint_s, self._fresh = setpoint, now_s, True
        return reason

    def yaw_rad(self) -> float:
        """Present heading by the estimate."""
        return yaw_from_quaternion(self.vehicle.estimate().quaternion)

    def say(self, severity: int, text: str) -> None:
        """Tell whoever listens."""
        self.texts.append(Text(severity, text))

    def control(self, now_s: float) -> None:
        """Fly: call it at every tick, after the messages and before the physics."""
        dt_s = now_s - self._control_s if self._control_s is not None else self._period_s
        self._control_s = now_s
        estimate = self.vehicle.estimate()
        if estimate.valid:
            self._estimate_seen_s = now_s
        self._watch_contact(now_s)
        if self._was_armed and not self.vehicle.armed:
            self._after_disarm("Disarmed by the firmware", dialect.MAV_SEVERITY_CRITICAL)
        self._failsafes(now_s)
        if self.vehicle.armed:
            self._disarm_idle(now_s)
        if self.vehicle.armed:
            self._fly[self.mode](estimate, dt_s)

    def _enter(self, mode: FlightMode, *, failsafe: bool = False) -> None:
        self.failsafe = failsafe
        if mode is self.mode:
            return
        self.mode = mode
        self._engaged = False
        self._fresh = True
        self.say(dialect.MAV_SEVERITY_INFO, f"Mode {mode.value}")

    def _after_disarm(self, text: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        self.say(severity, text)
        self.vehicle.stop_setpoint()
        self._owner.release()
        self._was_armed = self._flew = False
        self.velocity_setpoint_enu_m_s = None
        if self.mode is not FlightMode.OFFBOARD:  # that one ends with its stream, as the companion expects
            self._enter(FlightMode.HOLD)
        self.failsafe = False

    def _watch_contact(self, now_s: float) -> None:
        vehicle = self.vehicle
        contact = vehicle.on_pad or vehicle.on_ground or vehicle.landed
        if contact != self._contact:
            self._contact, self._contact_changed_s = contact, now_s
        if contact == self.standing:
            return
        lasted_s = now_s - self._contact_changed_s
        if not vehicle.armed or lasted_s >= (_CONTACT_S if contact else _NO_CONTACT_S) - 1e-9:
            self.standing = contact or not vehicle.armed
            self._standing_since_s = now_s
            self._flew = self._flew or not self.standing

    def _stream_alive(self, now_s: float) -> bool:
        return now_s - self._setpoint_s <= self._parameters["COM_OF_LOSS_T"] + 1e-9

    def _failsafes(self, now_s: float) -> None:
        if self.mode is FlightMode.OFFBOARD and not self._stream_alive(now_s):
            if self.vehicle.armed:
                limit_s = self._parameters["COM_OF_LOSS_T"]
                self.say(dialect.MAV_SEVERITY_CRITICAL, f"No set-points for {limit_s:.3g} s: landing")
                self._enter(FlightMode.LAND, failsafe=True)
            else:
                self._enter(FlightMode.HOLD)
        lost = now_s - self._estimate_seen_s > _ESTIMATE_LOST_S
        if lost and self.airborne and self.mode is not FlightMode.LAND:
            self.say(dialect.MAV_SEVERITY_CRITICAL, "No position estimate: landing")
            self._enter(FlightMode.LAND, failsafe=True)

    def _disarm_idle(self, now_s: float) -> None:
        if not self.standing:
            return
        if not self._flew:
            if now_s - self._armed_s >= self._parameters["COM_DISARM_PRFLT"]:
                self._try_disarm("Disarmed: no take-off")
        elif now_s - self._standing_since_s >= self._parameters["COM_DISARM_LAND"]:
            self._try_disarm("Disarmed: landed")

    def _try_disarm(self, text: str) -> None:
        self.vehicle.stop_setpoint()
        if self.vehicle.disarm(False) is None:
            self._after_disarm(text)

    def _limits(self) -> OwnLimits:
        p = self._parameters
        return OwnLimits(
            p["MPC_XY_P"], p["MPC_Z_P"], p["MPC_XY_CRUISE"], p["MPC_TKO_SPEED"], p["MPC_LAND_SPEED"]
        )

    def _engage(self, estimate: EstimateLike) -> None:
        if not self._engaged:
            self._hold.engage(
                estimate.position_enu_m, estimate.velocity_enu_m_s, self._parameters["MPC_XY_P"]
            )
            self._yaw_rad = yaw_from_quaternion(estimate.quaternion)
            self._engaged = True

    def _command(self, velocity_enu_m_s: Vec3) -> None:
        self.velocity_setpoint_enu_m_s = velocity_enu_m_s
        self.vehicle.set_velocity(velocity_enu_m_s, self._yaw_rad)

    def _fly_hold(self, estimate: EstimateLike, dt_s: float) -> None:
        if self.standing:
            # Sent again and again: for the firmware silence after a flight is a lost link, which locks it.
            self.vehicle.stop_setpoint()
            self.velocity_setpoint_enu_m_s = None
            self._engaged = False
            return
        self._engage(estimate)
        if estimate.valid:
            self._command(self._hold.step(estimate.position_enu_m, self._limits(), dt_s))
        else:
            self._command(self._hold.sink(0.0, dt_s))

    def _fly_takeoff(self, estimate: EstimateLike, dt_s: float) -> None:
        self._engage(estimate)
        z = estimate.position_enu_m[2]
        goal = self._takeoff_height_m
        self._hold.aim(goal)
        if not estimate.valid:
            self._command(self._hold.sink(0.0, dt_s))
            return
        step = self._hold.step(estimate.position_enu_m, self._limits(), dt_s, learn=not self.standing)
        self._command(step)
        if abs(goal - z) < _ARRIVED_M and abs(estimate.velocity_enu_m_s[2]) < _ARRIVED_M_S:
            self._enter(FlightMode.HOLD)
            self._engaged = True  # goes on from here, with what it has learnt

    def _fly_land(self, estimate: EstimateLike, dt_s: float) -> None:
        if self.standing:
            self._try_disarm("Landed, disarmed")
            return
        self._engage(estimate)
        down_m_s = -self._parameters["MPC_LAND_SPEED"]
        if estimate.valid:
            position = estimate.position_enu_m
            self._command(self._hold.step(position, self._limits(), dt_s, vertical_m_s=down_m_s))
        else:
            self._command(self._hold.sink(down_m_s, dt_s))

    def _fly_offboard(self, estimate: EstimateLike, dt_s: float) -> None:
        setpoint = self._setpoint
        if setpoint is None:  # the stream's check comes first
            return
        if not self._engaged:
            self._yaw_rad, self._engaged = yaw_from_quaternion(estimate.quaternion), True
        if setpoint.yaw_rad is not None:
            self._yaw_rad = setpoint.yaw_rad
        self._yaw_rad += setpoint.yaw_rate_rad_s * dt_s
        # Only news is handed on, so that the firmware's own watchdog sees a broken stream too.
        if self._fresh or setpoint.yaw_rate_rad_s:
            self._fresh = False
            self._command(setpoint.velocity_enu_m_s)
