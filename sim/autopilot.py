"""The MAVLink autopilot other programs see: PX4's personality around the simulated Crazyflie.

Pure: messages and times in, messages out. No socket, no clock, no randomness. Behaviour follows PX4 1.16
(``Commander.cpp``, ``mavlink_receiver.cpp``, ``streams/*.hpp``), except where noted in the code.
"""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.decoding import Message
from flightstack.types import ZERO, Vec3
from sim.autopilot_commands import Commands
from sim.autopilot_flight import Flight, Text
from sim.autopilot_messages import Snapshot, heartbeat
from sim.autopilot_modes import VehicleLike, mode_from_custom_mode
from sim.autopilot_parameters import Parameters
from sim.autopilot_services import Handler, Services
from sim.autopilot_setpoints import Sender, read_setpoint
from sim.autopilot_streams import Streams

SYSTEM_ID = 1
COMPONENT_ID = dialect.MAV_COMP_ID_AUTOPILOT1  # clients look for the autopilot nowhere else
_HEARTBEAT_S = 1.0
_TEXT_CHUNK = 50  # characters of one STATUSTEXT
_TEXT_GAP_S = 1.0  # s between two texts about set-points, which may be wrong a hundred times a second
_BROADCAST = frozenset(  # the only commands PX4 obeys when sent to system 0
    {dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, dialect.MAV_CMD_REQUEST_MESSAGE}
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
    ) -> None:
        """Put an autopilot on a vehicle.

        Args:
            vehicle: it may already be flying; then it is held where it is.
            rate_hz: rate of the loop, and of position and attitude on the wire.
            system_id: MAVLink system id, 1 to 255.
            epoch_ns: Unix time of time zero, for SYSTEM_TIME.
            trim_enu_m_s: velocity set-point that keeps a vehicle in place that starts in the air.
        """
        self.system_id = system_id
        self.parameters = Parameters(system_id)
        self.flight = Flight(vehicle, self.parameters, 1.0 / rate_hz, trim_enu_m_s)
        self._vehicle = vehicle
        self._streams = Streams(rate_hz)
        self._home_xy_m = vehicle.estimate().position_enu_m[:2]
        self._epoch_ns = epoch_ns
        self._commands = Commands(self.flight, self._streams, self._snapshot)
        self._heartbeat_due_s = -math.inf
        self._shown: object = None  # what heartbeat and status said last
        self._landed_shown = self.flight.landed_state
        self._setpoint_text_s = -math.inf
        self._texts_to_log: list[Text] = []
        self._text_id = 0
        self._handlers: dict[int, Handler] = {
            dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
            dialect.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            dialect.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            dialect.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            **Services(self.flight, self.parameters).handlers,
        }

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
        if shown != self._shown or now_s >= self._heartbeat_due_s:
            messages.append(heartbeat(flight))
            self._heartbeat_due_s = now_s + _HEARTBEAT_S - 1e-6
            if shown != self._shown:
                self._streams.hasten(dialect.MAVLINK_MSG_ID_SYS_STATUS)
            self._shown = shown
        if flight.landed_state != self._landed_shown:
            self._landed_shown = flight.landed_state
            self._streams.hasten(_EXTENDED_SYS_STATE)
        if flight.texts:
            for text in flight.texts:
                messages += self._statustext(text)
            self._texts_to_log += flight.texts
            flight.texts.clear()
        messages += self._streams.due(snapshot)
        return messages

    def take_texts(self) -> list[Text]:
        """What was said since the last call, for the log."""
        texts, self._texts_to_log = self._texts_to_log, []
        return texts

    def _snapshot(self, now_s: float) -> Snapshot:
        return Snapshot(self.flight, self._vehicle.estimate(), now_s, self._epoch_ns, self._home_xy_m)

    def _for_us(self, message: Any) -> bool:
        """Whether it is addressed to us or to all; messages without an address are for all."""
        system = getattr(message, "target_system", 0)
        return system in (0, self.system_id) and getattr(message, "target_component", 0) in (0, COMPONENT_ID)

    def _on_setpoint(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        setpoint = read_setpoint(message, self.flight.yaw_rad)
        refused = (
            setpoint if isinstance(setpoint, str) else self.flight.take_setpoint(setpoint, sender, now_s)
        )
        if refused is not None and now_s - self._setpoint_text_s >= _TEXT_GAP_S:
            self._setpoint_text_s = now_s
            self.flight.say(dialect.MAV_SEVERITY_WARNING, refused)
        return []

    def _on_command(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        if message.target_system == 0 and message.command not in _BROADCAST:
            return []
        return self._commands.run(message, sender, now_s)

    def _on_set_mode(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del sender  # this old message has no answer
        mode = mode_from_custom_mode(message.custom_mode)
        if message.target_system == self.system_id and mode is not None:
            self._commands.set_mode(mode, now_s)
        return []

    def _statustext(self, text: Text) -> list[Message]:
        raw = text.text.encode("ascii", "replace")
        if len(raw) <= _TEXT_CHUNK:
            return [dialect.MAVLink_statustext_message(text.severity, raw)]
        self._text_id = self._text_id % 0xFFFF + 1  # 0 would mean "not in chunks"
        # A chunk shorter than 50 ends the text; a full last one is followed by an empty one.
        return [
            dialect.MAVLink_statustext_message(
                text.severity, raw[at : at + _TEXT_CHUNK], self._text_id, at // _TEXT_CHUNK
            )
            for at in range(0, len(raw) + 1, _TEXT_CHUNK)
        ]
