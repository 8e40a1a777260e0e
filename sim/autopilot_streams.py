"""Which telemetry is due when; one table of rates for all peers, as one PX4 port has."""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.decoding import Message
from sim.autopilot_messages import BUILDERS
from sim.autopilot_snapshot import Builder, Snapshot

_M = dialect
# Hz; rates of PX4's own links, or what clients were measured to need. Missing: on request only.
DEFAULT_HZ: dict[int, float] = {
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
    _M.MAVLINK_MSG_ID_ODOMETRY: 5.0,  # PX4's onboard link: 30; it is the costliest of all to pack
    _M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 1.0,
}
# The order is that of a datagram: a position counts with the attitude that came before it.
EVERY_TICK = (_M.MAVLINK_MSG_ID_ATTITUDE, _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
_FOREVER = float("inf")
_INTERVAL_MAX_S = 2000.0  # s; MESSAGE_INTERVAL counts microseconds in 32 bits, which end at 2147 s


@dataclass(slots=True)
class _Stream:
    build: Builder
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
        self._default_s = dict.fromkeys(EVERY_TICK, self._period_s)
        self._default_s |= {id_: max(self._period_s, 1.0 / hz) for id_, hz in DEFAULT_HZ.items()}
        order = (*EVERY_TICK, *(id_ for id_ in BUILDERS if id_ not in EVERY_TICK))
        self._streams = {
            id_: _Stream(BUILDERS[id_], self._default_s.get(id_, _FOREVER), 0.0) for id_ in order
        }
        self._busy: list[_Stream] = []  # at every tick
        self._lazy: list[_Stream] = []  # more rarely
        self._lazy_due_s = 0.0  # the first of those
        for stream in self._streams.values():
            if stream.interval_s == _FOREVER:
                stream.due_s = _FOREVER
        self._sort()

    def known(self, message_id: int) -> bool:
        """Whether the autopilot has this message."""
        return message_id in self._streams

    def interval_us(self, message_id: int) -> int:
        """Interval as MESSAGE_INTERVAL says it: microseconds, -1 off."""
        interval_s = self._streams[message_id].interval_s
        return -1 if interval_s == _FOREVER else round(interval_s * 1e6)

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> None:
        """Change a rate: microseconds, 0 for the default, negative for off."""
        interval_s = self._interval_s(message_id, interval_us)
        stream = self._streams[message_id]
        if interval_s != stream.interval_s:
            stream.interval_s = interval_s
            stream.due_s = now_s if interval_s < _FOREVER else _FOREVER
            self._sort()

    def rarer(self, message_id: int, interval_us: float) -> bool:
        """Whether ``set_interval`` would take something away from those who get the message now."""
        return self._interval_s(message_id, interval_us) > self._streams[message_id].interval_s

    def _interval_s(self, message_id: int, interval_us: float) -> float:
        if interval_us < 0.0:
            return _FOREVER
        if interval_us == 0.0:
            return self._default_s.get(message_id, _FOREVER)
        return min(max(self._period_s, interval_us * 1e-6), _INTERVAL_MAX_S)

    def reset(self, now_s: float) -> None:
        """Back to the default rates, as after a reboot."""
        for message_id in self._streams:
            self.set_interval(message_id, 0.0, now_s)

    def hasten(self, message_id: int) -> None:
        """Let a message be due at once, unless it is off."""
        stream = self._streams[message_id]
        if stream.interval_s < _FOREVER:
            stream.due_s = self._lazy_due_s = 0.0

    def due(self, snapshot: Snapshot) -> list[Message]:
        """Make the messages that are due."""
        messages = [stream.build(snapshot) for stream in self._busy]
        now_s = snapshot.now_s
        limit_s = now_s + 0.5 * self._period_s  # nearer to this tick than to the next
        if self._lazy_due_s > limit_s:
            return messages
        for stream in self._lazy:
            if stream.due_s <= limit_s:
                messages.append(stream.build(snapshot))
                stream.due_s += stream.interval_s
                if stream.due_s <= now_s:  # never to make up for what was missed
                    stream.due_s = now_s + stream.interval_s
        self._lazy_due_s = min((stream.due_s for stream in self._lazy), default=_FOREVER)
        return messages

    def _sort(self) -> None:
        streams = self._streams.values()
        self._busy = [stream for stream in streams if stream.interval_s <= self._period_s]
        self._lazy = [stream for stream in streams if stream.interval_s > self._period_s]
        self._lazy_due_s = 0.0
