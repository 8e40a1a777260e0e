"""The MAVLink autopilot other programs see: PX4's or ArduPilot's personality around the simulated vehicle.

Pure: messages and times in, messages out. No socket, no clock, no randomness. Behaviour follows PX4 1.16
(``Commander.cpp``, ``mavlink_receiver.cpp``, ``streams/*.hpp``), except where noted in the code, or where the
table of personalities has it as ArduCopter 4.6.
"""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message
from flightstack.core.types import ZERO, Vec3
from sim.autopilot.flight import Flight
from sim.autopilot.modes import FlightMode, VehicleLike
from sim.autopilot.owner import Right, Sender
from sim.autopilot.parameters import Parameters
from sim.autopilot.personality import PX4, Personality
from sim.autopilot.server.actions import Actions
from sim.autopilot.server.commands import Commands
from sim.autopilot.server.requests import Requests
from sim.autopilot.server.services import Handler, Services
from sim.autopilot.server.snapshot import Snapshot
from sim.autopilot.server.status import heartbeat
from sim.autopilot.server.streams import Streams
from sim.autopilot.setpoints import read_setpoint
from sim.autopilot.texts import Text, TextWire

SYSTEM_ID = 1
COMPONENT_ID = dialect.MAV_COMP_ID_AUTOPILOT1  # clients look for the autopilot nowhere else
_HEARTBEAT_S = 1.0
_LOG_MAX = 1024  # texts kept for a log that nobody takes
_BROADCAST = frozenset(  # the only commands PX4 obeys when sent to system 0
    {
        dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
        dialect.MAV_CMD_REQUEST_MESSAGE,
        dialect.MAV_CMD_REQUEST_PROTOCOL_VERSION,
    }
)
_NOTHING: frozenset[int] = frozenset()
_NEED_ORIGIN = frozenset(  # nothing of it is sent before the origin is known
    {
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        dialect.MAVLINK_MSG_ID_HOME_POSITION,
        dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
    }
)
_EXTENDED_SYS_STATE = dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE


