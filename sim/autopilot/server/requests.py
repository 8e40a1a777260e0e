"""Commands that ask for messages; anybody may, at any time, unless another would get less."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.autopilot.owner import Right
from sim.autopilot.server.commands import DENIED, FAILED, UNSUPPORTED, Answer, Command, Entry, Table, integer
from sim.autopilot.server.messages import REQUESTABLE
from sim.autopilot.server.snapshot import Snapshot
from sim.autopilot.server.streams import Streams


class Requests:
    """Handlers of the commands that ask."""

    def __init__(self, streams: Streams, snapshot: Callable[[float], Snapshot]) -> None:
        self._streams = streams
        self._snapshot = snapshot
        m = dialect
        handlers = {
            m.MAV_CMD_GET_HOME_POSITION: self._home,
            m.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            m.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            m.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            m.MAV_CMD_REQUEST_PROTOCOL_VERSION: _protocol_version,
            m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            m.MAV_CMD_REQUEST_CAMERA_INFORMATION: _camera,
        }
        self.table: Table = {number: Entry(run, Right.ANYBODY) for number, run in handlers.items()}
        self.table[m.MAV_CMD_SET_MESSAGE_INTERVAL] = Entry(
            self._set_interval, Right.ANYBODY, right_of=self._right_to_interval
        )

    def _set_interval(self, command: Command) -> Answer:
        message_id, interval_us = integer(command.given(1)), command.given(2) or 0.0
        if message_id is None or not self._streams.known(message_id):
            return _no_stream(message_id)
        self._streams.set_interval(message_id, interval_us, command.now_s)
        return Answer()

    def _right_to_interval(self, command: Command) -> Right:
        """The rates are one table for all: nobody may starve the owner of control of his telemetry."""
        message_id = integer(command.given(1))
        if message_id is None or not self._streams.known(message_id):
            return Right.ANYBODY
        rarer = self._streams.rarer(message_id, command.given(2) or 0.0)
        return Right.OWNER if rarer else Right.ANYBODY

    def _get_interval(self, command: Command) -> Answer:
        message_id = integer(command.given(1))
        if message_id is None or not self._streams.known(message_id):
            return _no_stream(message_id)
        interval_us = self._streams.interval_us(message_id)
        return Answer(messages=(dialect.MAVLink_message_interval_message(message_id, interval_us),))

    def _request_message(self, command: Command) -> Answer:
        return self._give(integer(command.given(1)), command.now_s)

    def _capabilities(self, command: Command) -> Answer:
        if command.given(1) != 1.0:
            return Answer(DENIED, "Capabilities refused: param1 must be 1")
        return self._give(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, command.now_s)

    def _home(self, command: Command) -> Answer:
        return self._give(dialect.MAVLINK_MSG_ID_HOME_POSITION, command.now_s)

    def _give(self, message_id: int | None, now_s: float) -> Answer:
        builder = REQUESTABLE.get(message_id) if message_id is not None else None
        if builder is None:
            # QGroundControl takes an ACCEPTED as a promise and waits for the message for ever.
            return Answer(DENIED, f"Message {message_id} refused: there is none")
        return Answer(messages=(builder(self._snapshot(now_s)),))


def _no_stream(message_id: int | None) -> Answer:
    return Answer(FAILED, f"Message {message_id} has no rate to set")  # as PX4 does, HEARTBEAT included


def _protocol_version(command: Command) -> Answer:
    del command
    return Answer(UNSUPPORTED, "No PROTOCOL_VERSION: AUTOPILOT_VERSION says MAVLink 2")


def _camera(command: Command) -> Answer:
    del command
    return Answer(UNSUPPORTED, "No camera")
