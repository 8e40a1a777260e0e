"""A Crazyflie as a vehicle with flight modes; pure: events and commands in, packets and texts out.

A client's velocity is immediately sent to the radio and never repeated: when the client stops, the firmware's
watchdog levels the vehicle after 0.5 s and stops the motors after 2 s (firmware supervisor.c). The bridge
makes set-points only in its own modes (take-off, hold, landing) and, except for a landing, only while clients
send heartbeats.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.crazyflie import rules as limits
from bridge.crazyflie.condition import FIT, STUCK, Condition, stuck
from bridge.crazyflie.packets import (
    ArmReply,
    Connected,
    CrazyflieState,
    Info,
    Lost,
    Order,
    Packet,
    ParamValue,
    Velocity,
)
from bridge.crazyflie.pilot import DESCENT_M_S, REFUSED, UNPLACED_M_S, Arming, Pilot, Stopped, yaw_rate
from bridge.crazyflie.rules import Settings
from bridge.mavlink.profiles import CRAZYFLIE
from bridge.mavlink.server.commander import Commander, Setpoint
from bridge.mavlink.server.profile import FlightMode
from bridge.mocap.checks import Passed
from flightstack.core.types import Vec3

INFO, WARNING = dialect.MAV_SEVERITY_INFO, dialect.MAV_SEVERITY_WARNING
CRITICAL = dialect.MAV_SEVERITY_CRITICAL
_ENDS = "the bridge ends"


class Vehicle(Condition, Commander):
    """Modes and commands of a Crazyflie: handle events on arrival, then ``step``, then send the packets.

    Home is the horizontal origin, at the height where the vehicle stands or was armed.
    """

    mark = CRAZYFLIE.mark
    height_range_m = limits.HEIGHT_RANGE_M
    stream_lost_s = limits.STREAM_S

    def __init__(self, options: limits.CrazyflieOptions, drag_1_s: Vec3 | None) -> None:
        """``drag_1_s``: rotor drag for the firmware's filter, 1/s, body axes; None: unchanged."""
        Commander.__init__(self)
        Condition.__init__(self, mocap=options.mocap_key is not None)
        self.options = options
        self.takeoff_z_m = limits.TAKEOFF_M
        self._arming = Arming()
        self.settings = Settings(drag_1_s, restore=options.restore)
        self._packets: list[Packet] = []
        self._pilot = Pilot()
        self._moved = False  # whether a velocity was sent since arming
        self._kill_s = -math.inf
        self._silence_said = False
        self._connected_s = 0.0
        self._armed_state: CrazyflieState | None = None  # newest state in which the vehicle is armed
        # time of the newest state with a good position, s; maximum duration of a blind landing from there, s
        self._placed_s, self._sink_s = -math.inf, 0.0
        self._stopped = Stopped()
        self._client_s = self._own_s = -math.inf
        self._stream_end_said = self._ends = False
        self._idle_since_s = 0.0

    @property
    def armed(self) -> bool:
        return self._arming.armed

    @property
    def arming(self) -> bool:
        """Whether an arming request has no answer yet."""
        return self._arming.arming

    @property
    def busy(self) -> bool:
        """Whether the vehicle is armed or a request to the supervisor is open: the link must stay open."""
        return self.armed or self._arming.busy

    @property
    def standing(self) -> bool:
        """Whether the vehicle is on the ground, as far as the commands show; no sensor measures this."""
        return not (self.armed and self._moved)

    def take_packets(self) -> list[Packet]:
        packets, self._packets = self._packets, []
        return packets

    # Events of the Crazyflie's link

    def connected(self, event: Connected, now_s: float) -> None:
        self.link = event
        self.state = self.health = None
        self._leaning = None
        self._connected_s = now_s
        self._arming.forget(armed=self.armed)
        if now_s - self._kill_s <= limits.KILL_KEPT_S:
            self.terminate(now_s)
        self._kill_s = -math.inf
        self.texts.say(INFO, f"Crazyflie connected, CRTP {event.protocol}")
        packets, warning = self.settings.connected(event.params)
        self._packets += packets  # the firmware confirms each write by a ``ParamValue``
        if warning is not None:
            self.texts.say(WARNING, warning)

    def param(self, event: ParamValue, now_s: float) -> None:
        if event.value is None:
            self.texts.refuse(f"The firmware has no parameter {event.name}", now_s)
            return
        if isinstance(self.link, Connected):
            self.link.params[event.name] = event.value
        self.settings.open.discard(event.name)
        self.texts.say(INFO, f"{event.name} is {event.value}")

    def lost(self, event: Lost, now_s: float) -> None:
        """Handle the loss of the link: in the bridge's own modes the vehicle lands blindly, OFFBOARD ends."""
        if self.link.protocol is not None:
            self.texts.say(CRITICAL, f"Radio lost: {event.reason}")
        elif event.reason != self.link.reason:  # an unchanged reason is not repeated
            self.texts.say(WARNING, event.reason)
        self.link = event
        if self.standing or self.mode is FlightMode.OFFBOARD:
            self._end("radio lost")
        elif self.mode is not FlightMode.LAND:
            self._fall_back("Radio lost", now_s)
        self._arming.forget(armed=self.armed)

    def take_state(self, state: CrazyflieState, now_s: float, *, restarted: bool = False) -> None:
        """Handle a new state; ``restarted``: the firmware has restarted since the last state."""
        before, self.state = self.state, state
        if not self.armed:  # before arming, home and the take-off height follow the vehicle
            height_m = state.position_enu_m[2]
            self.takeoff_z_m += height_m - self.home_enu_m[2]
            self.home_enu_m = (0.0, 0.0, height_m)
        if self._silence_said:
            self.texts.say(INFO, "Radio is back")
            self._silence_said = False
        if self.position_known(now_s):
            self._placed_s = state.at_s
            # height above z = 0, or above home if home is lower
            height_m = state.position_enu_m[2] - min(0.0, self.home_enu_m[2])
            self._sink_s = limits.BLIND_SPARE_S + limits.BLIND_SHARE * max(0.0, height_m) / DESCENT_M_S
        if restarted:
            self._stop("it restarted", now_s)
            if before is not None:  # a new connection writes the parameters, which the restart has reset
                self._packets += [Order.STOP, Order.RECONNECT]
                self.lost(Lost("it restarted"), now_s)
                return
        if state.info & FIT:
            self.fit_s = state.at_s
        reason = stuck(state.info)
        if reason is not None and (before is None or stuck(before.info) != reason):
            self.texts.say(CRITICAL, reason)
        if state.info & Info.ARMED:
            self._armed_state = state
        last = self._armed_state
        on_ground = last is not None and not last.info & Info.FLYING and state.info & Info.AUTO_ARM
        # firmware that arms itself is disarmed for 0.12 s every 30 s
        rearms = on_ground and last is not None and state.at_s - last.at_s <= limits.REARM_S
        if self.armed and (reason is not None or not (state.info & Info.ARMED or rearms)):
            self._stop("by the firmware", now_s)

    def terminate(self, now_s: float) -> str | None:
        """Stop the motors, even if disarmed; the stop is latched until a restart."""
        if self.link.protocol is None:
            self._kill_s = now_s
            self.texts.say(CRITICAL, "Emergency stop waits for the radio")
        self._packets += self._arming.emergency(now_s)
        self._end("emergency stop, restart needed")
        return None

    def arm_reply(self, reply: ArmReply, now_s: float) -> None:
        if self._arming.refused_by(reply):
            self.texts.refuse(f"Arming refused: {REFUSED}", now_s)

    def mocap(self, problem: str | None, passed: Passed | None = None) -> None:
        """Handle a new external pose; ``problem``: reason why external poses are not good, or None."""
        if passed is not None:
            self.posed_s = max(self.posed_s, passed.measured_s)
            self._pose_quaternion = passed.pose.orientation_wxyz
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
            self.lost(Lost(f"no packet for {limits.RECONNECT_S:g} s"), now_s)
            self._packets += [Order.RECONNECT] if self.armed else [Order.STOP, Order.RECONNECT]

    # Changes of the mode and of the armed state

    def _enter(
        self, mode: FlightMode, now_s: float, *, failsafe: bool = False, restart: bool = False
    ) -> None:
        """Change the mode; a mode that is already active restarts at the present position, except LAND."""
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
        if self.armed:
            self.texts.say(CRITICAL, f"Disarmed: {reason}")
        self._arming.armed = False
        self._ended()

    def _ended(self) -> None:
        self._moved = self.failsafe = False
        self._owner = None
        self.mode = FlightMode.HOLD  # OFFBOARD would leave the present client in control

    # Commands of clients; each returns the reason of a refusal, or None

    def client(self, now_s: float) -> None:
        self._client_s = now_s

    def arm(self, now_s: float) -> str | None:
        if self.armed or self.arming:
            return None
        if self.state is not None and self.state.info & STUCK == Info.CRASHED and not self._ends:
            self._packets.append(Order.RECOVER)
            return "Arming refused: crash recovery begun: look for damage, then arm again"
        found = self.problems(now_s)
        if self._ends or found or self.state is None:
            return f"Arming refused: {_ENDS if self._ends else found[0] if found else 'no state'}"
        if self.mode is FlightMode.LAND:
            self._enter(FlightMode.HOLD, now_s)
        self._moved, self._stopped = False, Stopped()
        self._pilot.begin(now_s)
        packets = self._arming.ask(self.state, now_s)
        self._packets += packets
        if not packets:
            self.texts.say(INFO, "Armed")
        return None

    def disarm(self, now_s: float, *, force: bool) -> str | None:
        if not force and not self.standing:
            return "Disarming refused: not landed"
        if force and self.link.protocol is None:
            self._kill_s = now_s
            self._end("motors off requested, no link")
            return f"No link to the Crazyflie: motors off if it is back within {limits.KILL_KEPT_S:g} s"
        flying = self.state is not None and bool(self.state.info & Info.FLYING)
        if self.armed or self.arming or (force and flying):
            self._motors_off(now_s, "Disarmed by force" if force else "Disarmed", forced=force)
        return None

    def end(self, now_s: float) -> None:
        """Land because the bridge ends; from now on refuse arming and other modes."""
        self._ends = True
        self.land(now_s)

    def _why_no_mode(self, mode: FlightMode, now_s: float) -> str | None:
        if self._ends:
            return _ENDS
        blind = mode is FlightMode.OFFBOARD and self._streamed(now_s) and not self.position_known(now_s)
        return "no position estimate" if blind else None

    def _take(self, setpoint: Setpoint, now_s: float) -> None:
        """Send a velocity once if armed and in OFFBOARD; a velocity above the speed limit is scaled down."""
        velocity_enu_m_s, yaw_rad, yaw_rate_rad_s = setpoint
        self._stream_end_said = False
        if not (self.armed and self.mode is FlightMode.OFFBOARD):
            return
        speed_m_s = math.hypot(*velocity_enu_m_s)
        if speed_m_s > self.options.speed_max_m_s:
            share = self.options.speed_max_m_s / speed_m_s
            x, y, z = velocity_enu_m_s
            velocity_enu_m_s = (share * x, share * y, share * z)
            self.texts.refuse(f"Set-point cut to {self.options.speed_max_m_s:g} m/s", now_s, "fast")
        state = self.fresh_state(now_s)
        if yaw_rad is not None:
            yaw_rate_rad_s = yaw_rate(yaw_rad, state) if state is not None else 0.0
        self._command(Velocity(velocity_enu_m_s, yaw_rate_rad_s))
        # a vehicle that does not descend on command counts as standing, so that a client may disarm it
        if self._stopped.lasts_s(velocity_enu_m_s[2], state, now_s) > limits.STANDING_S:
            self._moved = False

    def step(self, now_s: float) -> None:
        """Advance the timers and queue the packets that are due; to be called at least every 10 ms."""
        self._watch_radio(now_s)
        was_armed = self.armed
        packets, text = self._arming.step(self.state, now_s)
        self._packets += packets
        if text is not None:
            self.texts.say(CRITICAL, text if text[0].isupper() else f"Arming failed: {text}")
        if self.armed and not was_armed:
            self.texts.say(INFO, "Armed")
        if not self.armed and self.mode is FlightMode.OFFBOARD and now_s - self._setpoint_s > limits.STREAM_S:
            self._change(FlightMode.HOLD)
        if not (self.armed and self.standing):
            self._idle_since_s = now_s
        elif now_s - self._idle_since_s > limits.IDLE_S:
            self._motors_off(now_s, "Disarmed: it does not fly", forced=False)
        if self.armed:
            (self._fly_offboard if self.mode is FlightMode.OFFBOARD else self._fly_own)(now_s)

    # Control of the flight

    def _command(self, velocity: Velocity) -> None:
        self._moved = True
        self._packets.append(velocity)

    def _fly_own(self, now_s: float) -> None:
        if self.standing and self.mode is FlightMode.LAND:
            self._motors_off(now_s, "Disarmed", forced=False)
            return
        idle = self.standing and self.mode is FlightMode.HOLD
        if idle or now_s - self._own_s < limits.OWN_PERIOD_S - 1e-4:
            return
        self._own_s = now_s
        if self.mode is not FlightMode.LAND and now_s - self._client_s > limits.CLIENT_SILENT_S:
            self._fall_back(f"No client for {limits.CLIENT_SILENT_S:g} s", now_s)
            return
        state = self.fresh_state(now_s)
        placed = state is not None and self.position_known(now_s)
        blind_s = now_s - max(self._placed_s, self._pilot.since_s)
        if not placed and self.mode is FlightMode.LAND and blind_s > self._sink_s:
            self._motors_off(now_s, "Blind landing over: motors off", forced=False)
            return
        if state is not None and not placed and self.mode is not FlightMode.LAND:
            self._fall_back("No position estimate", now_s)
            return
        if state is None:  # stop in the air, or continue to descend
            if self.mode is FlightMode.LAND or not self.standing:
                sink_m_s = -DESCENT_M_S if self.mode is FlightMode.LAND else 0.0
                self._command(Velocity((0.0, 0.0, sink_m_s), 0.0))
            return
        takes_off = self.mode is FlightMode.TAKEOFF
        velocity = self._pilot.velocity(state, self.takeoff_z_m if takes_off else None)
        if self.mode is FlightMode.LAND:
            if self._pilot.landed(state, now_s):
                self._motors_off(now_s, "Landed, disarmed", forced=False)
                return
            (vx, vy, _), turn_rad_s = velocity
            # without a position the landing descends vertically
            descent = (vx, vy, -DESCENT_M_S) if placed else (0.0, 0.0, -UNPLACED_M_S)
            velocity = Velocity(descent, turn_rad_s)
        elif takes_off and self._pilot.arrived(state, self.takeoff_z_m):
            self._change(FlightMode.HOLD)
        elif takes_off and now_s - self._pilot.since_s > limits.TAKEOFF_MAX_S:
            self._fall_back("Take-off height not reached", now_s)
            return
        self._command(velocity)

    def _fly_offboard(self, now_s: float) -> None:
        """Report and handle the end of the client's stream; ``_take`` sends the set-points."""
        silence_s = now_s - self._setpoint_s
        if silence_s > limits.LEVEL_OUT_S and not self._stream_end_said and self._moved:
            self._stream_end_said = True
            self.texts.say(CRITICAL, "Set-points stopped: firmware levels out, motors off at 2 s")
        if silence_s > limits.STREAM_S and (self.options.land_on_silence or self.standing):
            self._fall_back("No set-points", now_s)
