"""A Crazyflie as a vehicle with modes: pure, events and commands in, packets and texts out.

A client's velocity goes to the radio once, at once, and never again: when the client stops, the firmware's
own watchdog levels out after 0.5 s and stops the motors after 2 s (firmware supervisor.c). Only in the
bridge's own modes (take-off, hold, landing) does the bridge make set-points, and only while it hears a
client, or to land.
"""

from __future__ import annotations

import math

from bridge.crazyflie import rules as limits
from bridge.crazyflie.checks import STUCK
from bridge.crazyflie.craft import CRITICAL, INFO, Craft
from bridge.crazyflie.pilot import Done, Ground, yaw_rate
from bridge.crazyflie.types import Info, Order, Velocity
from bridge.mavlink.server.profile import FlightMode
from bridge.mavlink.server.setpoints import Setpoint

_ENDS = "the bridge ends"


class Vehicle(Craft):
    """Call the methods as events arrive, then ``step``, then take ``packets`` and ``texts``."""

    def __init__(self, rules: limits.Rules) -> None:
        super().__init__(rules)
        self._ground = Ground()
        self._client_s = self._own_s = -math.inf
        self._stream_end_said = self._ends = False
        self._idle_since_s = 0.0

    # Commands of clients; the reason if refused

    def client(self, now_s: float) -> None:
        """A client's heartbeat."""
        self._client_s = now_s

    def arm(self, now_s: float) -> str | None:
        """Request arming from the supervisor; ``armed`` or a text shows the result."""
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
        self._moved, self._ground = False, Ground()
        self._pilot.begin(now_s)
        packets = self._arming.ask(self.state, now_s)
        self._packets += packets
        if not packets:
            self.texts.say(INFO, "Armed")
        return None

    def disarm(self, now_s: float, *, force: bool) -> str | None:
        """Motors off; in the air only by force."""
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
        """Land because the bridge ends: from now on nothing arms it or takes it out of the landing."""
        self._ends = True
        self.land(now_s)

    def _why_no_mode(self, mode: FlightMode, now_s: float) -> str | None:
        if self._ends:
            return _ENDS
        blind = mode is FlightMode.OFFBOARD and self._streamed(now_s) and not self.position_known(now_s)
        return "no position estimate" if blind else None

    def _take(self, setpoint: Setpoint, now_s: float) -> None:
        """Pass a velocity on, once, when it is armed and in OFFBOARD; a longer one is cut to the limit."""
        velocity_enu_m_s, yaw_rad, yaw_rate_rad_s = setpoint
        self._stream_end_said = False
        if not (self.armed and self.mode is FlightMode.OFFBOARD):
            return
        speed_m_s = math.hypot(*velocity_enu_m_s)
        if speed_m_s > self.rules.speed_max_m_s:
            share = self.rules.speed_max_m_s / speed_m_s
            x, y, z = velocity_enu_m_s
            velocity_enu_m_s = (share * x, share * y, share * z)
            self.texts.refuse(f"Set-point cut to {self.rules.speed_max_m_s:g} m/s", now_s, "fast")
        state = self.fresh_state(now_s)
        if yaw_rad is not None:
            yaw_rate_rad_s = yaw_rate(yaw_rad, state) if state is not None else 0.0
        self._command(Velocity(velocity_enu_m_s, yaw_rate_rad_s))
        if self._ground.stands(velocity_enu_m_s[2], state, now_s):  # a client that landed may disarm
            self._moved = False

    def step(self, now_s: float) -> None:
        """Do what is due; call it at least every 10 ms."""
        self._note_pose(self.mocap_problem, None, now_s)
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

    # Flying

    def _command(self, velocity: Velocity) -> None:
        self._moved = True
        self._packets.append(velocity)

    def _fly_own(self, now_s: float) -> None:
        if self.standing and self.mode is FlightMode.LAND:
            self._motors_off(now_s, "Disarmed", forced=False)
            return
        if (
            self.standing and self.mode is FlightMode.HOLD
        ) or now_s - self._own_s < limits.OWN_PERIOD_S - 1e-4:
            return
        self._own_s = now_s
        if self.mode is not FlightMode.LAND and now_s - self._client_s > limits.CLIENT_SILENT_S:
            self._fall_back(f"No client for {limits.CLIENT_SILENT_S:g} s", now_s)
            return
        state = self.fresh_state(now_s)
        placed = state is not None and self.position_known(now_s)
        if not placed and self.mode is FlightMode.LAND and self._has_sunk(now_s):
            self._motors_off(now_s, "Blind landing over: motors off", forced=False)
            return
        if state is not None and not placed and self.mode is not FlightMode.LAND:
            self._fall_back("No position estimate", now_s)
            return
        velocity, done = self._pilot.step(
            self.mode, self.takeoff_z_m, state, now_s, standing=self.standing, placed=placed
        )
        if done is Done.LANDED:
            self._motors_off(now_s, "Landed, disarmed", forced=False)
            return
        if done is Done.STUCK:
            self._fall_back("Take-off height not reached", now_s)
            return
        if done is Done.ARRIVED:
            self._change(FlightMode.HOLD)
        if velocity is not None:
            self._command(velocity)

    def _fly_offboard(self, now_s: float) -> None:
        """Send nothing; report and handle the end of the stream."""
        silence_s = now_s - self._setpoint_s
        if silence_s > limits.LEVEL_OUT_S and not self._stream_end_said and self._moved:
            self._stream_end_said = True
            self.texts.say(CRITICAL, "Set-points stopped: firmware levels out, motors off at 2 s")
        if silence_s > limits.STREAM_S and (self.rules.land_on_silence or self.standing):
            self._fall_back("No set-points", now_s)
