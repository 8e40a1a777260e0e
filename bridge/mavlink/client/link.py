"""Companion side of the vehicle link: sends velocity set-points, receives state and status of one vehicle."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable, Sequence

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import (
    CommandSequencer,
    Origin,
    OriginSender,
    StreamRequests,
    companion_heartbeat,
    velocity_setpoint,
)
from bridge.mavlink.client.senders import Senders
from bridge.mavlink.client.texts import EVENT, TextAssembler, event_text
from bridge.mavlink.client.vehicle_state import VehicleState
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.profiles import PX4, Profile, found, refusal
from flightstack.core.safety.gate import ApprovedSetpoint
from flightstack.core.types import Landed, OwnState, Request

COMPONENT_ID = 191  # component id MAV_COMP_ID_ONBOARD_COMPUTER
_HEARTBEAT_S = 1.0  # period of heartbeats, s; every autopilot monitors a link by heartbeats of 1 Hz
_HELLO_S = 0.2  # wall time between heartbeats before the first message of the vehicle, s
_LANDED_STATE_HZ = 5.0  # requested rate of EXTENDED_SYS_STATE, Hz; PX4's default
_THROTTLE_HZ = 10.0  # requested rate of VFR_HUD, Hz, if the thrust reserve is estimated
_TEXTS_MAX = 256  # maximum number of texts that wait for ``take_texts``
_HELD_MAX = 4096  # maximum number of messages that wait for their tick in lockstep
# messages that the link itself handles; VehicleState handles the others
_OWN = frozenset(
    {
        dialect.MAVLINK_MSG_ID_HEARTBEAT, dialect.MAVLINK_MSG_ID_COMMAND_ACK,
        dialect.MAVLINK_MSG_ID_TIMESYNC, dialect.MAVLINK_MSG_ID_STATUSTEXT, EVENT,
    }
)  # fmt: skip
_RESTARTED = "restarted, or heard again after a silence: missing telemetry is requested again"


class VehicleLink:
    """Link to one vehicle: in a tick ``poll``, ``command``, ``send_setpoint``, ``flush``, in this order."""

    def __init__(
        self,
        endpoint: Endpoint,
        *,
        takeoff_height_m: float,
        rate_hz: float = 100.0,
        profile: Profile | None = PX4,
        system_id: int = 1,
        defer_timesync: bool = False,
        origin: Origin | None = None,
        every: int = 1,
        power: bool = False,
    ) -> None:
        """Set up the link, which owns ``endpoint``; the endpoint sends with the vehicle's system id.

        ``takeoff_height_m``: climb of ``Request.TAKEOFF``; ``rate_hz``: rate of the loop, requested for
        position and attitude; ``profile`` None: the first heartbeat selects the profile; ``defer_timesync``:
        lockstep, see ``poll``; ``origin``: sent to a vehicle that needs an origin and has none; ``every``:
        number of ticks between two set-points and between two states, above 1 on a slow serial line;
        ``power``: request the throttle, for ``VehicleState.power``.
        """
        # ``state`` decodes telemetry and keeps the newest values and the profile
        self.state = VehicleState(profile)
        self.senders = Senders()
        self.foreign = Counter[tuple[int, int]]()  # numbers of frames of other systems and components
        # lockstep: TIMESYNC requests are passed to ``take_timesync``, and each message gets the simulated
        # time of the TIMESYNC request that follows it
        self.defer_timesync = defer_timesync
        self._power = power
        if power:
            self.state.watch_power()
        # reason why this vehicle is not supported, or None
        self.refused: str | None = None
        self.heard = False  # whether a message of the vehicle has arrived
        self._target = (system_id, dialect.MAV_COMP_ID_AUTOPILOT1)
        self._takeoff_height_m, self._rate_hz, self._origin = takeoff_height_m, rate_hz, origin
        self._every, self._setpoints = every, 0
        self._use(profile or PX4)  # without a profile, the kill is the only command
        self._assembler = TextAssembler()
        self.endpoint = endpoint
        self._texts: list[tuple[int, str]] = []
        self._outgoing: list[Message] = []
        self._held: list[Message] = []
        self._timesync_ns: int | None = None
        self._heartbeat_at_s = self._hello_at_s = -math.inf
        self._hello = b""  # first heartbeat as bytes, repeated until a message of the vehicle arrives
        self._restarted_s = -math.inf  # time of the newest restart that was handled

    @property
    def failed(self) -> str | None:
        return self._sequencer.failed

    def adopt(self, profile: Profile) -> None:
        """Use the profile that the preflight check or the first heartbeat has selected."""
        self.state.profile = profile
        self.state.follow(profile.stream_in_takeoff)
        self._use(profile)

    def poll(self, now_s: float) -> None:
        """Handle all messages that have arrived; queue the heartbeats and telemetry requests that are due.

        Messages are stamped with ``now_s`` of the stack's clock. With ``defer_timesync`` a message is stamped
        with the simulated time of the TIMESYNC request that follows it, ``ts1 / 1e9``; messages without a
        following request wait for the next call.
        """
        tick_s: float | None = None if self.defer_timesync else now_s
        target, status = self._target, self.state.status
        armed = status is not None and status.armed
        for received in self.endpoint.receive():
            message = received.message
            if received.sender != target:
                self.foreign[received.sender] += 1
                continue
            if not self.senders.admits(message, received.peer, now_s, armed=armed):
                continue
            self.heard = True
            if not self.defer_timesync:
                self._handle(message, now_s)
                continue
            self._held.append(message)
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
                tick_s = message.ts1 / 1e9
                held, self._held = self._held, []
                for one in held:
                    self._handle(one, tick_s)
        del self._held[:-_HELD_MAX]  # a vehicle that sends no TIMESYNC requests is not in lockstep
        if not self.heard:
            self._say_hello()
        elif tick_s is not None:
            self._queue_due(tick_s)

    def command(self, request: Request, now_s: float) -> None:
        """Queue the commands of the current request that are due; called at every tick."""
        sequencer = self._sequencer
        if self.state.profile is None and request is not Request.MOTORS_OFF:
            return
        sequencer.home_amsl_m, sequencer.above_home = self.state.home_amsl_m, self.state.above_home
        commands = sequencer.step(request, self.state.status, now_s)
        self._outgoing += commands
        if commands and any(command.command == dialect.MAV_CMD_NAV_TAKEOFF for command in commands):
            self.state.follow(self.state.profile is None or self.state.profile.stream_in_takeoff)
        if request is Request.NONE:
            own, restarted_s = self.state.own, self.state.restarted_s
            known = self.state.origin_known or (own is not None and own.arrival_s >= restarted_s)
            status = self.state.status
            wanted = status is not None and not status.armed and not known
            self._outgoing += self._origin_sender.step(wanted, now_s)

    def send_setpoint(self, setpoint: ApprovedSetpoint, now_s: float) -> bool:
        """Queue a velocity; no other code does. False: no profile, not finite, or a take-off would end."""
        velocity, yaw = setpoint.velocity_enu_m_s, setpoint.yaw_rad
        profile = self.state.profile
        if profile is None or not self._may_stream(profile) or not math.isfinite(sum(velocity) + yaw):
            return False
        self._sequencer.note_setpoint(now_s)
        self.state.follow(True)
        self._setpoints += 1
        if self._setpoints % self._every:
            return True  # a slow line skips this set-point; a newer set-point follows
        self._outgoing.append(velocity_setpoint(setpoint, self._target, now_s))
        return True

    def flush(self, extra_messages: Sequence[Message] = ()) -> None:
        """Send the queue and ``extra_messages`` in one datagram to the vehicle."""
        messages = [*self._outgoing, *extra_messages]
        self._outgoing.clear()
        self.endpoint.send(messages, self.senders.known)

    def take_timesync(self) -> int | None:
        """Return ``ts1`` (ns) of the newest TIMESYNC request since the last call; lockstep only."""
        ts1_ns, self._timesync_ns = self._timesync_ns, None
        return ts1_ns

    @staticmethod
    def timesync_reply(ts1_ns: int) -> Message:
        """Return the TIMESYNC reply for tick ``ts1_ns``; tc1 is 1 ns later, since tc1 = 0 marks a request."""
        return dialect.MAVLink_timesync_message(ts1_ns + 1, ts1_ns)

    def take_texts(self) -> list[tuple[int, str]]:
        texts, self._texts = self._texts, []
        return texts

    @property
    def heeded(self) -> frozenset[int]:
        """Ids of the messages that have an effect on this link."""
        return frozenset((*_OWN, *self.state.heeded, *self._streams.asked))

    def silent_until_s(self, request: Request) -> float:
        """Return the time until which this link sends only set-points if only vehicle states arrive."""
        state, waits = self.state, self._outgoing or self._held or self._every > 1
        restarted = state.restarted_s != self._restarted_s
        if state.profile is None or waits or restarted or not state.following:
            return -math.inf
        if not self._sequencer.idle(request, state.status):
            return -math.inf
        return min(self._heartbeat_at_s + _HEARTBEAT_S - 1e-9, self._streams.quiet_until_s)

    def hear(self, now_s: float) -> bool:
        """Handle messages between ticks and send a due heartbeat; return False if other messages are due."""
        for received in self.endpoint.receive():
            self._handle(received.message, now_s)
        self._queue_due(now_s)
        if any(m.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT for m in self._outgoing):
            return False
        if self._outgoing:
            self.flush()
        return True

    def took(self, own: OwnState, ticks: int, passed: Iterable[int], *, setpoints: bool) -> None:
        """Record ticks that ran without ``poll``.

        ``passed``: ids of the other messages that arrived; those in ``heeded`` are also in
        ``VehicleState.repeated``; ``setpoints``: whether all ticks sent a set-point; False: no tick did.
        """
        self.state.took(own)
        self._setpoints += ticks if setpoints else 0
        for id_ in (dialect.MAVLINK_MSG_ID_ATTITUDE, dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED):
            self._streams.seen(id_, ticks)
        for id_ in passed:
            self._streams.seen(id_)
        if setpoints:
            self._sequencer.note_setpoint(own.arrival_s)

    def close(self) -> None:
        self.endpoint.close()

    def _use(self, profile: Profile) -> None:
        """Make the senders for one autopilot; these repeat a request until the vehicle shows its effect."""
        state_hz = self._rate_hz / self._every
        rates_hz = {
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: state_hz,
            dialect.MAVLINK_MSG_ID_ATTITUDE: state_hz,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _LANDED_STATE_HZ,
            **profile.asked_hz,
            **({dialect.MAVLINK_MSG_ID_VFR_HUD: _THROTTLE_HZ} if self._power else {}),
        }
        self._sequencer = CommandSequencer(profile, self._target, self._takeoff_height_m)
        self._streams = StreamRequests(rates_hz, self._target, profile.unset)
        self._origin_sender = OriginSender(self._origin if profile.needs_origin else None, self._target[0])

    def _may_stream(self, profile: Profile) -> bool:
        """Whether a set-point would neither end nor prevent a take-off of the vehicle."""
        if profile.stream_in_takeoff:
            return True
        status = self.state.status
        standing = status is not None and status.landed is Landed.ON_GROUND
        return self._sequencer.request is not Request.TAKEOFF and (self.state.following or not standing)

    def _handle(self, message: Message, arrival_s: float) -> None:
        message_id: int = message.get_msgId()  # STATUSTEXT has a field named id, so .id cannot be used
        self._streams.seen(message_id)
        if message_id not in _OWN:
            self.state.update(message, arrival_s)
        elif message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self._on_heartbeat(message, arrival_s)
        elif message_id == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
            self._sequencer.note_ack(message.command, message.result)
        elif message_id == dialect.MAVLINK_MSG_ID_TIMESYNC:
            self._on_timesync(message, arrival_s)
        else:
            said = [event_text(message)] if message_id == EVENT else self._assembler.add(message)
            for severity, text in filter(None, said):  # the text may be the reason of a failed command
                self._say(severity, text)
                self._sequencer.note_text(text)

    def _on_heartbeat(self, message: Message, arrival_s: float) -> None:
        refused, profile = (
            refusal(message.autopilot, message.type, self.state.profile),
            found(message.autopilot),
        )
        if refused is not None and refused != self.refused:
            self._say(dialect.MAV_SEVERITY_ERROR, refused)
        self.refused = refused
        if refused is None and self.state.profile is None and profile is not None:
            self.adopt(profile)
            self._say(dialect.MAV_SEVERITY_INFO, f"its heartbeat says: {profile.title}")
        self.state.update(message, arrival_s)

    def _on_timesync(self, message: Message, arrival_s: float) -> None:
        if message.tc1 != 0:
            return  # the message is a reply, not a request
        if self.defer_timesync:
            self._timesync_ns = message.ts1
        else:
            reply = dialect.MAVLink_timesync_message(max(1, round(arrival_s * 1e9)), message.ts1)
            self.endpoint.send([reply], self.senders.known)

    def _say_hello(self) -> None:
        # The vehicle may wait for this address; before its first message only wall time is available.
        wall_s = time.monotonic()
        if wall_s - self._hello_at_s >= _HELLO_S:
            self._hello_at_s = wall_s
            if self._hello:
                self.endpoint.repeat(self._hello)
                return
            heartbeat = companion_heartbeat()
            self.endpoint.send([heartbeat])
            self._hello = bytes(heartbeat.get_msgbuf() or b"")

    def _queue_due(self, now_s: float) -> None:
        if now_s - self._heartbeat_at_s >= _HEARTBEAT_S - 1e-9:
            self._heartbeat_at_s = now_s
            self._outgoing.append(companion_heartbeat())
        if self.state.autopilot is not None and self.state.profile is not None:
            if self.state.restarted_s != self._restarted_s:
                self._restarted_s = self.state.restarted_s
                self._streams.restart()
                self._origin_sender.restart()
                self._say(dialect.MAV_SEVERITY_INFO, _RESTARTED)
            self._outgoing += self._streams.step(now_s)

    def _say(self, severity: int, text: str) -> None:
        self._texts = [*self._texts, (severity, text)][-_TEXTS_MAX:]
