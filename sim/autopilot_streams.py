"""Which telemetry is due when; one table of rates for all peers, as one PX4 port has."""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.decoding import Message
from sim.autopilot_messages import BUILDERS, Snapshot

_M = dialect
# Hz; rates of PX4's own links, or what clients were measured to need. Missing: on request only.
_DEFAULT_HZ: dict[int, float] = {
    _M.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    _M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    _M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    _M.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    _M.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    _M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    _M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    _M.MAVLINK_MSG_ID_ALTITUDE: 1.0,
    _M.MAVLINK_MSG_ID_VFR_HUD: 2.0,
    _M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.5,
    _M.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    _M.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 2.0,
}
# The order is that of a datagram: a position counts with the attitude that came before it.
_EVERY_TICK = (_M.MAVLINK_MSG_ID_ATTITUDE, _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
_FOREVER = float("inf")


@dataclass(slots=True)
class _Stream:
    message_id: int
    interval_s: float  # infinite: off
    due_s: float


class Streams:
    """Intervals of all messages, and what is due."""

    def __init__(self, rate_hz: float) -> None:
        """Set the default rates.

        Args:
            rate_hz: rate of the loop; nothing is sent more often, so nobody can ask for a flood.
        """
        self._period_s = 1.0 / rate_hz
        self._default_s = dict.fromkeys(_EVERY_TICK, self._period_s)
        self._default_s |= {id_: max(self._period_s, 1.0 / hz) for id_, hz in _DEFAULT_HZ.items()}
        order = (*_EVERY_TICK, *(id_ for id_ in BUILDERS if id_ not in _EVERY_TICK))
        self._streams = {id_: _Stream(id_, self._default_s.get(id_, _FOREVER), 0.0) for id_ in order}
        for stream in self._streams.values():
            if stream.interval_s == _FOREVER:
                stream.due_s = _FOREVER
        self._sorted = list(self._streams.values())

    def known(self, message_id: int) -> bool:
        """Whether the autopilot has this message."""
        return message_id in self._streams

    def interval_us(self, message_id: int) -> int:
        """Interval as MESSAGE_INTERVAL says it: microseconds, -1 off."""
        interval_s = self._streams[message_id].interval_s
        return -1 if interval_s == _FOREVER else round(interval_s * 1e6)

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> None:
        """Change a rate: microseconds, 0 for the default, negative for off."""
        if interval_us < 0.0:
            interval_s = _FOREVER
        elif interval_us == 0.0:
            interval_s = self._default_s.get(message_id, _FOREVER)
        else:
            interval_s = max(self._period_s, interval_us * 1e-6)
        stream = self._streams[message_id]
        if interval_s != stream.interval_s:
            stream.interval_s = interval_s
            stream.due_s = now_s if interval_s < _FOREVER else _FOREVER

    def hasten(self, message_id: int) -> None:
        """Let a message be due at once, unless it is off."""
        stream = self._streams[message_id]
        if stream.interval_s < _FOREVER:
            stream.due_s = 0.0

    def due(self, snapshot: Snapshot) -> list[Message]:
        """Make the messages that are due."""
        now_s = snapshot.now_s
        limit_s = now_s + 0.5 * self._period_s  # nearer to this tick than to the next
        messages = []
        for stream in self._sorted:
            if stream.due_s <= limit_s:
                messages.append(BUILDERS[stream.message_id](snapshot))
                stream.due_s += stream.interval_s
                if stream.due_s <= now_s:  # never to make up for what was missed
                    stream.due_s = now_s + stream.interval_s
        return messages
