"""The small protocols around flying: parameters, clock, ping, heartbeats, and things it does not do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message
from sim.autopilot.flight import Flight
from sim.autopilot.geo import degrees_e7
from sim.autopilot.owner import Right, Sender
from sim.autopilot.parameters import NOT_NOW, Parameters, Refused
from sim.autopilot.server.missions import (
    file_transfer,
    log_list,
    mission_clear,
    mission_count,
    mission_item_wanted,
    mission_list,
    mission_refused,
)
from sim.autopilot.server.streams import Streams

_ORIGIN_NEAR_E7 = 10_000  # 1e-3 degrees, about 100 m

Handler = Callable[[Any, Sender, float], list[Message]]


class Services:
    """Handlers by message id; each returns the answer to the sender.

    REQUEST_DATA_STREAM is missing on purpose, as in PX4: the rates are one table for all, and what MAVProxy
    and dronekit ask for at their start (4 Hz of everything) would starve the companion of its position. A
    personality that has it lets it raise a rate, or start one, but never lower one.
    """

    def __init__(self, flight: Flight, parameters: Parameters, streams: Streams) -> None:
        self._flight = flight
        self._parameters = parameters
        self._streams = streams
        m = dialect
        self.handlers: dict[int, Handler] = {
            m.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            m.MAVLINK_MSG_ID_TIMESYNC: _timesync,
            m.MAVLINK_MSG_ID_PING: _ping,
            m.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._parameter_list,
            m.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._parameter_read,
            m.MAVLINK_MSG_ID_PARAM_SET: self._parameter_set,
            m.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: mission_list,
            m.MAVLINK_MSG_ID_MISSION_COUNT: mission_count,
            m.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: mission_clear,
            m.MAVLINK_MSG_ID_MISSION_REQUEST: mission_item_wanted,
            m.MAVLINK_MSG_ID_MISSION_REQUEST_INT: mission_item_wanted,
            m.MAVLINK_MSG_ID_MISSION_ITEM: mission_refused,
            m.MAVLINK_MSG_ID_MISSION_ITEM_INT: mission_refused,
            m.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: mission_refused,
            m.MAVLINK_MSG_ID_MISSION_REQUEST_PARTIAL_LIST: mission_refused,
            m.MAVLINK_MSG_ID_LOG_REQUEST_LIST: log_list,
            m.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: file_transfer,
            m.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: self._set_origin,
            m.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: self._refuse_setpoint("attitude"),
            m.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: self._refuse_setpoint("global position"),
        }

        if flight.personality.data_streams:
            self.handlers[m.MAVLINK_MSG_ID_REQUEST_DATA_STREAM] = self._data_stream

    def _heartbeat(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        if self._flight.watches.heartbeat(message.type, sender[0], now_s):
            self._flight.say(dialect.MAV_SEVERITY_INFO, "Ground station is back")
        return []

    def _parameter_list(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del message, sender, now_s
        self._parameters.list_all()  # goes out with the telemetry of the next ticks
        return []

    def _parameter_read(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del now_s
        name = self._parameters.find(_text(message.param_id), message.param_index)
        return [_no_parameter(message, sender)] if name is None else [self._parameters.message(name)]

    def _parameter_set(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        name = self._parameters.find(_text(message.param_id), -1)
        if name is None:
            return [_no_parameter(message, sender)]
        forbidden = self._flight.forbids(sender, Right.OWNER, now_s)
        if forbidden is not None:
            refused: Refused | None = Refused(NOT_NOW, f"{name} refused: {forbidden}")
        else:
            refused = self._parameters.set(
                name, message.param_value, message.param_type, armed=self._flight.vehicle.armed
            )
        in_force = self._parameters.message(name)
        if refused is None:
            return [in_force]
        self._flight.texts.refuse(refused.reason, now_s)
        # The error first: MAVSDK takes a value that differs for a lost write and sends it five times more.
        return [_parameter_error(name.encode(), -1, refused.error, sender), in_force]

    def _set_origin(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del sender
        latitude, longitude = degrees_e7(0.0, 0.0)
        near = max(abs(message.latitude - latitude), abs(message.longitude - longitude)) <= _ORIGIN_NEAR_E7
        if self._flight.origin_known:
            self._flight.texts.refuse("Origin refused: the simulated room does not move", now_s)
        elif near:
            self._flight.set_origin()
        else:
            place = f"{latitude / 1e7:.6f}, {longitude / 1e7:.6f}"
            self._flight.texts.refuse(f"Origin refused: the simulated room lies at {place}", now_s)
            return []
        return [dialect.MAVLink_gps_global_origin_message(latitude, longitude, 0, round(now_s * 1e6))]

    def _data_stream(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del sender
        groups = self._flight.personality.data_streams
        if not message.start_stop or not message.req_message_rate:
            return []
        interval_us = 1e6 / message.req_message_rate
        for message_id in groups.get(message.req_stream_id, ()):
            if not self._streams.rarer(message_id, interval_us):
                self._streams.set_interval(message_id, interval_us, now_s)
        return []

    def _refuse_setpoint(self, kind: str) -> Handler:
        def refuse(message: Any, sender: Sender, now_s: float) -> list[Message]:
            del message, sender
            self._flight.texts.refuse(f"Set-point dropped: {kind}, only local velocity", now_s)
            return []

        return refuse


def _no_parameter(message: Any, sender: Sender) -> Message:
    """PX4 1.16 says nothing here, and clients wait for seconds (mavlink.io, services/parameter)."""
    index = getattr(message, "param_index", -1)
    name = _text(message.param_id).encode("ascii", "replace")
    return _parameter_error(name, index, dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST, sender)


def _parameter_error(name: bytes, index: int, error: int, sender: Sender) -> Message:
    return dialect.MAVLink_param_error_message(*sender, name, index, error)


def _text(field: str | bytes) -> str:
    raw = field.encode("latin-1", "replace") if isinstance(field, str) else bytes(field)
    return raw.partition(b"\x00")[0].decode("ascii", "replace")


def _timesync(message: Any, sender: Sender, now_s: float) -> list[Message]:
    del sender
    if message.tc1 != 0:
        return []  # an answer
    return [dialect.MAVLink_timesync_message(max(1, round(now_s * 1e9)), message.ts1)]  # 0 would ask back


def _ping(message: Any, sender: Sender, now_s: float) -> list[Message]:
    del now_s
    if message.target_system != 0 or message.target_component != 0:
        return []  # an answer
    return [dialect.MAVLink_ping_message(message.time_usec, message.seq, *sender)]
