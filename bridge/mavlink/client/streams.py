"""Requests the stack's telemetry: every second at first, then less often while none arrives.

An autopilot may have no position for minutes (no satellites, no origin).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message

_SET_MESSAGE_INTERVAL = 511  # MAV_CMD number of SET_MESSAGE_INTERVAL
_CHECK_S = 1.0  # time over which a rate is measured, s
_ENOUGH = 0.7  # sufficient share of the requested rate; loss and the autopilot's ticks reduce it
_ROUNDING_S = 1e-6  # margin above the rounding error of a time, s
_TRIES = 5  # tries of each kind of request, one every _CHECK_S
_AGAIN_S = 3.0  # time between two later tries, s, while no message arrives


@dataclass(slots=True)
class _Stream:
    message_id: int
    rate_hz: float
    tries: int = 0
    seen: int = 0
    since_s: float = 0.0


class StreamRequests:
    """Counts messages and returns SET_MESSAGE_INTERVAL commands while their rate is too low. Pure.

    If the profile has a data stream for a message, REQUEST_DATA_STREAM and SET_MESSAGE_INTERVAL alternate
    after ``_TRIES``.
    """

    def __init__(
        self,
        rates_hz: Mapping[int, float],
        target_system: int,
        target_component: int,
        unset: float,
        data_streams: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        """``rates_hz`` and ``data_streams`` (MAV_DATA_STREAM) have message ids as keys."""
        self._streams = {id_: _Stream(id_, rate) for id_, rate in rates_hz.items()}
        self._target = (target_system, target_component)
        self._unset = unset
        self._data_streams = data_streams
        self.quiet_until_s = -math.inf  # time before which ``step`` returns no message

    def seen(self, message_id: int, count: int = 1) -> None:
        stream = self._streams.get(message_id)
        if stream is not None:
            stream.seen += count

    @property
    def asked(self) -> tuple[int, ...]:
        return tuple(self._streams)

    def restart(self) -> None:
        """Request missing messages again at once: a restarted vehicle has lost the requests."""
        for stream in self._streams.values():
            stream.tries = min(stream.tries, 1)
        self.quiet_until_s = -math.inf

    def step(self, now_s: float) -> list[Message]:
        """Return the commands to send now; called only after the first message of the vehicle."""
        if now_s < self.quiet_until_s:
            return []
        streams = self._streams.values()
        messages = [self._ask(stream, now_s) for stream in streams if self._due(stream, now_s)]
        since_s = min((stream.since_s for stream in streams), default=now_s)
        self.quiet_until_s = since_s + _CHECK_S - _ROUNDING_S
        return messages

    def _due(self, stream: _Stream, now_s: float) -> bool:
        elapsed_s = now_s - stream.since_s
        if stream.tries and elapsed_s < _CHECK_S:
            return False
        if stream.tries and stream.seen >= _ENOUGH * stream.rate_hz * elapsed_s:
            stream.tries = 1  # the stream arrives; if it stops, requests start again
            stream.seen, stream.since_s = 0, now_s
            return False
        if stream.tries < (2 * _TRIES if stream.message_id in self._data_streams else _TRIES):
            return True
        if stream.seen:  # a lower rate is the limit of this vehicle or line
            stream.seen, stream.since_s = 0, now_s
            return False
        return elapsed_s >= _AGAIN_S

    def _ask(self, stream: _Stream, now_s: float) -> Message:
        stream.tries += 1
        stream.seen, stream.since_s = 0, now_s
        by_group = (stream.tries - 1) // _TRIES % 2 == 1  # alternate the two kinds of requests after _TRIES
        if by_group and stream.message_id in self._data_streams:
            group, rate_hz = self._data_streams[stream.message_id], round(stream.rate_hz)
            return dialect.MAVLink_request_data_stream_message(*self._target, group, rate_hz, 1)
        interval_us = float(round(1e6 / stream.rate_hz))
        rest = (self._unset,) * 4
        return dialect.MAVLink_command_long_message(
            *self._target, _SET_MESSAGE_INTERVAL, 0, float(stream.message_id), interval_us, *rest, 0.0
        )
