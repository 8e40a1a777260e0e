"""Which telemetry of a Crazyflie is due; one table of intervals for all clients, as one PX4 port has."""

from __future__ import annotations

import math

from bridge.crazyflie.server.messages import BY_TIME, DEFAULT_S, NEEDS_POSITION, PER_STATE, View
from bridge.mavlink.codec.decoding import Message

SHORTEST_S = 0.01  # s; the Crazyflie's own log period, nothing new comes more often
_LONGEST_S = 2000.0  # s; MESSAGE_INTERVAL counts microseconds in 32 bits


class Streams:
    """Intervals, and what is due."""

    def __init__(self) -> None:
        self._interval_s = dict(DEFAULT_S)
        self._sent_s = dict.fromkeys(DEFAULT_S, -math.inf)

    def known(self, message_id: int) -> bool:
        """Whether there is such a stream."""
        return message_id in self._interval_s

    def set_interval(self, message_id: int, interval_us: float) -> None:
        """Change it: microseconds, 0 for the default, negative for off."""
        self._interval_s[message_id] = self._seconds(message_id, interval_us)

    def rarer(self, message_id: int, interval_us: float) -> bool:
        """Whether that would take something away from those who get it now."""
        return self._seconds(message_id, interval_us) > self._interval_s[message_id]

    def interval_us(self, message_id: int) -> int:
        """As MESSAGE_INTERVAL says it: -1 is off."""
        interval_s = self._interval_s[message_id]
        return -1 if interval_s == math.inf else round(interval_s * 1e6)

    def hasten(self, message_id: int) -> None:
        """Let it be due at once, unless it is off."""
        self._sent_s[message_id] = -math.inf

    def per_state(self, view: View) -> list[Message]:
        """What a new state makes due; judged by the Crazyflie's clock, which is even."""
        at_s, placed = view.state.boot_ms / 1000.0, view.vehicle.position_known(view.now_s)
        return [
            build(view)
            for id_, build in PER_STATE.items()
            if (placed or id_ not in NEEDS_POSITION) and self._take(id_, at_s)
        ]

    def by_time(self, view: View) -> list[Message]:
        """What time makes due."""
        return [build(view) for id_, build in BY_TIME.items() if self._take(id_, view.now_s)]

    def _take(self, message_id: int, at_s: float) -> bool:
        since_s = at_s - self._sent_s[message_id]
        if 0.0 <= since_s < self._interval_s[message_id] - SHORTEST_S / 2:
            return False  # a clock that went back is a restart, and makes it due
        if self._interval_s[message_id] == math.inf:
            return False
        self._sent_s[message_id] = at_s
        return True

    def _seconds(self, message_id: int, interval_us: float) -> float:
        if interval_us < 0.0:
            return math.inf
        if interval_us == 0.0:
            return DEFAULT_S[message_id]
        return min(max(SHORTEST_S, interval_us * 1e-6), _LONGEST_S)
