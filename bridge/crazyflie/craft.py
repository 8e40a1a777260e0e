"""Events from a Crazyflie, losses of its link, and the end of a flight: the part without clients."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.crazyflie import rules as limits
from bridge.crazyflie.arming import Arming
from bridge.crazyflie.checks import stuck
from bridge.crazyflie.known import Known
from bridge.crazyflie.pilot import DESCENT_M_S, Pilot
from bridge.crazyflie.settings import Settings
from bridge.crazyflie.types import (
    ArmReply,
    Connected,
    CrazyflieState,
    Info,
    Link,
    Lost,
    Order,
    Packet,
    ParamValue,
)
from bridge.mavlink.server.commander import Commander
from bridge.mavlink.server.profile import FlightMode
from bridge.mocap.checks import Passed

INFO, WARNING = dialect.MAV_SEVERITY_INFO, dialect.MAV_SEVERITY_WARNING
CRITICAL = dialect.MAV_SEVERITY_CRITICAL


class Craft(Known, Commander):
    """Call the methods as events come. Home is the origin, at the height where it stands or was armed."""

    height_range_m = limits.HEIGHT_RANGE_M
    stream_lost_s = limits.STREAM_S

    def __init__(self, rules: limits.Rules) -> None:
        Commander.__init__(self)
        Known.__init__(self, mocap=rules.mocap)
        self.rules = rules
        self.takeoff_z_m = limits.TAKEOFF_M
        self._arming = Arming()
        self.settings = Settings(rules.drag_1_s, restore=rules.restore)
        self._packets: list[Packet] = []
        self._pilot = Pilot()
        self._moved = False  # a velocity has gone out since arming
        self._kill_s = -math.inf
        self._silence_said = False
        self._connected_s = 0.0
        self._armed_state: CrazyflieState | None = None  # the newest that shows it armed
        # newest state with a known position, and the longest landing without one, s
        self._placed_s, self._sink_s = -math.inf, 0.0

    @property
    def armed(self) -> bool:
        """Armed through this bridge."""
        return self._arming.armed

    @property
    def arming(self) -> bool:
        """Whether an arming request has no answer yet."""
        return self._arming.arming

    @property
    def busy(self) -> bool:
        """Armed, or waiting for the supervisor: the link must not be closed yet."""
        return self.armed or self._arming.busy

    @property
    def standing(self) -> bool:
        """Not in the air, as far as the commands show: there is no sensor for it."""
        return not (self.armed and self._moved)

    def take_packets(self) -> list[Packet]:
        """Take the packets for the Crazyflie, in order."""
        packets, self._packets = self._packets, []
        return packets

    # What comes from the Crazyflie

    def connected(self, event: Connected, now_s: float) -> None:
        """The link is open."""
        self.link = Link(event.protocol, dict(event.params), "")
        self.state = self.health = None
        self._forget_outside()
        self._connected_s = now_s
        self._arming.forget(armed=self.armed)
        if now_s - self._kill_s <= limits.KILL_KEPT_S:
            self.emergency_stop(now_s)
        self._kill_s = -math.inf
        self.texts.say(INFO, f"Crazyflie connected, CRTP {event.protocol}")
        packets, warning = self.settings.connected(event.params)
        self._packets += packets  # their echoes arrive as ``ParamValue``
        if warning is not None:
            self.texts.say(WARNING, warning)

    def param(self, event: ParamValue, now_s: float) -> None:
        """A parameter's value, after a write."""
        if event.value is None:
            self.texts.refuse(f"The firmware has no parameter {event.name}", now_s)
            return
        self.link.params[event.name] = event.value
        self.settings.echoed(event.name)
        self.texts.say(INFO, f"{event.name} is {event.value}")

    def lost(self, event: Lost, now_s: float) -> None:
        """The link is lost; in the bridge's own modes the vehicle lands blindly meanwhile."""
        if self.link.protocol is not None:
            self.texts.say(CRITICAL, f"Radio lost: {event.reason}")
        else:
            self.texts.refuse(event.reason, now_s, "connecting")
        self.link = Link(reason=event.reason)
        if self.standing or self.mode is FlightMode.OFFBOARD:
            self._end("radio lost")
        elif self.mode is not FlightMode.LAND:
            self._fall_back("Radio lost", now_s)
        self._arming.forget(armed=self.armed)

    def take_state(self, state: CrazyflieState, now_s: float, *, restarted: bool = False) -> None:
        """A new state; ``restarted``: the firmware has restarted since the last one."""
        before, self.state = self.state, state
        if not self.armed:  # a take-off that waits for the arming climbs from the place of the arming
            height_m = state.position_enu_m[2]
            self.takeoff_z_m += height_m - self.home_enu_m[2]
            self.home_enu_m = (0.0, 0.0, height_m)
        if self._silence_said:
            self.texts.say(INFO, "Radio is back")
            self._silence_said = False
        if self.position_known(now_s):
            self._placed_s = state.at_s
            height_m = state.position_enu_m[2] - min(0.0, self.home_enu_m[2])  # floor below a table
            self._sink_s = limits.BLIND_SPARE_S + limits.BLIND_SHARE * max(0.0, height_m) / DESCENT_M_S
        if restarted:
            self._stop("it restarted", now_s)
            if before is not None:  # its settings are the defaults again
                self._packets += [Order.STOP, Order.RECONNECT]
                self.lost(Lost("it restarted"), now_s)
                return
        self._note_fitness(state)
        reason = stuck(state.info)
        if reason is not None and (before is None or stuck(before.info) != reason):
            self.texts.say(CRITICAL, reason)
        stays = self._stays_armed(state)
        if self.armed and (reason is not None or not stays):
            self._stop("by the firmware", now_s)

    def _stays_armed(self, state: CrazyflieState) -> bool:
        """Whether it is armed, or arms itself again: such firmware is disarmed for 0.12 s every 30 s."""
        if state.info & Info.ARMED:
            self._armed_state = state
            return True
        last = self._armed_state
        on_ground = last is not None and not last.info & Info.FLYING
        rearms = on_ground and bool(state.info & Info.AUTO_ARM)
        return rearms and last is not None and state.at_s - last.at_s <= limits.REARM_S

    def emergency_stop(self, now_s: float) -> None:
        """Stop the motors; latched until a restart."""
        if self.link.protocol is None:
            self._kill_s = now_s
            self.texts.say(CRITICAL, "Emergency stop waits for the radio")
        self._packets += self._arming.emergency(now_s)
        self._end("emergency stop, restart needed")

    def arm_reply(self, reply: ArmReply, now_s: float) -> None:
        """The supervisor's answer."""
        reason = self._arming.reply(reply)
        if reason is not None:
            self.texts.refuse(f"Arming refused: {reason}", now_s)

    def mocap(self, problem: str | None, passed: Passed | None = None, now_s: float = -math.inf) -> None:
        """Take the state of the poses from outside: the problem, None if they are good, and a new pose."""
        self._note_pose(problem, passed, now_s)
        if self.armed and problem is not None and self.mocap_problem is None:
            self.texts.say(CRITICAL, problem)
        self.mocap_problem = problem

    def _watch_radio(self, now_s: float) -> None:
        if self.link.protocol is None:
            return
        heard_s = self.state.at_s if self.state is not None else self._connected_s
        silence_s = now_s - heard_s
        if silence_s > limits.SILENT_S and not self._silence_said:
            self._silence_said = True
            self.texts.say(CRITICAL, f"Radio silent for {limits.SILENT_S:g} s")
        silent = silence_s > limits.LOST_S and self.mode in (FlightMode.HOLD, FlightMode.TAKEOFF)
        if silent and self.armed and not self.standing:
            self._fall_back("Radio silent", now_s)
        if silence_s > limits.RECONNECT_S:
            self.lost(Lost(f"nothing heard for {limits.RECONNECT_S:g} s"), now_s)
            self._packets += [Order.RECONNECT] if self.armed else [Order.STOP, Order.RECONNECT]

    def _has_sunk(self, now_s: float) -> bool:
        """Whether a landing without a position has taken longer than from the last known height."""
        return now_s - max(self._placed_s, self._pilot.since_s) > self._sink_s

    # Changes

    def _enter(
        self, mode: FlightMode, now_s: float, *, failsafe: bool = False, restart: bool = False
    ) -> None:
        """Change the mode; any but a landing begins anew at the present place."""
        super()._enter(mode, now_s, failsafe=failsafe, restart=restart or mode is not FlightMode.LAND)

    def _begin(self, now_s: float) -> None:
        self._pilot.begin(now_s)

    def _height_m(self) -> float:
        return self.state.position_enu_m[2] if self.state is not None else -math.inf

    def _default_takeoff_z_m(self) -> float:
        return self.home_enu_m[2] + limits.TAKEOFF_M

    def _fall_back(self, reason: str, now_s: float) -> None:
        if self.standing:
            self.texts.say(WARNING, f"{reason}: stays on the ground")
            self._enter(FlightMode.HOLD, now_s)
            return
        self.texts.say(CRITICAL, f"{reason}: landing")
        self._enter(FlightMode.LAND, now_s, failsafe=True)

    def _motors_off(self, now_s: float, text: str, *, forced: bool) -> None:
        self._packets += self._arming.off(now_s, forced=forced)
        self.texts.say(WARNING if forced else INFO, text)
        self._ended()

    def _stop(self, reason: str, now_s: float) -> None:
        """End a flight that the firmware has ended, so that its last set-point is not flown again."""
        if self.armed:
            self._end(reason)
            self._packets += self._arming.off(now_s, forced=False)

    def _end(self, reason: str) -> None:
        """Take note that it is no longer armed."""
        if self.armed:
            self.texts.say(CRITICAL, f"Disarmed: {reason}")
        self._arming.armed = False
        self._ended()

    def _ended(self) -> None:
        self._moved = self.failsafe = False
        self.owner.release()
        self.mode = FlightMode.HOLD  # in OFFBOARD control would not be free for the next client
