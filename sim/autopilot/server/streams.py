"""Which telemetry is due when; one table of rates for all peers, as one PX4 port has."""

from __future__ import annotations

from dataclasses import dataclass

from bridge.mavlink.codec.decoding import Message
from sim.autopilot.personality import EVERY_TICK, PX4, Personality
from sim.autopilot.server.messages import BUILDERS
from sim.autopilot.server.snapshot import Builder, Snapshot

_FOREVER = float("inf")
_INTERVAL_MAX_S = 2000.0  # s; MESSAGE_INTERVAL counts microseconds in 32 bits, which end at 2147 s


@dataclass(slots=True)
class _Stream:
    build: Builder
    interval_s: float  # infinite: off
    due_s: float


class Streams:
    """Intervals of all messages, and what is due."""

    def __init__(self, rate_hz: float, personality: Personality = PX4) -> None:
        """Set the default rates.

        Args:
            rate_hz: rate of the loop; nothing is sent more often, so nobody can ask for a flood.
            personality: has the defaults.
        """
        self._period_s = 1.0 / rate_hz
        self._hidden: frozenset[int] = frozenset()
        self._default_s = dict.fromkeys(personality.every_tick, self._period_s)
        self._default_s |= {id_: max(self._period_s, 1.0 / hz) for id_, hz in personality.rates_hz.items()}
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

    def hide(self, message_ids: frozenset[int]) -> None:
        """Send none of these, whatever their rate; none before says: hide nothing any more."""
        if message_ids != self._hidden:
            self._hidden = message_ids
            self._sort()

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
        streams = [stream for id_, stream in self._streams.items() if id_ not in self._hidden]
        self._busy = [stream for stream in streams if stream.interval_s <= self._period_s]
        self._lazy = [stream for stream in streams if stream.interval_s > self._period_s]
        self._lazy_due_s = 0.0
