"""Asks the vehicle for the telemetry the stack needs: each second at first, then seldom while none comes.

An autopilot may have no position for minutes (no satellites yet, no origin), and none to send before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message

_SET_MESSAGE_INTERVAL = 511  # MAV_CMD
_CHECK_S = 1.0  # s over which a rate is judged
_ENOUGH = 0.7  # of the rate asked for; the rest is loss and rounding to the autopilot's own ticks
_ROUNDING_S = 1e-6  # s, more than the rounding of a time
_TRIES = 5  # one each _CHECK_S, of each way to ask
_AGAIN_S = 3.0  # s between two tries after those, while nothing comes at all


@dataclass(slots=True)
class _Stream:
    message_id: int
    rate_hz: float
    tries: int = 0
    seen: int = 0
    since_s: float = 0.0


class StreamRequests:
    """Pure: counts what comes and returns SET_MESSAGE_INTERVAL commands while it is too little.

    Where a profile names a data stream for a message, REQUEST_DATA_STREAM is tried after those, and both in
    turn from then on.
    """

    def __init__(
        self,
        rates_hz: Mapping[int, float],
        target_system: int,
        target_component: int,
        unset: float,
        data_streams: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        """Set up. ``rates_hz`` is by message id, ``data_streams`` the MAV_DATA_STREAM by message id."""
        self._streams = {id_: _Stream(id_, rate) for id_, rate in rates_hz.items()}
        self._target = (target_system, target_component)
        self._unset = unset
        self._data_streams = data_streams
        # before that ``step`` returns nothing
        self.quiet_until_s = -math.inf  # before that no stream can be due

    def seen(self, message_id: int, count: int = 1) -> None:
        """Take note of messages of the vehicle."""
        stream = self._streams.get(message_id)
        if stream is not None:
            stream.seen += count

    @property
    def asked(self) -> tuple[int, ...]:
        """Ids of the messages asked for."""
        return tuple(self._streams)

    def restart(self) -> None:
        """Ask again at once for what does not come: the vehicle has restarted and forgotten the requests."""
        for stream in self._streams.values():
            stream.tries = min(stream.tries, 1)
        self.quiet_until_s = -math.inf

    def step(self, now_s: float) -> list[Message]:
        """Return the commands to send now; call it only once the vehicle has been heard."""
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
            stream.tries = 1  # it comes: should it stop one day, it is asked for again
            stream.seen, stream.since_s = 0, now_s
            return False
        if stream.tries < (2 * _TRIES if stream.message_id in self._data_streams else _TRIES):
            return True
        if stream.seen:  # less than was asked for, which is all that this vehicle or line gives
            stream.seen, stream.since_s = 0, now_s
            return False
        return elapsed_s >= _AGAIN_S

    def _ask(self, stream: _Stream, now_s: float) -> Message:
        stream.tries += 1
        stream.seen, stream.since_s = 0, now_s
        by_group = (stream.tries - 1) // _TRIES % 2 == 1  # _TRIES times in each of the two ways, in turn
        if by_group and stream.message_id in self._data_streams:
            group, rate_hz = self._data_streams[stream.message_id], round(stream.rate_hz)
            return dialect.MAVLink_request_data_stream_message(*self._target, group, rate_hz, 1)
        interval_us = float(round(1e6 / stream.rate_hz))
        rest = (self._unset,) * 4
        return dialect.MAVLink_command_long_message(
            *self._target, _SET_MESSAGE_INTERVAL, 0, float(stream.message_id), interval_us, *rest, 0.0
        )