class Autopilot:
    """One autopilot. At each tick: ``telemetry``, ``handle`` what came, ``control``, physics.

    Attributes:
        flight: modes and arming, to look at.
        parameters: values in force.
        system_id: MAVLink system id; the component id is always 1.
    """

    def __init__(
        self,
        vehicle: VehicleLike,
        rate_hz: float,
        *,
        system_id: int = SYSTEM_ID,
        epoch_ns: int = 0,
        trim_enu_m_s: Vec3 = ZERO,
        personality: Personality = PX4,
    ) -> None:
        """Put an autopilot on a vehicle.

        Args:
            vehicle: it may already be flying; then it is held where it is.
            rate_hz: rate of the loop, and of position and attitude on the wire.
            system_id: MAVLink system id, 1 to 255.
            epoch_ns: Unix time of time zero, for SYSTEM_TIME.
            trim_enu_m_s: velocity set-point that keeps a vehicle in place that starts in the air.
            personality: which autopilot it is.
        """
        self.system_id = system_id
        rows = personality.parameters(system_id)
        self.parameters = Parameters(system_id, rows, bytewise=personality.bytewise)
        self.flight = Flight(vehicle, self.parameters, 1.0 / rate_hz, trim_enu_m_s, personality)
        self._vehicle = vehicle
        self._streams = Streams(rate_hz, personality)
        if not self.flight.origin_known:
            self._streams.hide(_NEED_ORIGIN)
        self._epoch_ns = epoch_ns
        actions = Actions(self.flight, self.parameters, self._streams)
        requests = Requests(self._streams, self._snapshot)
        table = {**actions.table, **requests.table}
        self._commands = Commands(table, self.flight.texts, self.flight.forbids, personality)
        self._heartbeat_due_s = -math.inf
        self._shown: object = None  # what heartbeat and status said last
        self._landed_shown = self.flight.landed_state
        self._texts_to_log: list[Text] = []
        self._wire = TextWire()
        self._handlers: dict[int, Handler] = {
            dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
            dialect.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            dialect.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            dialect.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            **Services(self.flight, self.parameters, self._streams).handlers,
        }

    @property
    def commands(self) -> Commands:
        """What it does for COMMAND_LONG and COMMAND_INT."""
        return self._commands

    @property
    def handled(self) -> frozenset[int]:
        """Ids of the messages it acts on."""
        return frozenset(self._handlers)

    def handle(self, message: Message, sender: Sender, now_s: float) -> list[Message]:
        """Act on one message.

        Args:
            message: decoded, with a valid checksum; anything else may be wrong with it.
            sender: system and component id of its header.
            now_s: simulated time.

        Returns:
            What to answer to this sender.
        """
        handler = self._handlers.get(message.get_msgId())  # some messages have a field named id
        if handler is None or sender == (self.system_id, COMPONENT_ID) or not self._for_us(message):
            return []
        return handler(message, sender, now_s)

    def control(self, now_s: float) -> None:
        """Fly; call it after ``handle`` and before the physics."""
        self.flight.control(now_s)

    def telemetry(self, now_s: float) -> list[Message]:
        """Messages for everybody that are due: heartbeat, texts, streams."""
        flight, vehicle = self.flight, self._vehicle
        snapshot = self._snapshot(now_s)
        messages: list[Message] = []
        shown = (flight.mode, vehicle.armed, flight.failsafe, snapshot.estimate.valid, vehicle.locked)
        if flight.origin_known:
            self._streams.hide(_NOTHING)
        if shown != self._shown or now_s >= self._heartbeat_due_s:
            messages.append(heartbeat(flight))
            self._heartbeat_due_s = now_s + _HEARTBEAT_S - 1e-6
            if shown != self._shown:
                self._streams.hasten(dialect.MAVLINK_MSG_ID_SYS_STATUS)
            self._shown = shown
        if flight.landed_state != self._landed_shown:
            self._landed_shown = flight.landed_state
            self._streams.hasten(_EXTENDED_SYS_STATE)
        if flight.texts.waiting:
            texts = flight.texts.take()
            for text in texts:
                messages += self._wire.messages(text)
            self._texts_to_log = [*self._texts_to_log, *texts][-_LOG_MAX:]
        messages += self._streams.due(snapshot)
        if self.parameters.left_to_list:
            messages += self.parameters.listing()
        return messages

    def take_texts(self) -> list[Text]:
        """What was said since the last call, for the log."""
        texts, self._texts_to_log = self._texts_to_log, []
        return texts

    def _snapshot(self, now_s: float) -> Snapshot:
        return Snapshot(self.flight, self._vehicle.estimate(), now_s, self._epoch_ns)

    def _for_us(self, message: Any) -> bool:
        """Whether it is addressed to us or to all; messages without an address are for all."""
        system = getattr(message, "target_system", 0)
        return system in (0, self.system_id) and getattr(message, "target_component", 0) in (0, COMPONENT_ID)

    def _on_setpoint(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        flight = self.flight
        setpoint = read_setpoint(message, flight.yaw_rad, flight.personality.frames)
        if isinstance(setpoint, str):
            flight.refuse_setpoint(setpoint, now_s)
            return []
        refused = flight.take_setpoint(setpoint, sender, now_s)
        if refused is not None:
            flight.texts.refuse(refused, now_s, "set-point")
        return []

    def _on_command(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        if message.target_system == 0 and message.command not in _BROADCAST:
            return []
        return self._commands.run(message, sender, now_s)

    def _on_set_mode(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        """SET_MODE, which has no answer but the text."""
        if message.target_system != self.system_id:
            return []
        flight = self.flight
        pair = flight.personality.pair_of(message.custom_mode)
        mode = flight.personality.mode_of(*pair)
        if mode is None:
            reason: str | None = flight.personality.why_no_mode(*pair)
        else:
            right = Right.ANYBODY if mode is FlightMode.LAND else Right.OWNER
            reason = flight.forbids(sender, right, now_s)
            reason = flight.set_mode(mode, now_s) if reason is None else f"Mode refused: {reason}"
        if reason is not None:
            flight.texts.refuse(reason, now_s)
        return []
